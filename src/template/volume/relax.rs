//! Hexahedra made good, with their boundary drawn onto a target.
//!
//! **Theory.** Foldover-free maps [V. Garanzha, I. Kaporin, L. Kudryavtseva, F. Protais, N. Ray, D. Sokolov, *Foldover-free maps in 50 lines of code*, 2021]: with J the edges at a corner of a hexahedron over a
//! size h, det J replaced by χ = (det J + √(det² J + ε²))/2, which is positive also where a corner is inverted,
//!
//!   e = [ tr(JᵀJ)/(3 χ^⅔) + θ (1 + det² J)/(2 χ) ] / (1 + θ), θ = 0.1.
//!
//! It is 1 at a cube of edge h and large where a corner is flat; ε shrinks as the worst corner rises. The boundary is drawn by squares of distances to tangent planes of the target, with
//! a weight that rises step by step; it is never projected, which would invert every third cell.
//!
//! **Practice.** A last round with e⁶ in place of e lifts the worst corners.

use super::boundary;
use crate::error::Result;
use crate::geometry::Bvh;
use crate::mesh::{CellShape, PolygonMesh, TriangleMesh, VolumeMesh};
use crate::optimize::Lbfgs;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// The weight of size against shape.
const SIZE: f64 = 0.1;

/// Of a distance along the tangent plane against one across it, so that the boundary does not run off sideways.
const SIDEWAYS: f64 = 0.05;

/// Weights of the boundary, one after the other.
const WEIGHTS: [f64; 6] = [1.0, 3.0, 10.0, 30.0, 100.0, 300.0];

/// Closest points are looked up so many times under each weight, and kept for so many iterations.
const ROUNDS: usize = 6;
const ITERATIONS: usize = 12;

/// The power of the last rounds.
const POWER: i32 = 6;

/// The other ends of the edges at each corner of a hexahedron, right-handed.
pub(super) const EDGES: [[usize; 3]; 8] = [
    [1, 3, 4],
    [2, 0, 5],
    [3, 1, 6],
    [0, 2, 7],
    [7, 5, 0],
    [4, 6, 1],
    [5, 7, 2],
    [6, 4, 3],
];

/// Cells that one task evaluates.
const CHUNK: usize = 64;

/// Hexahedra under relaxation.
pub(super) struct Relaxation<'a> {
    target: &'a TriangleMesh,
    tree: &'a Bvh,
    cells: Vec<[u32; 8]>,
    surface: PolygonMesh,
    /// The vertices of the boundary, ascending.
    outer: Vec<u32>,
    /// The edge of a good hexahedron.
    size: f64,
}

/// A point of the boundary, the mean of some vertices, and where it is drawn.
struct Anchor {
    vertices: Vec<u32>,
    point: DVec3,
    normal: DVec3,
    /// The share of the distance along the tangent plane that counts.
    sideways: f64,
}

impl<'a> Relaxation<'a> {
    /// Of the hexahedra of a mesh, towards a target with its tree.
    pub fn new(mesh: &VolumeMesh, size: f64, target: &'a TriangleMesh, tree: &'a Bvh) -> Self {
        let surface = boundary(mesh);
        let mut outer = surface.corners().to_vec();
        outer.sort_unstable();
        outer.dedup();
        let hexahedra = mesh.cells().filter(|c| c.0 == CellShape::Hexahedron);
        Self {
            target,
            tree,
            cells: hexahedra
                .map(|(_, cell)| std::array::from_fn(|k| cell[k]))
                .collect(),
            surface,
            outer,
            size,
        }
    }

    /// The positions after the boundary was drawn all the way.
    pub fn run(&self, mut x: Vec<DVec3>) -> Result<Vec<DVec3>> {
        for weight in WEIGHTS {
            for _ in 0..ROUNDS {
                x = self.minimize(x, weight, 1)?;
            }
        }
        for _ in 0..ROUNDS {
            x = self.minimize(x, WEIGHTS[WEIGHTS.len() - 1], POWER)?;
        }
        Ok(x)
    }

    fn minimize(&self, x: Vec<DVec3>, weight: f64, power: i32) -> Result<Vec<DVec3>> {
        let anchors = self.anchors(&x);
        let least = self.least_determinant(&x);
        let blunt = match least > 0.02 {
            true => 1e-3,
            false => (1e-3 + 0.04 * least.min(0.0).powi(2)).sqrt(),
        };
        let pull = 2.0 * weight * self.cells.len() as f64 / self.outer.len() as f64;
        let settings = Lbfgs {
            memory: 8,
            iterations: ITERATIONS,
            decrease: 1e-6,
            first_step: 0.05 * self.size,
        };
        let minimum = settings.minimize(
            x,
            |x| Ok::<_, crate::Error>(self.evaluate(x, &anchors, pull, blunt, power)),
            |_| true,
        )?;
        Ok(minimum.x)
    }

    /// Where the vertices of the boundary and the centres of its faces are drawn.
    fn anchors(&self, x: &[DVec3]) -> Vec<Anchor> {
        let vertices = self.outer.iter().map(|&v| (vec![v], SIDEWAYS));
        let centers = self.surface.faces().map(|face| (face.to_vec(), 0.0));
        let points: Vec<_> = vertices.chain(centers).collect();
        points
            .into_par_iter()
            .map(|(vertices, sideways)| {
                let at = mean(x, &vertices);
                let closest = self.tree.closest(at);
                let normal = self.target.area_vector(closest.triangle as usize);
                Anchor {
                    vertices,
                    point: closest.point,
                    normal: normal.normalize_or_zero(),
                    sideways,
                }
            })
            .collect()
    }

    fn jacobian(&self, x: &[DVec3], cell: &[u32; 8], k: usize) -> DMat3 {
        let at = |k: usize| x[cell[k] as usize];
        let [a, b, c] = EDGES[k].map(|l| (at(l) - at(k)) / self.size);
        DMat3::from_cols(a, b, c)
    }

    fn least_determinant(&self, x: &[DVec3]) -> f64 {
        let corners = self
            .cells
            .iter()
            .flat_map(|cell| (0..8).map(move |k| (cell, k)));
        corners
            .map(|(cell, k)| self.jacobian(x, cell, k).determinant())
            .fold(f64::INFINITY, f64::min)
    }

    fn evaluate(
        &self,
        x: &[DVec3],
        anchors: &[Anchor],
        pull: f64,
        blunt: f64,
        power: i32,
    ) -> (f64, Vec<DVec3>) {
        // Each task writes the gradients of its own cells' corners; they are added in order.
        let parts: Vec<(f64, Vec<[DVec3; 8]>)> = self
            .cells
            .par_chunks(CHUNK)
            .map(|cells| {
                let mut value = 0.0;
                let gradients = cells.iter().map(|cell| {
                    let mut gradient = [DVec3::ZERO; 8];
                    for k in 0..8 {
                        let (e, slope) = distortion(self.jacobian(x, cell, k), blunt);
                        value += e.powi(power) / 8.0;
                        let factor = f64::from(power) * e.powi(power - 1) / (8.0 * self.size);
                        for (axis, l) in EDGES[k].into_iter().enumerate() {
                            let push = factor * slope.col(axis);
                            gradient[l] += push;
                            gradient[k] -= push;
                        }
                    }
                    gradient
                });
                let gradients = gradients.collect();
                (value, gradients)
            })
            .collect();
        let mut value = 0.0;
        let mut gradient = vec![DVec3::ZERO; x.len()];
        for ((part, local), cells) in parts.into_iter().zip(self.cells.chunks(CHUNK)) {
            value += part;
            for (local, cell) in local.iter().zip(cells) {
                for (g, &v) in local.iter().zip(cell) {
                    gradient[v as usize] += *g;
                }
            }
        }
        let pull = pull / (self.size * self.size);
        for anchor in anchors {
            let d = mean(x, &anchor.vertices) - anchor.point;
            let across = d.dot(anchor.normal);
            value += pull * (across * across + anchor.sideways * d.length_squared());
            let push = 2.0 * pull * (across * anchor.normal + anchor.sideways * d);
            let share = 1.0 / anchor.vertices.len() as f64;
            for &v in &anchor.vertices {
                gradient[v as usize] += share * push;
            }
        }
        (value, gradient)
    }
}

fn mean(x: &[DVec3], vertices: &[u32]) -> DVec3 {
    let sum: DVec3 = vertices.iter().map(|&v| x[v as usize]).sum();
    sum / vertices.len() as f64
}

/// e of the module's formula and its gradient.
fn distortion(j: DMat3, blunt: f64) -> (f64, DMat3) {
    let det = j.determinant();
    let root = det.hypot(blunt);
    // Without cancellation where det is negative.
    let chi = match det > 0.0 {
        true => 0.5 * (det + root),
        false => 0.5 * blunt * blunt / (root - det),
    };
    let chi_slope = chi / root;
    let square = j.x_axis.length_squared() + j.y_axis.length_squared() + j.z_axis.length_squared();
    let shape = square / (3.0 * chi.cbrt().powi(2));
    let size = (1.0 + det * det) / (2.0 * chi);
    let cofactors = DMat3::from_cols(
        j.y_axis.cross(j.z_axis),
        j.z_axis.cross(j.x_axis),
        j.x_axis.cross(j.y_axis),
    );
    let along_chi = -2.0 / 3.0 * shape / chi - SIZE * size / chi;
    let by_det = along_chi * chi_slope + SIZE * det / chi;
    let gradient = j * (2.0 / (3.0 * chi.cbrt().powi(2))) + cofactors * by_det;
    (
        (shape + SIZE * size) / (1.0 + SIZE),
        gradient * (1.0 / (1.0 + SIZE)),
    )
}

#[cfg(test)]
mod tests {
    use super::super::pillow::pillowed;
    use super::super::{checked, grid};
    use super::*;
    use crate::geometry::random::Random;
    use crate::mesh::shapes;

    fn tree(target: &TriangleMesh) -> Bvh {
        Bvh::new(&target.positions, &target.triangles).unwrap()
    }

    #[test]
    fn a_cube_is_the_best_corner() {
        let (value, gradient) = distortion(DMat3::IDENTITY, 0.0);
        assert!((value - 1.0).abs() < 1e-15);
        assert!(gradient.to_cols_array().iter().all(|g| g.abs() < 1e-15));
        let flat = DMat3::from_cols(DVec3::X, DVec3::Y, DVec3::ZERO);
        let inverted = DMat3::from_cols(DVec3::X, DVec3::Y, -DVec3::Z);
        let values = [flat, inverted].map(|j| distortion(j, 0.1).0);
        assert!(values[0] > 2.0 && values[1] > values[0], "{values:?}");
    }

    #[test]
    fn gradients_are_those_of_the_energy() {
        let mut ball = shapes::sphere(0.8, 2);
        ball.positions.iter_mut().for_each(|p| *p += 0.5);
        let tree = tree(&ball);
        let mut mesh = grid(DVec3::ZERO, DVec3::ONE, [2; 3]);
        let mut random = Random::new(2);
        let mut any = |size: f64| DVec3::from([0; 3].map(|_| random.between(-size, size)));
        // Some corners are inverted.
        mesh.positions.iter_mut().for_each(|p| *p += any(0.3));
        let relaxation = Relaxation::new(&mesh, 0.5, &ball, &tree);
        assert!(relaxation.least_determinant(&mesh.positions) < 0.0);
        let anchors = relaxation.anchors(&mesh.positions);
        let at = |x: &[DVec3]| relaxation.evaluate(x, &anchors, 3.0, 0.3, POWER);
        let (value, gradient) = at(&mesh.positions);
        let direction: Vec<DVec3> = mesh.positions.iter().map(|_| any(1.0)).collect();
        let products = gradient.iter().zip(&direction).map(|(g, d)| g.dot(*d));
        let slope: f64 = products.sum();
        let left_over = [1e-4, 5e-5].map(|step| {
            let moved = mesh.positions.iter().zip(&direction);
            let moved: Vec<DVec3> = moved.map(|(p, d)| *p + step * *d).collect();
            (at(&moved).0 - value - step * slope).abs()
        });
        let order = (left_over[0] / left_over[1]).log2();
        assert!((order - 2.0).abs() < 0.1, "{order}");
    }

    #[test]
    fn a_tangled_pillow_becomes_a_ball() {
        let ball = shapes::sphere(1.0, 4);
        let tree = tree(&ball);
        let cube = grid(DVec3::splat(-0.7), DVec3::splat(0.7), [2; 3]);
        let mut mesh = pillowed(&cube, &[0.3; 27]);
        mesh.positions[13] += DVec3::new(0.9, 0.8, 0.2);
        assert!(checked(mesh.clone()).is_err());
        let relaxation = Relaxation::new(&mesh, 0.5, &ball, &tree);
        mesh.positions = relaxation.run(mesh.positions).unwrap();
        let surface = boundary(&mesh);
        let used: std::collections::BTreeSet<u32> = surface.corners().iter().copied().collect();
        for v in used {
            let radius = mesh.positions[v as usize].length();
            assert!((radius - 1.0).abs() < 0.1, "{radius}");
        }
        checked(mesh).unwrap();
    }
}
