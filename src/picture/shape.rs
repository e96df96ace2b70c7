use crate::mesh::{PolygonMesh, TriangleMesh};
use glam::DVec3;

/// The cosine of the angle between triangles from which on their common edge looks sharp: 45°.
const SHARP: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Stars of more triangles than this are smooth: comparing all pairs would be slow, and such a vertex is the tip of a fan.
const LARGE_STAR: usize = 64;

/// Triangles as they are drawn: every vertex has one normal, so that a mesh's vertices on sharp edges are there more than once.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Shape {
    /// `[vertices]`.
    pub positions: Vec<DVec3>,
    /// `[vertices]`: unit normals; zero where there is none.
    pub normals: Vec<DVec3>,
    /// `[vertices]`: the vertex of the mesh that each stands for.
    pub sources: Vec<u32>,
    /// `[triangles, 3]`.
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// A curved surface: normals are means over the triangles around a vertex, except across sharp edges.
    pub fn smooth(mesh: &TriangleMesh) -> Self {
        let area: Vec<DVec3> = (0..mesh.triangles.len())
            .map(|t| mesh.area_vector(t))
            .collect();
        let unit: Vec<DVec3> = area.iter().map(|n| n.normalize_or_zero()).collect();
        let mut shape = Self {
            triangles: mesh.triangles.clone(),
            ..Self::default()
        };
        let (offsets, corners) = stars(mesh);
        for (v, ends) in offsets.windows(2).enumerate() {
            let star = &corners[ends[0]..ends[1]];
            let first = shape.positions.len();
            for &(t, k) in star {
                let smooth = star.len() > LARGE_STAR;
                let near = |s: u32| smooth || unit[s as usize].dot(unit[t as usize]) > SHARP;
                let together = star.iter().filter(|(s, _)| near(*s));
                // Corners of the same company have the same sum to the bit, and share a vertex.
                let normal: DVec3 = together.map(|&(s, _)| area[s as usize]).sum();
                let normal = normal.normalize_or_zero();
                let known = shape.normals[first..].iter().position(|&n| n == normal);
                let copy = known.map_or_else(
                    || shape.push(mesh.positions[v], normal, v as u32),
                    |at| (first + at) as u32,
                );
                shape.triangles[t as usize][k as usize] = copy;
            }
        }
        shape
    }

    /// A polyhedron: every face has its own normal.
    pub fn faceted(mesh: &PolygonMesh) -> Self {
        let mut shape = Self::default();
        for face in mesh.faces() {
            let corner = |k: usize| mesh.positions[face[k] as usize];
            let part = |k: usize| (corner(k - 1) - corner(0)).cross(corner(k) - corner(0));
            let normal = (2..face.len()).map(part).sum::<DVec3>().normalize_or_zero();
            let first = shape.positions.len() as u32;
            for &v in face {
                shape.push(mesh.positions[v as usize], normal, v);
            }
            let fan = (2..face.len() as u32).map(|k| [first, first + k - 1, first + k]);
            shape.triangles.extend(fan);
        }
        shape
    }

    fn push(&mut self, position: DVec3, normal: DVec3, source: u32) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        self.sources.push(source);
        (self.positions.len() - 1) as u32
    }
}

/// The corners (triangle, 0 to 2) at every vertex, with where each vertex's begin.
fn stars(mesh: &TriangleMesh) -> (Vec<usize>, Vec<(u32, u8)>) {
    let mut offsets = vec![0; mesh.positions.len() + 1];
    for &v in mesh.triangles.as_flattened() {
        offsets[v as usize + 1] += 1;
    }
    for v in 1..offsets.len() {
        offsets[v] += offsets[v - 1];
    }
    let mut free = offsets.clone();
    let mut corners = vec![(0, 0); 3 * mesh.triangles.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for (k, &v) in triangle.iter().enumerate() {
            corners[free[v as usize]] = (t as u32, k as u8);
            free[v as usize] += 1;
        }
    }
    (offsets, corners)
}

/// The edges of a mesh as pairs of vertices, each once, in ascending order.
pub fn edges(mesh: &PolygonMesh) -> Vec<[u32; 2]> {
    let sides = |face: &[u32]| {
        let next = face.iter().cycle().skip(1);
        let sides = face.iter().zip(next).map(|(&a, &b)| [a.min(b), a.max(b)]);
        sides.collect::<Vec<_>>()
    };
    let mut edges: Vec<_> = mesh.faces().flat_map(sides).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn a_box_has_sharp_edges_and_a_ball_has_none() {
        let cube = shapes::box_grid(-DVec3::ONE, DVec3::ONE, [2, 2, 2]);
        let shape = Shape::smooth(&cube.triangulate());
        assert_eq!((cube.positions.len(), shape.positions.len()), (26, 6 * 9));
        assert!(shape.normals.iter().all(|n| n.abs().max_element() == 1.0));
        let faceted = Shape::faceted(&cube);
        assert_eq!(
            (faceted.positions.len(), faceted.triangles.len()),
            (24 * 4, 48)
        );
        for shape in [&shape, &faceted] {
            for (p, &v) in shape.positions.iter().zip(&shape.sources) {
                assert_eq!(*p, cube.positions[v as usize]);
            }
        }
        let ball = shapes::sphere(1.0, 3);
        let shape = Shape::smooth(&ball);
        assert_eq!(shape.positions.len(), ball.positions.len());
        let outward = |(p, n): (&DVec3, &DVec3)| p.dot(*n) > 0.999;
        assert!(shape.positions.iter().zip(&shape.normals).all(outward));
    }

    #[test]
    fn slivers_and_stray_vertices_get_no_normal() {
        let mesh = TriangleMesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
            triangles: vec![[0, 1, 1], [0, 1, 2]],
        };
        let shape = Shape::smooth(&mesh);
        assert_eq!(shape.triangles.len(), 2);
        assert!(
            shape
                .normals
                .iter()
                .all(|n| *n == DVec3::ZERO || *n == DVec3::Z)
        );
        assert_eq!(Shape::smooth(&TriangleMesh::default()), Shape::default());
    }

    #[test]
    fn every_edge_comes_once() {
        let cube = shapes::box_grid(-DVec3::ONE, DVec3::ONE, [1, 1, 1]);
        assert_eq!(edges(&cube).len(), 12);
        assert!(edges(&cube).windows(2).all(|w| w[0] < w[1]));
    }
}
