//! A fine closed surface around a target: the boundary of what is inside it, by winding number, on a grid.
//!
//! The inside is where the winding number is above a threshold; ½ for closed targets, less where sheets are missing. Scans that overlap go round each point several times, but
//! not everywhere as often: each triangle counts only as the share of its place that it has, by the jump of the winding number across it ([`winding_numbers`]). Where no threshold
//! gives a surface near all of the target (an open sheet, a double wall), the inside is what is near it. The genus of such a surface is not monotone in the grid's resolution, so two
//! are asked, and a finer one where they do not agree, unless that is the one that fills with handles.

use super::super::network::halve_long_edges;
use super::super::torus::area_covariance;
use super::super::voxels::{Grid, Voxels};
use super::opening::onto_rim;
use super::quads::{project, relax};
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

/// Cells for a double wall that only the finest of these has found: between its sides there are still handles, which this one sees through (snowden's 18).
const WALL_CELLS: f64 = 256.0;

/// Thresholds on the winding number, for one layer. Never lower: handles appear.
const THRESHOLDS: [f64; 3] = [0.5, 0.35, 0.25];

/// A target of so many layers and more overlaps itself; and how many samples are asked for them.
const LAYERS: f64 = 1.1;
const LAYERS_SAMPLES: usize = 2_000;

/// How far from the target its layers are counted, in diagonals: farther than scans are apart, nearer than the other side of a wall.
const ACROSS: f64 = 0.004;

/// A finer grid with more handles than this beyond those that the coarser one has seen sees the gaps of a double wall.
const MOST_HANDLES: i64 = 24;

/// The share of the target that must be near the skin for a threshold to be taken, and for there to be a surface at all: of a hundred loose triangles
/// 50 to 70 % are near the largest piece.
const COVERED: f64 = 0.99;
/// The share that is taken rather than wrap a target on both sides: range scans have flaps and spikes that nothing encloses.
const NEARLY_COVERED: f64 = 0.95;
const SURFACE: f64 = 0.9;

/// A piece of what is inside is kept if it has this share of the cubes of the largest: less are crumbs. Of more pieces than so many the smaller ones are left out, and
/// all but one of what nothing encloses, or loose triangles would make a surface.
const PIECE: f64 = 0.01;
const MOST_PIECES: usize = 8;

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
    /// How many times the target goes around its inside in the mean; 1 unless it is clearly more.
    pub layers: f64,
    /// Area samples.
    samples: Vec<DVec3>,
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
    /// Whether it is of winding numbers: sheets that are wrapped at a distance have one side for both of the skin's.
    pub enclosed: bool,
}

impl<'a> Subject<'a> {
    /// Prepares a target, of which rims may be followed.
    ///
    /// # Errors
    /// Where it has no triangle.
    pub fn new(mesh: &'a TriangleMesh, holes: Holes) -> Result<Self> {
        let samples = sample_by_area(mesh, SAMPLES, 0);
        let (lo, hi) = mesh.bounding_box().unwrap_or_default();
        let (winding, layers) = winding_numbers(mesh, ACROSS * (hi - lo).length());
        Ok(Self {
            tree: Bvh::new(&mesh.positions, &mesh.triangles)?,
            bounds: (lo, hi),
            winding,
            layers,
            samples: samples
                .iter()
                .map(|s| s.position(mesh.corners(s.triangle as usize)))
                .collect(),
            rim: match holes {
                Holes::Bridge | Holes::Leave => None,
                Holes::Follow => Rim::of(mesh),
            },
            mesh,
        })
    }

    /// Moves the vertices of a mesh a share of the way onto the target, on the side that they face if it is `enclosed`, and those of its border onto the rim; none that
    /// is further from there than `reach`.
    pub fn draw_on(
        &self,
        mesh: &mut PolygonMesh,
        connectivity: &Connectivity,
        share: f64,
        reach: f64,
        enclosed: bool,
    ) {
        project(self.mesh, &self.tree, mesh, share, reach, enclosed);
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
        let is_wall = |b: &Skin, c: &Skin| !b.enclosed && c.enclosed;
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
                    (Some(b), Some(c)) if is_wall(&b, &c) => {
                        self.skin_of(WALL_CELLS * finest / CELLS[2])?
                    }
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

    /// Whether one of the target's triangles that are `wanted` is no further from a point than this share of the diagonal.
    pub fn has_near(&self, point: DVec3, share: f64, wanted: impl Fn(u32) -> bool) -> bool {
        let reach = share * (self.bounds.1 - self.bounds.0).length();
        self.tree.closest_of(point, reach, wanted).is_some()
    }

    /// How many vertices of the target are further from a skin than this share of the diagonal, and how far the farthest of them is, in diagonals.
    pub fn left_out(&self, skin: &Skin, share: f64) -> Result<Option<(usize, f64)>> {
        let diagonal = (self.bounds.1 - self.bounds.0).length();
        let tree = Bvh::new(&skin.mesh.positions, &skin.mesh.triangles)?;
        let closest = tree.closest_beyond(&self.mesh.positions, share * diagonal);
        let distances = closest.iter().map(|c| c.distance_squared.sqrt() / diagonal);
        let far: Vec<f64> = distances.filter(|d| *d > share).collect();
        let farthest = far.iter().copied().reduce(f64::max);
        Ok(farthest.map(|farthest| (far.len(), farthest)))
    }

    /// The target itself, where it is one closed manifold, which its skin on the grid is not of the topology of: it touches or crosses itself. Edges longer than a cell are halved.
    pub fn itself(&self, skin: &Skin) -> Option<Skin> {
        let connectivity = Connectivity::of(&self.mesh.clone().into()).ok()?;
        let is_closed =
            || (0..connectivity.edge_count() as u32).all(|e| !connectivity.is_boundary_edge(e));
        let euler = connectivity.euler_characteristic();
        if euler == skin.euler || !connectivity.is_connected() || !is_closed() {
            return None;
        }
        let mut mesh = self.mesh.clone();
        halve_long_edges(&mut mesh, skin.cell, |_, _| ());
        Some(Skin {
            mesh,
            euler,
            cell: skin.cell,
            covered: 1.0,
            enclosed: true,
        })
    }

    /// The skin on a grid of so many cells to the diagonal; none where nothing is inside.
    fn skin_of(&self, cells: f64) -> Result<Option<Skin>> {
        let (lo, hi) = self.bounds;
        let grid = Grid::around(self.bounds, (hi - lo).length() / cells);
        let centers = grid.centers();
        let winding = self.winding.at_all(&centers);
        let mut best: Option<Skin> = None;
        for threshold in THRESHOLDS {
            let inside = winding.iter().map(|&w| w > threshold).collect();
            let skin = self.finish(Voxels::new(&grid, inside), grid.h, true)?;
            let Some(skin) = skin else { continue };
            log::debug!(
                "winding numbers above {threshold} at {cells} cells to the diagonal: Euler characteristic {}, {:.1} % of the target near",
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
        let skin = self.finish(voxels, grid.h, false)?;
        let covered = skin.as_ref().map_or(0.0, |s| s.covered);
        log::info!(
            "automatic template: no winding number encloses the target at {cells} cells to the diagonal; {:.0} % lie near what is within {NEAR} cells of it",
            100.0 * covered
        );
        Ok(skin)
    }

    /// The smoothed surface of the larger pieces, drawn towards the target.
    fn finish(&self, mut voxels: Voxels, h: f64, enclosed: bool) -> Result<Option<Skin>> {
        voxels.keep_large(if enclosed { MOST_PIECES } else { 1 }, PIECE);
        voxels.fill_cavities();
        voxels.fill_pinches();
        let mut mesh = without_cavities(voxels.surface())?;
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
        project(self.mesh, &self.tree, &mut mesh, ONTO, NEAR * h, enclosed);
        let mut random = Random::new(0);
        for p in &mut mesh.positions {
            let mut any = || random.between(-JITTER, JITTER);
            *p += h * DVec3::new(any(), any(), any());
        }
        let mesh = mesh.triangulate();
        let tree = Bvh::new(&mesh.positions, &mesh.triangles)?;
        let near = |p: &&DVec3| tree.closest_within(**p, NEAR * h).is_some();
        let covered = self.samples.par_iter().filter(near).count();
        Ok(Some(Skin {
            mesh,
            euler: connectivity.euler_characteristic(),
            cell: h,
            covered: covered as f64 / self.samples.len().max(1) as f64,
            enclosed,
        }))
    }
}

/// The winding numbers of a target, and how many times it goes around its inside in the mean; where that is more than once, with each triangle counted as its share of
/// the layers at its place.
fn winding_numbers(mesh: &TriangleMesh, distance: f64) -> (WindingNumbers, f64) {
    let plain = WindingNumbers::of(mesh);
    // The jump of the winding number across triangles.
    let jumps = |triangles: &[u32]| -> Vec<f64> {
        let side = |sign: f64| {
            let beside = |&t: &u32| {
                let normal = mesh.area_vector(t as usize).normalize_or_zero();
                mesh.corners(t as usize).iter().sum::<DVec3>() / 3.0 + sign * distance * normal
            };
            plain.at_all(&triangles.iter().map(beside).collect::<Vec<_>>())
        };
        let (inner, outer) = (side(-1.0), side(1.0));
        inner.iter().zip(outer).map(|(a, b)| a - b).collect()
    };
    let some = sample_by_area(mesh, LAYERS_SAMPLES, 0);
    let some: Vec<u32> = some.iter().map(|s| s.triangle).collect();
    let layers = jumps(&some).iter().sum::<f64>() / some.len().max(1) as f64;
    if layers < LAYERS {
        return (plain, 1.0);
    }
    let all: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    let jumps = jumps(&all);
    let counted = WindingNumbers::weighted(mesh, |t| jumps[t].max(1.0).recip());
    (counted, layers)
}

/// The pieces of a closed manifold of squares that enclose something, rather than bound a cavity in it.
fn without_cavities(mesh: PolygonMesh) -> Result<PolygonMesh> {
    let connectivity = Connectivity::of(&mesh)?;
    let corner = |f: usize, k: usize| mesh.positions[connectivity.face(f)[k] as usize];
    let volume = |&f: &usize| {
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| corner(f, k));
        a.dot((c - a).cross(d - b))
    };
    let mut pieces = connectivity.pieces();
    let all = pieces.len();
    pieces.retain(|piece| piece.iter().map(volume).sum::<f64>() > 0.0);
    if pieces.len() == all {
        return Ok(mesh);
    }
    let mut kept: Vec<usize> = pieces.into_iter().flatten().collect();
    kept.sort_unstable();
    let faces = kept.into_iter().map(|f| connectivity.face(f));
    let kept = PolygonMesh::from_faces(mesh.positions.clone(), faces);
    Ok(super::super::without_unused_vertices(&kept.into()).mesh)
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

    /// Most of it by several scans, the rest by one.
    #[test]
    fn what_one_scan_has_seen_is_inside_beside_what_six_have() {
        let mut torus = shapes::torus(1.0, 0.4, 60, 30).triangulate();
        let half = torus.triangles[..1800].to_vec();
        for _ in 1..6 {
            torus.triangles.extend(&half);
        }
        let subject = Subject::new(&torus, Holes::Leave).expect("triangles");
        assert!((3.0..6.0).contains(&subject.layers), "{}", subject.layers);
        let skin = subject.skin(0.0).expect("a surface");
        assert_eq!((skin.euler, skin.covered), (0, 1.0));
    }
}
