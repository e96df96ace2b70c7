//! From a triangle mesh to quads, and quads onto a target.

use super::matching::Matching;
use crate::error::Result;
use crate::geometry::Bvh;
use crate::mesh::{Connectivity, PolygonMesh, TriangleMesh};
use glam::DVec3;

/// Pairs of triangles worse than this are not taken greedily. In the units of [`badness`]: degrees.
const ACCEPTED: f64 = 75.0;

/// What a degree between the two triangles' normals counts against one of an angle of the quad.
const BEND: f64 = 0.5;

/// Rounds over all vertices in which rings of triangles may be paired the other way.
const ROUNDS: usize = 10;

/// How far [`relax`] moves a vertex towards the middle of its neighbours.
const STEP: f64 = 0.5;

/// The quads of a triangle mesh, two triangles to each. Of a closed mesh no triangle is left over, of an open one there may be some, and they come last.
///
/// # Errors
/// Where the mesh is no oriented manifold.
pub(super) fn paired(mesh: &TriangleMesh) -> Result<PolygonMesh> {
    let connectivity = Connectivity::of(&mesh.clone().into())?;
    let triangles = Triangles {
        positions: &mesh.positions,
        connectivity: &connectivity,
    };
    let neighbours: Vec<[u32; 3]> = (0..mesh.triangles.len())
        .map(|t| triangles.beside(t as u32))
        .collect();
    let mut matching = Matching::new(&neighbours);
    let mut edges: Vec<(f64, u32)> = (0..connectivity.edge_count() as u32)
        .map(|e| (triangles.badness(connectivity.half_edge(e)), e))
        .filter(|(badness, _)| *badness < ACCEPTED)
        .collect();
    edges.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (_, e) in edges {
        let h = connectivity.half_edge(e);
        if let Some(o) = connectivity.opposite(h) {
            matching.pair(connectivity.face_of(h), connectivity.face_of(o));
        }
    }
    matching.complete();
    for _ in 0..ROUNDS {
        let mut turned = false;
        let inner = |v: &u32| !connectivity.is_boundary_vertex(*v);
        for v in (0..mesh.positions.len() as u32).filter(inner) {
            let ring: Vec<u32> = connectivity
                .around(v)
                .map(|h| connectivity.face_of(h))
                .collect();
            turned |= matching.turn_ring(&ring, |a, b| {
                triangles
                    .between(a, b)
                    .map_or(0.0, |h| triangles.badness(h))
            });
        }
        if !turned {
            break;
        }
    }
    let faces = (0..mesh.triangles.len() as u32).filter_map(|t| {
        let mate = matching.mate(t)?;
        let h = (t < mate).then(|| triangles.between(t, mate))??;
        triangles.quad_over(h)
    });
    let inner = |v| !connectivity.is_boundary_vertex(v);
    let singles = (0..mesh.triangles.len()).filter(|&t| matching.mate(t as u32).is_none());
    let singles: Vec<[u32; 3]> = singles.map(|t| mesh.triangles[t]).collect();
    let quads = without_doublets(faces.collect(), |v| {
        inner(v) && !singles.iter().flatten().any(|&u| u == v)
    });
    let mut polygons = PolygonMesh::from_faces(mesh.positions.clone(), quads);
    singles.iter().for_each(|single| polygons.push_face(single));
    Ok(polygons)
}

/// A triangle mesh with its connectivity.
struct Triangles<'a> {
    positions: &'a [DVec3],
    connectivity: &'a Connectivity,
}

impl Triangles<'_> {
    /// The triangles across the edges of a triangle; itself across the boundary.
    fn beside(&self, t: u32) -> [u32; 3] {
        let first = self.connectivity.half_edges(t as usize).start;
        [0, 1, 2].map(|k| {
            let across = self.connectivity.opposite(first + k);
            across.map_or(t, |o| self.connectivity.face_of(o))
        })
    }

    /// The half-edge of triangle `a` at triangle `b`.
    fn between(&self, a: u32, b: u32) -> Option<u32> {
        let mut edges = self.connectivity.half_edges(a as usize);
        edges.find(|&h| {
            let across = self.connectivity.opposite(h);
            across.is_some_and(|o| self.connectivity.face_of(o) == b)
        })
    }

    /// The corners of the quad whose diagonal is a half-edge.
    fn quad_over(&self, h: u32) -> Option<[u32; 4]> {
        let mesh = self.connectivity;
        let o = mesh.opposite(h)?;
        let apex = |h: u32| mesh.origin(mesh.previous(h));
        Some([mesh.origin(h), apex(o), mesh.target(h), apex(h)])
    }

    /// How far the quad over a half-edge is from a flat square: its angle farthest from a right one, and how much it is bent, in degrees.
    fn badness(&self, h: u32) -> f64 {
        let Some(quad) = self.quad_over(h) else {
            return f64::INFINITY;
        };
        let [a, b, c, d] = quad.map(|v| self.positions[v as usize]);
        let corner = |p: DVec3, at: DVec3, q: DVec3| (p - at).angle_between(q - at).to_degrees();
        let angles = [
            corner(d, a, c) + corner(c, a, b),
            corner(a, b, c),
            corner(b, c, a) + corner(a, c, d),
            corner(c, d, a),
        ];
        let skew = angles
            .into_iter()
            .map(|x| (x - 90.0).abs())
            .fold(0.0, f64::max);
        let normals = [(b - a).cross(c - a), (c - a).cross(d - a)];
        let bend = normals[0].angle_between(normals[1]).to_degrees();
        let badness = skew + BEND * bend;
        // Of triangles without area nothing can be said but that they had better go together.
        if badness.is_nan() { 0.0 } else { badness }
    }
}

/// Quads with each two that share a corner of no other quad merged into one, where that corner `may_go`.
fn without_doublets(mut quads: Vec<[u32; 4]>, may_go: impl Fn(u32) -> bool) -> Vec<[u32; 4]> {
    let vertices = quads.iter().flatten().max().map_or(0, |&v| v as usize + 1);
    loop {
        // The first two faces at each vertex, and how many there are.
        let mut faces = vec![([usize::MAX; 2], 0); vertices];
        for (f, quad) in quads.iter().enumerate() {
            for &v in quad {
                let (first, count) = &mut faces[v as usize];
                if *count < 2 {
                    first[*count] = f;
                }
                *count += 1;
            }
        }
        let mut gone = vec![false; quads.len()];
        for (v, ([f, g], count)) in faces.into_iter().enumerate() {
            if count != 2 || gone[f] || gone[g] || !may_go(v as u32) {
                continue;
            }
            let at = |quad: &[u32; 4]| quad.iter().position(|&u| u as usize == v);
            let (Some(i), Some(j)) = (at(&quads[f]), at(&quads[g])) else {
                continue;
            };
            let across = quads[g][(j + 2) % 4];
            if !quads[f].contains(&across) {
                quads[f][i] = across;
                gone[g] = true;
            }
        }
        if !gone.contains(&true) {
            return quads;
        }
        let mut index = 0..;
        quads.retain(|_| index.next().is_some_and(|f: usize| !gone[f]));
    }
}

/// Moves every vertex half the way to the middle of its neighbours, on the boundary of those along it.
pub(super) fn relax(mesh: &mut PolygonMesh, connectivity: &Connectivity) {
    let moved = (0..mesh.positions.len() as u32).map(|v| {
        let border = connectivity.is_boundary_vertex(v);
        let neighbours = connectivity
            .spokes(v)
            .filter(|&(e, _)| !border || connectivity.is_boundary_edge(e))
            .map(|(_, w)| mesh.positions[w as usize]);
        let (sum, count) = neighbours.fold((DVec3::ZERO, 0), |(sum, n), p| (sum + p, n + 1));
        let p = mesh.positions[v as usize];
        p + STEP * (sum / f64::from(count.max(1)) - p)
    });
    mesh.positions = moved.collect();
}

/// Moves the vertices of a mesh a share of the way to the closest points of a target. Where it is `two_sided`, to what of it faces like them, if there is such near: the
/// other side of a thin wall is often closer. Vertices further from the target than `reach` stay: it has nothing there.
pub(super) fn project(
    target: &TriangleMesh,
    tree: &Bvh,
    mesh: &mut PolygonMesh,
    share: f64,
    reach: f64,
    two_sided: bool,
) {
    let closest = tree.closest_all(&mesh.positions);
    let normals = mesh.triangulate().vertex_normals();
    let vertices = mesh.positions.iter_mut().zip(normals).zip(closest);
    for ((p, normal), mut c) in vertices {
        if c.distance_squared > reach * reach {
            continue;
        }
        let faces_alike = |t: u32| target.area_vector(t as usize).dot(normal) > 0.0;
        if two_sided && !faces_alike(c.triangle) {
            c = tree.closest_of(*p, reach, faces_alike).unwrap_or(c);
        }
        *p += share * (c.point - *p);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn closed_triangle_meshes_become_quads_of_the_same_topology() {
        for mesh in [
            shapes::sphere(1.0, 0),
            shapes::lobed_ball(3),
            shapes::torus(2.0, 0.7, 25, 13).triangulate(),
        ] {
            let before = Connectivity::of(&mesh.clone().into()).expect("a manifold");
            let quads = paired(&mesh).expect("a manifold");
            let after = Connectivity::of(&quads).expect("a manifold");
            assert!(quads.faces().all(|f| f.len() == 4));
            assert_eq!(after.euler_characteristic(), before.euler_characteristic());
            let doublets =
                (0..quads.positions.len() as u32).filter(|&v| after.around(v).count() == 2);
            assert_eq!(doublets.count(), 0);
        }
    }

    #[test]
    fn a_halved_grid_gets_its_squares_back() {
        let cube = shapes::box_grid(DVec3::ZERO, DVec3::ONE, [5; 3]);
        let quads = paired(&cube.triangulate()).expect("a manifold");
        assert_eq!(quads.face_count(), cube.face_count());
        let square = |f: &[u32]| {
            let side = |k: usize| {
                quads.positions[f[k] as usize].distance(quads.positions[f[(k + 1) % 4] as usize])
            };
            (0..4).all(|k| (side(k) - 0.2).abs() < 1e-12)
        };
        assert!(quads.faces().all(square));
    }

    #[test]
    fn doublets_are_merged() {
        // A cube whose first face has a vertex inside that only two quads share.
        let doubled = vec![
            [0, 1, 2, 8],
            [0, 8, 2, 3],
            [7, 6, 5, 4],
            [0, 4, 5, 1],
            [1, 5, 6, 2],
            [2, 6, 7, 3],
            [3, 7, 4, 0],
        ];
        let quads = without_doublets(doubled, |_| true);
        assert_eq!(quads.len(), 6);
        assert!(quads.iter().flatten().all(|&v| v != 8));
    }

    #[test]
    fn what_a_target_does_not_reach_stays() {
        let ball = shapes::sphere(1.0, 3);
        let tree = Bvh::new(&ball.positions, &ball.triangles).expect("triangles");
        let mut far = shapes::sphere(1.1, 2);
        far.positions[0] *= 3.0;
        let stays = far.positions[0];
        let mut far: PolygonMesh = far.into();
        project(&ball, &tree, &mut far, 1.0, 0.5, true);
        assert_eq!(far.positions[0], stays);
        let off = |p: &DVec3| (p.length() - 1.0).abs();
        assert!(far.positions[1..].iter().map(off).fold(0.0, f64::max) < 0.02);
    }

    #[test]
    fn the_sides_of_a_thin_wall_are_told_apart() {
        let wall = shapes::box_grid(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.02), [8, 8, 1]);
        let wall = wall.triangulate();
        let tree = Bvh::new(&wall.positions, &wall.triangles).expect("triangles");
        // Each side nearer to the other one.
        let mut inside_out = wall.clone();
        for p in &mut inside_out.positions {
            p.z = 0.02 - p.z;
        }
        let mut inside_out: PolygonMesh = inside_out.into();
        let upper = |p: &DVec3| p.z > 0.01;
        let wrong: Vec<bool> = inside_out.positions.iter().map(upper).collect();
        project(&wall, &tree, &mut inside_out, 1.0, 0.1, true);
        for (p, wrong) in inside_out.positions.iter().zip(wrong) {
            let inner = (0.1..0.9).contains(&p.x) && (0.1..0.9).contains(&p.y);
            assert!(!inner || upper(p) != wrong, "{p}");
        }
    }
}
