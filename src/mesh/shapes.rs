//! Generated shapes: grids that templates start from, and surfaces whose area and distance are known exactly.

use super::{Connectivity, PolygonMesh, TriangleMesh};
use glam::DVec3;
use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

/// The surface of a box as quads, `cells` of them along x, y and z (each at least 1): 2 (ab + bc + ca) + 2 vertices. Faces outwards.
pub fn box_grid(lo: DVec3, hi: DVec3, cells: [u32; 3]) -> PolygonMesh {
    let mut mesh = PolygonMesh::default();
    let mut vertices = HashMap::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (side, j, i) in [0, cells[axis]]
            .into_iter()
            .flat_map(|s| (0..cells[v]).flat_map(move |j| (0..cells[u]).map(move |i| (s, j, i))))
        {
            let mut quad = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[di, dj]| {
                let mut at = [0; 3];
                (at[axis], at[u], at[v]) = (side, i + di, j + dj);
                *vertices.entry(at).or_insert_with(|| {
                    let t = |k: usize| f64::from(at[k]) / f64::from(cells[k]);
                    mesh.positions
                        .push(lo + (hi - lo) * DVec3::new(t(0), t(1), t(2)));
                    mesh.positions.len() as u32 - 1
                })
            });
            if side == 0 {
                quad.reverse();
            }
            mesh.push_face(&quad);
        }
    }
    mesh
}

/// A closed grid of `rings` × `sections` quads (each at least 3) through `point(θ, φ)`, both angles in [0, 2π). Faces outwards where
/// ∂point/∂θ × ∂point/∂φ does.
pub fn torus_grid(rings: u32, sections: u32, point: impl Fn(f64, f64) -> DVec3) -> PolygonMesh {
    let angle = |k: u32, n: u32| TAU * f64::from(k) / f64::from(n);
    let positions = (0..rings)
        .flat_map(|i| (0..sections).map(move |j| (i, j)))
        .map(|(i, j)| point(angle(i, rings), angle(j, sections)))
        .collect();
    let mut mesh = PolygonMesh::new(positions);
    for (i, j) in (0..rings).flat_map(|i| (0..sections).map(move |j| (i, j))) {
        let at = |di: u32, dj: u32| (i + di) % rings * sections + (j + dj) % sections;
        mesh.push_face(&[at(0, 0), at(1, 0), at(1, 1), at(0, 1)]);
    }
    mesh
}

/// A torus around the z axis: `major` from the axis to the middle of the tube, `minor` the tube's radius. Area 4 π² major minor in the limit.
pub fn torus(major: f64, minor: f64, rings: u32, sections: u32) -> PolygonMesh {
    torus_grid(rings, sections, |theta, phi| {
        let out = major + minor * phi.cos();
        DVec3::new(out * theta.cos(), out * theta.sin(), minor * phi.sin())
    })
}

/// The sphere around the origin as an icosahedron split `levels` times: 20 · 4^levels triangles, vertices on the sphere.
pub fn sphere(radius: f64, levels: usize) -> TriangleMesh {
    let mut mesh = icosahedron();
    for _ in 0..levels {
        mesh = split(&mesh);
    }
    for p in &mut mesh.positions {
        *p = radius * p.normalize();
    }
    mesh
}

/// A lobed ball around the origin that is smooth and star-shaped, as an icosahedron split `levels` times; a radial surface
/// |p| = r(p/|p|), see [`lobed_radius`].
pub fn lobed_ball(levels: usize) -> TriangleMesh {
    let mut mesh = sphere(1.0, levels);
    for p in &mut mesh.positions {
        *p *= lobed_radius(*p);
    }
    mesh
}

/// The radius of the [`lobed_ball`] in the direction of a unit vector (x, y, z):
/// 1 + ¼ (x⁴ + y⁴ + z⁴ − 0.6) + ¾ xyz + 0.1 z (1 − 3 x²).
pub fn lobed_radius(direction: DVec3) -> f64 {
    let DVec3 { x, y, z } = direction;
    let fourth = (direction * direction).length_squared();
    1.0 + 0.25 * (fourth - 0.6) + 0.75 * x * y * z + 0.1 * z * (1.0 - 3.0 * x * x)
}

fn icosahedron() -> TriangleMesh {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let mut positions = Vec::new();
    for axis in 0..3 {
        for (a, b) in [
            (1.0, golden),
            (1.0, -golden),
            (-1.0, golden),
            (-1.0, -golden),
        ] {
            let mut p = [0.0; 3];
            (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (a, b);
            positions.push(DVec3::from(p));
        }
    }
    // The faces are the triples at mutual distance 2, each turned outwards.
    let near = |a: usize, b: usize| (positions[a].distance(positions[b]) - 2.0).abs() < 1e-9;
    let mut triangles = Vec::new();
    for c in 0..12 {
        for (a, b) in (0..c).flat_map(|b| (0..b).map(move |a| (a, b))) {
            if near(a, b) && near(b, c) && near(c, a) {
                let volume = positions[a].dot(positions[b].cross(positions[c]));
                let (b, c) = if volume > 0.0 { (b, c) } else { (c, b) };
                triangles.push([a as u32, b as u32, c as u32]);
            }
        }
    }
    TriangleMesh {
        positions,
        triangles,
    }
}

/// Every triangle cut into four, the new vertices normalized: great circles stay evenly divided.
fn split(mesh: &TriangleMesh) -> TriangleMesh {
    let polygons = PolygonMesh::from(mesh.clone());
    let connectivity = Connectivity::of(&polygons).expect("an icosahedron is a manifold");
    let mut positions = polygons.positions;
    let base = positions.len() as u32;
    for e in 0..connectivity.edge_count() as u32 {
        let [a, b] = connectivity
            .ends(e)
            .map(|v| positions[v as usize].normalize());
        positions.push((a + b).normalize());
    }
    let mut triangles = Vec::with_capacity(4 * mesh.triangles.len());
    for (t, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        let first = 3 * t as u32;
        let [ab, bc, ca] = [0, 1, 2].map(|k| base + connectivity.edge_of(first + k));
        triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    TriangleMesh {
        positions,
        triangles,
    }
}

/// A box with rounded edges around the origin, with its exact area and distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundedBox {
    /// Half the box's size along each axis.
    pub half: DVec3,
    /// The radius of the rounding, at most the smallest half size.
    pub radius: f64,
}

impl RoundedBox {
    /// Its surface as quads, `cells` along each axis, vertices on the surface.
    pub fn grid(&self, cells: [u32; 3]) -> PolygonMesh {
        let mut mesh = box_grid(-self.half, self.half, cells);
        let core = self.core();
        for p in &mut mesh.positions {
            let inner = p.clamp(-core, core);
            *p = inner + self.radius * (*p - inner).normalize_or_zero();
        }
        mesh
    }

    /// Its area.
    pub fn area(&self) -> f64 {
        let DVec3 { x, y, z } = self.core();
        8.0 * (x * y + y * z + z * x) + 4.0 * PI * self.radius * (x + y + z + self.radius)
    }

    /// The distance of a point from its surface, negative inside.
    pub fn distance(&self, p: DVec3) -> f64 {
        let q = p.abs() - self.core();
        q.max(DVec3::ZERO).length() + q.max_element().min(0.0) - self.radius
    }

    /// Half the size of the box that the rounding is added to.
    fn core(&self) -> DVec3 {
        self.half - DVec3::splat(self.radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn euler(mesh: &PolygonMesh) -> i64 {
        let connectivity = Connectivity::of(mesh).unwrap();
        connectivity.validate().unwrap();
        connectivity.euler_characteristic()
    }

    /// Six times the enclosed volume: positive where the faces look outwards.
    fn volume(mesh: &TriangleMesh) -> f64 {
        let corners = (0..mesh.triangles.len()).map(|t| mesh.corners(t));
        corners.map(|[a, b, c]| a.dot(b.cross(c))).sum::<f64>() / 6.0
    }

    #[test]
    fn a_box_grid_is_a_closed_box() {
        for cells in [[1, 1, 1], [8, 8, 8], [2, 3, 5]] {
            let [a, b, c] = cells.map(|n| n as usize);
            let mesh = box_grid(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0), cells);
            assert_eq!(mesh.positions.len(), 2 * (a * b + b * c + c * a) + 2);
            assert_eq!(euler(&mesh), 2);
            let triangles = mesh.triangulate();
            assert!((triangles.area() - 22.0).abs() < 1e-12);
            assert!((volume(&triangles) - 6.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_torus_has_its_area_and_topology() {
        let mesh = torus(2.0, 0.5, 400, 100);
        assert_eq!(euler(&mesh), 0);
        let triangles = mesh.triangulate();
        assert!((triangles.area() / (4.0 * PI * PI) - 1.0).abs() < 1e-3);
        assert!((volume(&triangles) / (PI * PI) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn spheres_converge_to_the_sphere() {
        for (levels, tolerance) in [(0, 0.3), (3, 6e-3), (5, 4e-4)] {
            let mesh = sphere(2.0, levels);
            assert_eq!(mesh.triangles.len(), 20 << (2 * levels));
            assert_eq!(euler(&mesh.clone().into()), 2);
            assert!(
                mesh.positions
                    .iter()
                    .all(|p| (p.length() - 2.0).abs() < 1e-15 * 4.0)
            );
            assert!((mesh.area() / (16.0 * PI) - 1.0).abs() < tolerance);
            assert!(volume(&mesh) > 0.0);
        }
    }

    #[test]
    fn a_rounded_box_has_its_area_and_distance() {
        let shape = RoundedBox {
            half: DVec3::new(1.0, 0.8, 0.6),
            radius: 0.25,
        };
        let mesh = shape.grid([80, 64, 48]);
        assert!(
            mesh.positions
                .iter()
                .all(|&p| shape.distance(p).abs() < 1e-15)
        );
        let area = mesh.triangulate().area();
        assert!((area / shape.area() - 1.0).abs() < 2e-3, "{area}");
        assert_eq!(shape.distance(DVec3::new(3.0, 0.0, 0.0)), 2.0);
        assert!((shape.distance(DVec3::ZERO) + 0.6).abs() < 1e-15);
        let ball = RoundedBox {
            half: DVec3::ONE,
            radius: 1.0,
        };
        assert!((ball.area() - 4.0 * PI).abs() < 1e-14);
    }
}
