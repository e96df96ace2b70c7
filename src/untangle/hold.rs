//! What holds the boundary of a mesh: springs to the closest points of a surface, of its curves, or to where vertices were.
//!
//! A spring on a point p with its goal g, on a surface with normal n, is w \[(n · (p − g))² + τ |p − g|²\]/h²; on a curve with tangent t it is
//! |p − g|² − (t · (p − g))² in place of the first square. The second, weaker one keeps vertices from running away along the surface
//! before the goal is looked for again; the middles of faces and edges go without it.

use super::features::{Features, Freedom, boundary_polygons};
use crate::error::Result;
use crate::geometry::Bvh;
use crate::mesh::{TriangleMesh, VolumeMesh};
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// τ, how much weaker springs are along a surface.
const TANGENTIAL: f64 = 0.05;

/// The weight of springs to where a vertex was when they are first needed, and what it grows by.
const FIRST_ANCHOR: f64 = 0.1;
const FIRMER: f64 = 10.0;

/// That of springs to the corners of the boundary.
const CORNER: f64 = 1.0;

/// The share of the tolerance from which on they are needed.
const NEAR_TOLERANCE: f64 = 0.7;

/// What the boundary of a mesh may do.
#[derive(Debug, Clone, Copy)]
pub enum Boundary<'a> {
    /// These vertices stay exactly where they are, all others go anywhere. `[vertices]`.
    Pinned(&'a [bool]),
    /// It slides over itself as it was. Sharp edges keep to their curves, and the corners between those stay exactly where they are. No point
    /// of it moves away from what it was, or the other way round, by more than the tolerance, in the units of the mesh, if the cells allow that.
    Own {
        /// The largest distance.
        tolerance: f64,
    },
    /// It is drawn to a surface.
    Drawn(&'a TriangleMesh),
}

/// A surface or a curve that springs lead to.
struct Ground {
    /// Curves have triangles with two equal corners.
    mesh: TriangleMesh,
    tree: Bvh,
    is_curve: bool,
}

/// The mean of some vertices, which is to lie on a ground.
struct Spot {
    vertices: Vec<u32>,
    ground: u32,
}

/// A spring: (p − g)ᵀ M (p − g).
struct Spring {
    vertices: Vec<u32>,
    goal: DVec3,
    metric: DMat3,
}

/// All that holds the boundary.
pub(super) struct Hold {
    /// `[vertices]`: the vertices that do not move.
    pinned: Vec<bool>,
    grounds: Vec<Ground>,
    /// By ground.
    spots: Vec<Spot>,
    /// `[vertices]`: 1/h².
    inverse_squares: Vec<f64>,
    /// The vertices of the boundary that are also drawn to where they were, and how firmly.
    anchors: BTreeMap<u32, f64>,
    start: Vec<DVec3>,
    faces: Vec<Vec<u32>>,
    tolerance: f64,
    springs: Vec<Spring>,
    /// The weight of a spring where all is told.
    unit: f64,
}

impl Hold {
    /// `sizes` are the lengths h of edges about each vertex. `[vertices]`.
    pub fn new(mesh: &VolumeMesh, sizes: &[f64], boundary: Boundary<'_>) -> Result<Self> {
        let mut hold = Self {
            pinned: vec![false; mesh.positions.len()],
            grounds: Vec::new(),
            spots: Vec::new(),
            inverse_squares: sizes.iter().map(|h| h.powi(-2)).collect(),
            anchors: BTreeMap::new(),
            start: mesh.positions.clone(),
            faces: boundary_polygons(mesh),
            tolerance: f64::INFINITY,
            springs: Vec::new(),
            unit: 0.0,
        };
        match boundary {
            Boundary::Pinned(pinned) => hold.pinned.copy_from_slice(pinned),
            Boundary::Own { tolerance } => {
                hold.tolerance = tolerance;
                hold.lead_to_itself()?;
            }
            Boundary::Drawn(target) => {
                hold.grounds.push(Ground::new(target.clone(), false)?);
                let mut vertices: Vec<u32> = hold.faces.iter().flatten().copied().collect();
                vertices.sort_unstable();
                vertices.dedup();
                let middles = hold.faces.iter().cloned();
                let spots = vertices.into_iter().map(|v| vec![v]).chain(middles);
                hold.spots.extend(spots.map(|vertices| Spot {
                    vertices,
                    ground: 0,
                }));
            }
        }
        let of_vertices = hold.spots.iter().filter(|s| s.vertices.len() == 1).count();
        hold.unit = 2.0 * mesh.cell_count() as f64 / of_vertices.max(1) as f64;
        Ok(hold)
    }

    fn lead_to_itself(&mut self) -> Result<()> {
        let features = Features::of(&self.start, &self.faces);
        let mut triangles = vec![Vec::new(); features.patch_count];
        for (face, &patch) in self.faces.iter().zip(&features.patches) {
            triangles[patch as usize].extend(corners(&self.start, face));
        }
        let mut segments = vec![Vec::new(); features.curve_count];
        for &([a, b], curve) in &features.edges {
            segments[curve as usize].push([a, b, b].map(|v| self.start[v as usize]));
        }
        let first_curve = triangles.len() as u32;
        for (k, triangles) in triangles.into_iter().chain(segments).enumerate() {
            self.grounds
                .push(Ground::new(mesh_of(&triangles), k >= first_curve as usize)?);
        }
        for (&v, &freedom) in &features.vertices {
            let ground = match freedom {
                Freedom::Patch(patch) => patch,
                Freedom::Curve(curve) => first_curve + curve,
                Freedom::Corner => {
                    self.anchors.insert(v, CORNER);
                    continue;
                }
            };
            self.spots.push(Spot {
                vertices: vec![v],
                ground,
            });
        }
        for (face, &ground) in self.faces.iter().zip(&features.patches) {
            self.spots.push(Spot {
                vertices: face.clone(),
                ground,
            });
        }
        for &(edge, curve) in &features.edges {
            self.spots.push(Spot {
                vertices: edge.to_vec(),
                ground: first_curve + curve,
            });
        }
        self.spots.sort_by_key(|spot| spot.ground);
        Ok(())
    }

    /// Whether a vertex stays where it is.
    pub fn pins(&self, v: usize) -> bool {
        self.pinned[v]
    }

    /// Whether the boundary may move by a tolerance at most.
    pub fn is_bounded(&self) -> bool {
        self.tolerance.is_finite()
    }

    /// Looks for the goals of all springs again, `weight` the weight of those across a surface.
    pub fn refresh(&mut self, x: &[DVec3], weight: f64) {
        let weight = weight * self.unit;
        self.springs.clear();
        for spots in self.spots.chunk_by(|a, b| a.ground == b.ground) {
            let ground = &self.grounds[spots[0].ground as usize];
            let points: Vec<DVec3> = spots.iter().map(|s| middle(x, &s.vertices)).collect();
            for (spot, found) in spots.iter().zip(ground.tree.closest_all(&points)) {
                let along = if spot.vertices.len() == 1 {
                    TANGENTIAL
                } else {
                    0.0
                };
                let metric =
                    ground.across(found.triangle) + DMat3::from_diagonal(DVec3::splat(along));
                self.springs.push(Spring {
                    vertices: spot.vertices.clone(),
                    goal: found.point,
                    metric: metric * (weight * self.inverse_square(&spot.vertices)),
                });
            }
        }
        for (&v, &firmness) in &self.anchors {
            let scale = weight * firmness * self.inverse_square(&[v]);
            self.springs.push(Spring {
                vertices: vec![v],
                goal: self.start[v as usize],
                metric: DMat3::from_diagonal(DVec3::splat(scale)),
            });
        }
    }

    fn inverse_square(&self, vertices: &[u32]) -> f64 {
        let sum: f64 = vertices
            .iter()
            .map(|&v| self.inverse_squares[v as usize])
            .sum();
        sum / vertices.len() as f64
    }

    /// Adds the energy of all springs, and takes away what would move what is pinned.
    pub fn add(&self, x: &[DVec3], value: &mut f64, gradient: &mut [DVec3]) {
        for spring in &self.springs {
            let distance = middle(x, &spring.vertices) - spring.goal;
            let pull = spring.metric * distance;
            *value += distance.dot(pull);
            for &v in &spring.vertices {
                gradient[v as usize] += 2.0 / spring.vertices.len() as f64 * pull;
            }
        }
        for (g, _) in gradient
            .iter_mut()
            .zip(&self.pinned)
            .filter(|(_, pinned)| **pinned)
        {
            *g = DVec3::ZERO;
        }
    }

    /// Adds the second derivatives of all springs to the blocks of single vertices.
    pub fn add_curvatures(&self, blocks: &mut [DMat3]) {
        for spring in &self.springs {
            let share = 2.0 / (spring.vertices.len() as f64).powi(2);
            for &v in &spring.vertices {
                blocks[v as usize] += spring.metric * share;
            }
        }
    }

    /// Draws vertices more firmly to where they were, where the boundary is further from what it was than it may be. Returns whether
    /// there were any.
    pub fn tighten(&mut self, x: &[DVec3]) -> Result<bool> {
        if !self.is_bounded() {
            return Ok(false);
        }
        let allowed = NEAR_TOLERANCE * self.tolerance;
        let mut moved = vec![false; x.len()];
        let mut mark = |face: &[u32]| face.iter().for_each(|&v| moved[v as usize] = true);
        for (from, to) in [(x, &self.start[..]), (&self.start[..], x)] {
            let parts: Vec<[DVec3; 3]> = self.faces.iter().flat_map(|f| corners(to, f)).collect();
            let owners: Vec<&Vec<u32>> = self
                .faces
                .iter()
                .flat_map(|f| vec![f; corners(to, f).len()])
                .collect();
            let surface = mesh_of(&parts);
            let tree = Bvh::new(&surface.positions, &surface.triangles)?;
            for face in &self.faces {
                for found in tree.closest_all(&samples(from, face)) {
                    if found.distance_squared > allowed * allowed {
                        mark(face);
                        mark(owners[found.triangle as usize]);
                    }
                }
            }
        }
        let mut any = false;
        for v in (0..x.len()).filter(|&v| moved[v] && !self.pinned[v]) {
            let firmness = self
                .anchors
                .entry(v as u32)
                .or_insert(FIRST_ANCHOR / FIRMER);
            *firmness *= FIRMER;
            any = true;
        }
        Ok(any)
    }
}

impl Ground {
    fn new(mesh: TriangleMesh, is_curve: bool) -> Result<Self> {
        Ok(Self {
            tree: Bvh::new(&mesh.positions, &mesh.triangles)?,
            mesh,
            is_curve,
        })
    }

    /// The projection to the directions that lead away from it.
    fn across(&self, triangle: u32) -> DMat3 {
        let outer = |d: DVec3| DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        if self.is_curve {
            let [a, b, _] = self.mesh.corners(triangle as usize);
            return DMat3::IDENTITY - outer((b - a).normalize_or_zero());
        }
        outer(self.mesh.area_vector(triangle as usize).normalize_or_zero())
    }
}

/// A polygon as triangles; a quad, which is curved, as four around its middle.
fn corners(x: &[DVec3], face: &[u32]) -> Vec<[DVec3; 3]> {
    let at = |k: usize| x[face[k % face.len()] as usize];
    if face.len() == 3 {
        return vec![[at(0), at(1), at(2)]];
    }
    let center = middle(x, face);
    (0..face.len())
        .map(|k| [center, at(k), at(k + 1)])
        .collect()
}

/// Triangles that share no vertices.
fn mesh_of(triangles: &[[DVec3; 3]]) -> TriangleMesh {
    TriangleMesh {
        positions: triangles.as_flattened().to_vec(),
        triangles: (0..triangles.len() as u32)
            .map(|t| [0, 1, 2].map(|k| 3 * t + k))
            .collect(),
    }
}

fn middle(x: &[DVec3], vertices: &[u32]) -> DVec3 {
    vertices.iter().map(|&v| x[v as usize]).sum::<DVec3>() / vertices.len() as f64
}

/// Points of a polygon where it may be furthest from others: its corners, and the middles of its edges and of the triangles that it is made of.
fn samples(x: &[DVec3], face: &[u32]) -> Vec<DVec3> {
    let parts = corners(x, face);
    let of_part = |[a, b, c]: &[DVec3; 3]| [*b, b.midpoint(*c), *a, (a + b + c) / 3.0];
    parts.iter().flat_map(of_part).collect()
}
