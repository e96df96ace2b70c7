//! The automatic volume template: hexahedra in anything that encloses something.
//!
//! **Pipeline.** A fine surface around the target says what is inside, and how many handles there are ([`auto::body`]). Grids of cubes are carved to it ([`super::carve`]): along the
//! coordinate axes and along the principal ones, with the middle of the box at the middle of a cube or between two, in several sizes, with cubes that are inside by half or by less.
//! Of those with the right Euler characteristic and number of elements some that fill the target best, and lose no thin part of it, are pillowed ([`super::pillow`]), and drawn onto the target while all hexahedra
//! are made as good as they can be ([`untangle`]); half of them with an eighth of the elements, each cut into eight afterwards: that has the fewer irregular edges. What has the best
//! angles then is taken.
//!
//! **Handles.** The Euler characteristic of the boundary is that of the fine surface, or the grid is not used: V − E + F is counted on each. Where no grid of the number asked for has it,
//! more elements are taken, with a warning. Handles less than 3.5 % of the diagonal around are closed before.
//!
//! **Measured**, 411 to 480 elements: least and mean scaled Jacobian of the straight-edged cells 0.50 / 0.83 on a bone, 0.30 / 0.83 on a bunny, 0.46 / 0.79 on a double torus, 0.27 / 0.75 on a
//! solid of genus 3; 6 to 10 s of one core. With twelve sizes to either side there are some 130 grids to choose from on solids without handles, 5 on that of genus 3.

use super::super::auto;
use super::super::torus::area_covariance;
use super::super::voxels::Grid;
use super::carve::{carved, shares_inside};
use super::pillow::pillowed;
use super::refine::refined;
use super::{boundary, checked, grid};
use crate::error::{Error, Result};
use crate::geometry::winding::WindingNumbers;
use crate::geometry::{Bvh, eigen};
use crate::mesh::sample::sample_by_area;
use crate::mesh::{Connectivity, PolygonMesh, TriangleMesh, VolumeMesh};
use crate::progress::Silent;
use crate::untangle::{Boundary, Ideals, untangle};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::collections::HashSet;

/// The number of elements where none is asked for.
pub const ELEMENTS: usize = 450;

/// The most that are made.
pub const MOST_ELEMENTS: usize = 100_000;

/// What is inside is kept on a raster of so many cells to the diagonal, or to a cube where that is finer.
const RASTER: f64 = 128.0;
const RASTER_OF_CUBE: f64 = 4.0;

/// The shares of a cube inside, from which on it is kept.
const SHARES: [f64; 4] = [0.2, 0.3, 0.4, 0.5];

/// The number of elements may differ by this share from that asked for; before pinches and cavities are filled, by so many times more.
const TOLERANCE: f64 = 0.1;
const BEFORE_FILLING: f64 = 3.0;

/// Sizes of cubes to either side of that which volume and area suggest, and the ratio of one to the next.
const SIZES: i32 = 12;
const STEP: f64 = 1.03;

/// The area of a surface of cubes against that of what it stands for, about.
const STAIRS: f64 = 1.4;

/// Elements that each element of a coarse candidate is cut into.
const PARTS: [usize; 2] = [1, 8];

/// Candidates that are relaxed, for each number of parts.
const RELAXED: usize = 4;

/// How thick the layer under the boundary is before relaxation, in edges.
const DEPTH: f64 = 0.35;

/// What the least scaled Jacobian counts against the mean one, and what the largest distance of the target does, in edges: a candidate without an ear has better angles.
const LEAST: f64 = 0.3;
const AWAY: f64 = 0.1;

/// What that distance counts against the share of the volume that is amiss, before relaxation: a thin part has little volume.
const LOST: f64 = 0.3;

/// Samples of the target for that distance.
const SAMPLES: usize = 5000;

/// Where no grid has the right handles, there are so many times more elements; and how often.
const GROWTH: f64 = 1.4;
const ATTEMPTS: usize = 6;

/// About `elements` hexahedra (to 10 %) in a target, with its handles and nearly on it.
///
/// The target may have holes, overlaps, several components (the largest is taken) and bad triangles, but should face outwards
/// ([`crate::topology::oriented`]). A few seconds.
///
/// ```
/// use vorofit::mesh::shapes;
/// use vorofit::template::volume::automatic;
///
/// let template = automatic(&shapes::lobed_ball(4), 100)?;
/// assert!((90..=110).contains(&template.cell_count()));
/// # Ok::<(), vorofit::Error>(())
/// ```
///
/// # Errors
/// Where the target has no triangles, or encloses nothing, as a soup does; where no number of elements gives its handles; where `elements` is 0 or more than
/// [`MOST_ELEMENTS`].
pub fn automatic(target: &TriangleMesh, elements: usize) -> Result<VolumeMesh> {
    if !(1..=MOST_ELEMENTS).contains(&elements) {
        return Err(Error::input(
            format!("a template of {elements} elements cannot be made"),
            format!("ask for 1 to {MOST_ELEMENTS}"),
        ));
    }
    let body = Body::of(target)?;
    let mut wanted = elements as f64;
    for _ in 0..ATTEMPTS {
        if let Some(mesh) = body.best(wanted)? {
            if wanted > elements as f64 {
                log::warn!(
                    "no grid of about {elements} elements has the target's handles: there are {}",
                    mesh.cell_count()
                );
            }
            return checked(mesh);
        }
        wanted *= GROWTH;
    }
    Err(Error::input(
        format!(
            "no grid of {elements} to {:.0} elements has the target's handles (Euler characteristic {})",
            wanted / GROWTH,
            body.euler
        ),
        "ask for more elements, or give a grid, a ball or a mesh",
    ))
}

/// A target, and what is inside of it.
struct Body<'a> {
    target: &'a TriangleMesh,
    samples: Vec<DVec3>,
    /// A closed manifold near the target.
    skin: TriangleMesh,
    winding: WindingNumbers,
    /// V − E + F of the skin.
    euler: i64,
    area: f64,
    volume: f64,
}

/// What is inside, along some axes.
struct Raster {
    axes: DMat3,
    /// Along the axes.
    bounds: (DVec3, DVec3),
    grid: Grid,
    inside: Vec<bool>,
}

/// A carved grid.
struct Candidate {
    mesh: VolumeMesh,
    /// The edge of a cube.
    size: f64,
    /// The volume between the cubes and the body, against the body's.
    misfit: f64,
    /// The largest distance of the target from the cubes, in edges.
    away: f64,
}

impl Candidate {
    /// How badly the cubes stand for the target.
    fn badness(&self) -> f64 {
        self.misfit + LOST * self.away
    }
}

impl<'a> Body<'a> {
    fn of(target: &'a TriangleMesh) -> Result<Self> {
        let skin = auto::body(target)?;
        let surface = PolygonMesh::from(skin.clone());
        let corners = (0..skin.triangles.len()).map(|t| skin.corners(t));
        let volume: f64 = corners.map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
        let samples = sample_by_area(target, SAMPLES, 0).into_iter();
        Ok(Self {
            target,
            samples: samples
                .map(|s| s.position(target.corners(s.triangle as usize)))
                .collect(),
            winding: WindingNumbers::of(&skin),
            euler: Connectivity::of(&surface)?.euler_characteristic(),
            area: skin.area(),
            volume: volume.abs(),
            skin,
        })
    }

    /// The best template of about so many elements.
    fn best(&self, elements: f64) -> Result<Option<VolumeMesh>> {
        let finest = self.cube(elements) / STEP.powi(SIZES);
        let principal = eigen::symmetric(area_covariance(self.target)).1;
        let rasters = [DMat3::IDENTITY, principal].map(|axes| self.raster(axes, finest));
        let mut best: Option<(f64, VolumeMesh)> = None;
        for parts in PARTS {
            for candidate in self.candidates(&rasters, elements / parts as f64) {
                let mesh = self.relaxed(&candidate, parts)?;
                let Some((least, mean)) = quality(&mesh) else {
                    continue;
                };
                let away = self.away(&mesh)?;
                log::info!(
                    "automatic template: cubes of {:.4}, {:.0} % of the volume amiss and at most {:.2} edges away, Euler characteristic {}; {} elements, scaled Jacobian at least {least:.3}, mean {mean:.3}, at most {away:.2} edges away",
                    candidate.size,
                    100.0 * candidate.misfit,
                    candidate.away,
                    self.euler,
                    mesh.cell_count()
                );
                let score = mean + LEAST * least - AWAY * away;
                if best.as_ref().is_none_or(|(other, _)| *other < score) {
                    best = Some((score, mesh));
                }
            }
        }
        Ok(best.map(|(_, mesh)| mesh))
    }

    /// The size of the cubes of which so many, with a layer over their surface, fill the body.
    fn cube(&self, elements: f64) -> f64 {
        // V/h³ + a/h² falls as h grows; each term alone gives a bound.
        let area = STAIRS * self.area;
        let (mut small, mut large) = ((self.volume / elements).cbrt(), 0.0);
        large += small + (area / elements).sqrt();
        for _ in 0..40 {
            let h = 0.5 * (small + large);
            match self.volume / h.powi(3) + area / (h * h) > elements {
                true => small = h,
                false => large = h,
            }
        }
        large
    }

    fn raster(&self, axes: DMat3, cube: f64) -> Raster {
        let turned = TriangleMesh {
            positions: (self.skin.positions.iter())
                .map(|p| axes.transpose() * *p)
                .collect(),
            triangles: self.skin.triangles.clone(),
        };
        let bounds = turned.bounding_box().unwrap_or_default();
        let diagonal = (bounds.1 - bounds.0).length();
        let grid = Grid::around(bounds, (diagonal / RASTER).min(cube / RASTER_OF_CUBE));
        let centers: Vec<DVec3> = grid.centers().iter().map(|p| axes * *p).collect();
        let numbers = self.winding.at_all(&centers);
        Raster {
            axes,
            bounds,
            grid,
            inside: numbers.into_iter().map(|w| w > 0.5).collect(),
        }
    }

    /// Carved grids of which so many elements are made by pillowing, those that fill the body best.
    fn candidates(&self, rasters: &[Raster], elements: f64) -> Vec<Candidate> {
        let middle = self.cube(elements);
        let phases = (-SIZES..=SIZES).flat_map(|k| (0..8).map(move |phase| (k, phase)));
        let grids: Vec<(&Raster, f64, u32)> = rasters
            .iter()
            .flat_map(|raster| {
                let sizes = phases.clone();
                sizes.map(move |(k, phase)| (raster, middle * STEP.powi(k), phase))
            })
            .collect();
        let mut found: Vec<Candidate> = grids
            .into_par_iter()
            .flat_map_iter(|(raster, size, phase)| self.carvings(raster, size, phase, elements))
            .collect();
        found.sort_by(|a, b| a.badness().total_cmp(&b.badness()));
        // Neighbouring sizes give the same cubes.
        let mut seen = HashSet::new();
        found.retain(|c| seen.insert((c.mesh.cell_count(), c.mesh.positions.len())));
        found.truncate(RELAXED);
        found
    }

    /// What a grid is carved to, for each share, if it may be used.
    fn carvings(&self, raster: &Raster, size: f64, phase: u32, elements: f64) -> Vec<Candidate> {
        let grid = raster.cubes(size, phase);
        let shares = shares_inside(&grid.mesh, |points| {
            points.iter().map(|p| raster.holds(*p)).collect()
        });
        let close =
            |count: usize, tolerance: f64| (count as f64 - elements).abs() <= tolerance * elements;
        let mut turned = grid.mesh.clone();
        for p in &mut turned.positions {
            *p = raster.axes * *p;
        }
        let usable = |share: f64| {
            let is_inside: Vec<bool> = shares.iter().map(|s| *s >= share).collect();
            if !close(grid.elements(&is_inside), BEFORE_FILLING * TOLERANCE) {
                return None;
            }
            let mesh = carved(&turned, &shares, share).ok()?;
            let surface = boundary(&mesh);
            let euler = Connectivity::of(&surface).ok()?.euler_characteristic();
            let amiss = shares.iter().zip(is_inside);
            let amiss: f64 = amiss.map(|(s, is)| if is { 1.0 - s } else { *s }).sum();
            let count = mesh.cell_count() + surface.face_count();
            if euler != self.euler || !close(count, TOLERANCE) {
                return None;
            }
            Some(Candidate {
                away: self.away(&mesh).ok()?,
                mesh,
                size,
                misfit: amiss * size.powi(3) / self.volume,
            })
        };
        SHARES.into_iter().filter_map(usable).collect()
    }

    /// A candidate pillowed and drawn onto the target, each hexahedron cut into `parts`.
    fn relaxed(&self, candidate: &Candidate, parts: usize) -> Result<VolumeMesh> {
        let cubes = &candidate.mesh;
        let mut mesh = pillowed(cubes, &vec![DEPTH; cubes.positions.len()]);
        // With the layer there are more cells in the same volume.
        let share = cubes.cell_count() as f64 / mesh.cell_count() as f64;
        let mut size = candidate.size * share.cbrt();
        self.relax(&mut mesh, size)?;
        if parts > 1 {
            mesh = refined(&mesh);
            size *= 0.5;
            self.relax(&mut mesh, size)?;
        }
        Ok(mesh)
    }

    /// The largest distance of the target from the boundary, in edges of a cube of the same volume as the mean cell.
    fn away(&self, mesh: &VolumeMesh) -> Result<f64> {
        let surface = boundary(mesh).triangulate();
        let distances =
            Bvh::new(&surface.positions, &surface.triangles)?.closest_all(&self.samples);
        let square = distances.iter().map(|c| c.distance_squared);
        let edge = (self.volume / mesh.cell_count() as f64).cbrt();
        Ok(square.fold(0.0, f64::max).sqrt() / edge)
    }

    fn relax(&self, mesh: &mut VolumeMesh, size: f64) -> Result<()> {
        let ideals = Ideals::regular(mesh, |_| size);
        *mesh = untangle(mesh, &ideals, Boundary::Drawn(self.target), &Silent)?.mesh;
        Ok(())
    }
}

/// A box of cubes.
struct Cubes {
    mesh: VolumeMesh,
    counts: [usize; 3],
}

impl Raster {
    fn holds(&self, p: DVec3) -> bool {
        self.grid.cell_at(p).is_some_and(|cell| self.inside[cell])
    }

    /// Cubes over the bounding box and around it. Bit k of the phase says whether an even number of them is along axis k.
    fn cubes(&self, size: f64, phase: u32) -> Cubes {
        let (lo, hi) = self.bounds;
        let least = ((hi - lo) / size + 2.0).ceil().as_uvec3().to_array();
        let counts: [u32; 3] = std::array::from_fn(|k| least[k] + ((least[k] ^ (phase >> k)) & 1));
        let half = 0.5 * size * DVec3::from(counts.map(f64::from));
        let center = 0.5 * (lo + hi);
        Cubes {
            mesh: grid(center - half, center + half, counts),
            counts: counts.map(|n| n as usize),
        }
    }
}

impl Cubes {
    /// Marked cubes, of which none is on the border, and the squares around them.
    fn elements(&self, marked: &[bool]) -> usize {
        let [nx, ny, _] = self.counts;
        let squares = [1, nx, nx * ny].map(|stride| {
            let pairs = marked.iter().zip(marked.iter().skip(stride));
            pairs.filter(|(a, b)| a != b).count()
        });
        marked.iter().filter(|m| **m).count() + squares.iter().sum::<usize>()
    }
}

/// The least and the mean scaled Jacobian at the corners; none where one is not positive.
fn quality(mesh: &VolumeMesh) -> Option<(f64, f64)> {
    let (mut least, mut sum) = (f64::INFINITY, 0.0);
    for (shape, cell) in mesh.cells() {
        let at = |k: usize| mesh.positions[cell[k] as usize];
        for &[k, a, b, c] in shape.spokes() {
            let [a, b, c] = [a, b, c].map(|l| (at(l) - at(k)).normalize_or_zero());
            let jacobian = a.dot(b.cross(c));
            least = least.min(jacobian);
            sum += jacobian / 8.0;
        }
    }
    (least > 0.0).then(|| (least, sum / mesh.cell_count() as f64))
}
