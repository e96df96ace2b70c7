//! How far surfaces are apart: sampled figures, and an interval that is certain to hold the Hausdorff distance. How good the elements of a
//! volume are: scaled Jacobians, and certificates that they are nowhere inverted.

mod cage;
mod chebyshev;
pub mod distance;
mod hausdorff;
mod mended;
mod rim;
mod sampling;
pub mod scaled_jacobian;
pub mod surface_error;
mod truncation;
pub mod validity;

pub use cage::least_angle;
pub use distance::{Comparison, Options, compare};
pub use hausdorff::Interval;
pub use mended::Mended;
pub use rim::{Rim, RimError, RimPoint, rim_error};
pub use sampling::Figures;
pub use surface_error::{Boundary, SurfaceError, distances, point_error, surface_error};

/// Surfaces with known distances.
#[cfg(test)]
mod shapes {
    use crate::mesh::TriangleMesh;
    use glam::DVec3;

    /// The square from the origin to (`side`, `side`, 0) as n² cells of two triangles.
    pub fn grid(n: u32, side: f64) -> TriangleMesh {
        let step = side / f64::from(n);
        let positions = (0..(n + 1) * (n + 1))
            .map(|k| DVec3::new(f64::from(k % (n + 1)), f64::from(k / (n + 1)), 0.0) * step)
            .collect();
        let triangles = (0..n * n)
            .map(|k| k / n * (n + 1) + k % n)
            .flat_map(|a| [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]])
            .collect();
        TriangleMesh {
            positions,
            triangles,
        }
    }

    /// An octahedron of radius 1 with each face cut into n² triangles, pushed out to the sphere.
    pub fn sphere(n: u32) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        for octant in 0..8 {
            let sign = |bit: u32| if octant >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let at = |i: u32, j: u32| {
                let p = DVec3::new(f64::from(n - i - j), f64::from(i), f64::from(j));
                (p * DVec3::new(sign(0), sign(1), sign(2))).normalize()
            };
            let mut push = |corners: [DVec3; 3]| {
                let first = mesh.positions.len() as u32;
                mesh.positions.extend(corners);
                mesh.triangles.push([first, first + 1, first + 2]);
            };
            for i in 0..n {
                for j in 0..n - i {
                    push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                    if i + j + 1 < n {
                        push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                    }
                }
            }
        }
        mesh
    }
}
