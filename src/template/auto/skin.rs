//! A fine closed surface around a target: the boundary of what is inside it, by winding number, on a grid.
//!
//! The inside is where the winding number is above a threshold; ½ for closed targets, less where sheets are missing. Scans that overlap go round each point several times, and the
//! threshold is that many times as high: close to a wall of k layers among walls of m in the mean the number is ½ (m ± k) on its two sides. Where no threshold
//! gives a surface near all of the target (an open sheet, a double wall), the inside is what is near it. The genus of such a surface is not monotone in the grid's resolution, so two
//! are asked, and a finer one where they do not agree, unless that is the one that fills with handles.

use super::super::torus::area_covariance;
use super::opening::onto_rim;
use super::quads::{project, relax};
use super::voxels::{Grid, Voxels};
use crate::error::{Error, Result};
use crate::geometry::random::Random;
use crate::geometry::winding::WindingNumbers;
use crate::geometry::{Bvh, eigen};
use crate::measure::Rim;
use crate::mesh::sample::sample_by_area;
use crate::mesh::{Connectivity, PolygonMesh, TriangleMesh};
use crate::topology::Holes;
use glam::DVec3;
use rayon::prelude::*;

/// Cells to the target's diagonal: those that should agree, and the ones that decide otherwise.
const CELLS: [f64; 3] = [96.0, 128.0, 192.0];

/// Thresholds on the winding number, for one layer. Never lower: handles appear.
const THRESHOLDS: [f64; 3] = [0.5, 0.35, 0.25];

/// A target of so many layers and more overlaps itself; and every how many samples are asked for them.
const LAYERS: f64 = 1.1;
const LAYERS_EVERY: usize = 10;

/// A finer grid with more handles than this beyond those that the coarser one has seen sees the gaps of a double wall.
const MOST_HANDLES: i64 = 24;

/// The share of the target that must be near the skin for a threshold to be taken, and for there to be a surface at all: of a hundred loose triangles
/// 50 to 70 % are near the largest piece.
const COVERED: f64 = 0.99;
/// The share that is taken rather than wrap a target on both sides: range scans have flaps and spikes that nothing encloses.
const NEARLY_COVERED: f64 = 0.95;
const SURFACE: f64 = 0.9;

/// What is near, in cells; also how far a vertex of the skin may be moved onto the target.
pub(super) const NEAR: f64 = 1.5;

/// A target whose extent across its widest plane is less than this, in extents along it, is flat: it encloses nothing, even if it bulges to one side.
const FLAT: f64 = 1e-3;

/// Area samples of the target.
const SAMPLES: usize = 20_000;

/// Steps that smooth the stairs, and how far they may move a vertex, in cells: the target is nowhere further from them.
const SMOOTHING: usize = 6;
const MOVED: f64 = 0.75;

/// Random displacements of the skin's vertices, in cells. On flat parts all squares are equal, and simplification would take them in an order that
/// hangs on rounding: the same target elsewhere in space would get another template.
const JITTER: f64 = 1e-3;

/// How far the skin's vertices go towards the target: all the way, those over a rim would meet there.
pub(super) const ONTO: f64 = 0.9;

/// A target with what is asked of it.
pub(super) struct Subject<'a> {
    pub mesh: &'a TriangleMesh,
    pub tree: Bvh,
    bounds: (DVec3, DVec3),
    winding: WindingNumbers,
    /// Area samples with the normals there.
    samples: Vec<(DVec3, DVec3)>,
    /// What the border of an open template is to follow.
    pub rim: Option<Rim>,
}

/// A closed manifold of triangles around a target.
pub(super) struct Skin {
    pub mesh: TriangleMesh,
    /// V − E + F.
    pub euler: i64,
    /// The edge of a cell that it was made with.
    pub cell: f64,
    /// The share of the target that is near it.
    pub covered: f64,
    /// How many times the target goes around it.
    pub layers: f64,
}

impl<'a> Subject<'a> {
    /// Prepares a target, of which rims may be followed.
    ///
    /// # Errors
    /// Where it has no triangle.
    pub fn new(mesh: &'a TriangleMesh, holes: Holes) -> Result<Self> {
        let samples = sample_by_area(mesh, SAMPLES, 0);
        Ok(Self {
            tree: Bvh::new(&mesh.positions, &mesh.triangles)?,
            bounds: mesh.bounding_box().unwrap_or_default(),
            winding: WindingNumbers::of(mesh),
            samples: samples
                .iter()
                .map(|s| {
                    let t = s.triangle as usize;
                    let normal = mesh.area_vector(t).normalize_or_zero();
                    (s.position(mesh.corners(t)), normal)
                })
                .collect(),
            rim: match holes {
                Holes::Bridge | Holes::Leave => None,
                Holes::Follow => Rim::of(mesh),
            },
            mesh,
        })
    }

    /// Moves the vertices of a mesh a share of the way onto the target, and those of its border onto the rim; none that is further from there than `reach`.
    pub fn draw_on(
        &self,
        mesh: &mut PolygonMesh,
        connectivity: &Connectivity,
        share: f64,
        reach: f64,
    ) {
        project(&self.tree, &mut mesh.positions, share, reach);
        if let Some(rim) = &self.rim {
            onto_rim(mesh, connectivity, rim, reach);
        }
    }

    /// The skin whose topology is believed, of cells no smaller than about `least`.
    ///
    /// # Errors
    /// Where nothing is inside, or most of the target is nowhere near what is.
    pub fn skin(&self, least: f64) -> Result<Skin> {
        let spread = eigen::symmetric(area_covariance(self.mesh)).0;
        if self.rim.is_none() && spread.min_element() <= FLAT * FLAT * spread.max_element() {
            return Err(Error::input(
                "the target is flat: there is nothing to wrap",
                "give --template bbox or a mesh",
            ));
        }
        let most = (self.bounds.1 - self.bounds.0).length() / least;
        let [coarse, fine, finest] = CELLS.map(|cells| cells * (most / CELLS[1]).min(1.0));
        let skin = match (self.skin_of(coarse)?, self.skin_of(fine)?) {
            (Some(a), Some(b)) if a.euler == b.euler || b.covered < SURFACE => Some(b),
            (a, b) => {
                let euler = |skin: &Option<Skin>| skin.as_ref().map_or(0, |s| s.euler);
                log::info!(
                    "automatic template: Euler characteristics {} and {} at {coarse} and {fine} cells to the diagonal, so {finest}",
                    euler(&a),
                    euler(&b)
                );
                match (b, self.skin_of(finest)?) {
                    (Some(b), Some(c)) if c.euler < b.euler - 2 * MOST_HANDLES => Some(b),
                    (_, c) => c,
                }
            }
        };
        let covered = skin.as_ref().map_or(0.0, |s| s.covered);
        match skin {
            Some(skin) if covered >= SURFACE => Ok(skin),
            _ => Err(Error::input(
                format!(
                    "the target is no surface to wrap: its triangles hang together too little ({:.0} % lie near the largest piece)",
                    100.0 * covered
                ),
                "mend it, or give --template bbox or a mesh",
            )),
        }
    }

    /// The skin on a grid of so many cells to the diagonal; none where nothing is inside.
    fn skin_of(&self, cells: f64) -> Result<Option<Skin>> {
        let (lo, hi) = self.bounds;
        let grid = Grid::around(self.bounds, (hi - lo).length() / cells);
        let centers = grid.centers();
        let winding = self.winding.at_all(&centers);
        let layers = self.layers(NEAR * grid.h);
        let mut best: Option<Skin> = None;
        for threshold in THRESHOLDS {
            let inside = winding.iter().map(|&w| w > layers * threshold).collect();
            let skin = self.finish(Voxels::new(&grid, inside), grid.h, layers)?;
            let Some(skin) = skin else { continue };
            log::debug!(
                "winding numbers above {threshold} of {layers:.2} layers at {cells} cells to the diagonal: Euler characteristic {}, {:.1} % of the target near",
                skin.euler,
                100.0 * skin.covered
            );
            if skin.covered >= COVERED {
                return Ok(Some(skin));
            }
            if best.as_ref().is_none_or(|best| best.covered < skin.covered) {
                best = Some(skin);
            }
        }
        if best
            .as_ref()
            .is_some_and(|best| best.covered >= NEARLY_COVERED)
        {
            return Ok(best);
        }
        let near = |c: &DVec3| self.tree.closest_within(*c, NEAR * grid.h).is_some();
        let mut voxels = Voxels::new(&grid, centers.par_iter().map(near).collect());
        voxels.fill_cavities();
        voxels.erode();
        let skin = self.finish(voxels, grid.h, 1.0)?;
        let covered = skin.as_ref().map_or(0.0, |s| s.covered);
        log::info!(
            "automatic template: no winding number encloses the target at {cells} cells to the diagonal; {:.0} % lie near what is within {NEAR} cells of it",
            100.0 * covered
        );
        Ok(skin)
    }

    /// How many times the target goes around its inside: the mean jump of the winding number across it, at this distance. 1 unless it is clearly more.
    fn layers(&self, distance: f64) -> f64 {
        let sides = |side: f64| -> Vec<DVec3> {
            let samples = self.samples.iter().step_by(LAYERS_EVERY);
            samples.map(|(p, n)| *p - side * distance * *n).collect()
        };
        let [inner, outer] = [1.0, -1.0].map(|side| self.winding.at_all(&sides(side)));
        let jumps: f64 = inner.iter().zip(&outer).map(|(a, b)| a - b).sum();
        let layers = jumps / inner.len().max(1) as f64;
        if layers < LAYERS { 1.0 } else { layers }
    }

    /// The smoothed surface of the largest piece, drawn towards the target.
    fn finish(&self, mut voxels: Voxels, h: f64, layers: f64) -> Result<Option<Skin>> {
        voxels.keep_largest();
        voxels.fill_cavities();
        voxels.fill_pinches();
        let mut mesh = largest_component(&voxels.surface());
        if mesh.face_count() == 0 {
            return Ok(None);
        }
        let connectivity = Connectivity::of(&mesh)?;
        let stairs = mesh.positions.clone();
        for _ in 0..SMOOTHING {
            relax(&mut mesh, &connectivity);
            for (p, &at) in mesh.positions.iter_mut().zip(&stairs) {
                *p = at + (*p - at).clamp_length_max(MOVED * h);
            }
        }
        project(&self.tree, &mut mesh.positions, ONTO, NEAR * h);
        let mut random = Random::new(0);
        for p in &mut mesh.positions {
            let mut any = || random.between(-JITTER, JITTER);
            *p += h * DVec3::new(any(), any(), any());
        }
        let mesh = mesh.triangulate();
        let tree = Bvh::new(&mesh.positions, &mesh.triangles)?;
        let near = |(p, _): &&(DVec3, DVec3)| tree.closest_within(*p, NEAR * h).is_some();
        let covered = self.samples.par_iter().filter(near).count();
        Ok(Some(Skin {
            mesh,
            euler: connectivity.euler_characteristic(),
            cell: h,
            covered: covered as f64 / self.samples.len().max(1) as f64,
            layers,
        }))
    }
}

/// The connected part with the most faces; vertices that none of them uses are dropped.
fn largest_component(mesh: &PolygonMesh) -> PolygonMesh {
    let mut root: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    fn find(root: &mut [u32], mut v: u32) -> u32 {
        while root[v as usize] != v {
            root[v as usize] = root[root[v as usize] as usize];
            v = root[v as usize];
        }
        v
    }
    for face in mesh.faces() {
        for &v in &face[1..] {
            let (a, b) = (find(&mut root, face[0]), find(&mut root, v));
            root[a.max(b) as usize] = a.min(b);
        }
    }
    let roots: Vec<u32> = mesh.faces().map(|f| find(&mut root, f[0])).collect();
    let mut sizes = vec![0u32; mesh.positions.len()];
    for &r in &roots {
        sizes[r as usize] += 1;
    }
    let largest = sizes.iter().max().copied().unwrap_or_default();
    let first = sizes.iter().position(|&s| s == largest).unwrap_or_default();
    let faces = mesh.faces().zip(&roots);
    let faces = faces.filter(|(_, r)| **r as usize == first);
    let kept = PolygonMesh::from_faces(mesh.positions.clone(), faces.map(|(face, _)| face));
    super::super::without_unused_vertices(&kept.into()).mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    fn refusal(mesh: &TriangleMesh) -> String {
        let skin = Subject::new(mesh, Holes::Bridge)
            .and_then(|subject| subject.skin(0.0).map(|s| s.euler));
        skin.expect_err("no surface").to_string()
    }

    #[test]
    fn what_encloses_nothing_is_refused() {
        assert!(refusal(&TriangleMesh::default()).contains("0 triangles"));
        let mut random = Random::new(1);
        let mut soup = TriangleMesh::default();
        for k in 0..60 {
            let mut point = || DVec3::new(random.uniform(), random.uniform(), random.uniform());
            let at = point();
            soup.positions
                .extend([at, at + 0.1 * point(), at + 0.1 * point()]);
            soup.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
        }
        assert!(refusal(&soup).contains("no surface to wrap"));
    }

    #[test]
    fn the_skin_of_a_torus_is_one_and_lies_on_it() {
        let torus = shapes::torus(1.0, 0.4, 60, 30).triangulate();
        let subject = Subject::new(&torus, Holes::Bridge).expect("triangles");
        let skin = subject.skin(0.0).expect("a surface");
        assert_eq!((skin.euler, skin.covered), (0, 1.0));
        let near = |p: &DVec3| subject.tree.closest(*p).distance_squared.sqrt();
        let far = skin.mesh.positions.iter().map(near).fold(0.0, f64::max);
        assert!(far < 0.2 * skin.cell, "{far} of {}", skin.cell);
    }

    #[test]
    fn a_sheet_is_wrapped_on_both_sides() {
        let mut sheet = shapes::sphere(1.0, 4);
        let positions = sheet.positions.clone();
        sheet
            .triangles
            .retain(|t| t.iter().all(|&v| positions[v as usize].z > 0.6));
        let subject = Subject::new(&sheet, Holes::Bridge).expect("triangles");
        assert_eq!(subject.skin(0.0).expect("a surface").euler, 2);
    }
}
