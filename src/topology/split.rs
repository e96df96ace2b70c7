//! Local refinement of a triangle control mesh: marked faces are cut into four, and their neighbours so that no crack is left.
//!
//! **Theory** \[MK05: M. Marinov, L. Kobbelt, *Optimization methods for scattered data approximation with subdivision surfaces*, 2005; NMM08, section 5\]. A 1-to-4 split
//! puts a vertex on each edge of a face. A neighbour with one such edge is cut in two; one with two or three is split 1-to-4 itself, and so on until
//! nothing changes. Every vertex that a 1-to-4 split touches is also one of the mesh that is subdivided everywhere, and takes its place from there:
//! where all faces around are split, the limit surface does not move at all.

use crate::error::{Error, Result};
use crate::mesh::{Connectivity, ControlMesh, Crease, PolygonMesh};
use glam::{DVec2, DVec3};

/// The parameters of the corners of a face: the point of corner weights (1 − u − v, u, v) is at (u, v).
const WHOLE: [DVec2; 3] = [DVec2::ZERO, DVec2::X, DVec2::Y];

/// The outcome of [`split`].
#[derive(Debug, Clone, PartialEq)]
pub struct Split {
    /// The finer control mesh: old vertices keep their numbers, faces the order of those that they were cut from.
    pub control: ControlMesh,
    /// `[old faces + 1]`: the faces cut from face `f` are `starts[f]..starts[f + 1]`.
    starts: Vec<u32>,
    /// `[faces]`: the parameters of the corners in the old face.
    corners: Vec<[DVec2; 3]>,
}

/// The marked faces, and those that their splits force to be split 1-to-4 as well.
///
/// `marked`: `[faces]`. O(faces).
pub fn closure(mesh: &Connectivity, marked: &[bool]) -> Vec<bool> {
    let mut whole = marked.to_vec();
    let is_cut = |whole: &[bool], h: u32| {
        let side = |h: u32| whole[mesh.face_of(h) as usize];
        side(h) || mesh.opposite(h).is_some_and(side)
    };
    let mut pending: Vec<u32> = (0..mesh.face_count() as u32)
        .filter(|&f| marked[f as usize])
        .collect();
    while let Some(f) = pending.pop() {
        for h in mesh.half_edges(f as usize) {
            let Some(neighbour) = mesh.opposite(h).map(|o| mesh.face_of(o)) else {
                continue;
            };
            let edges = mesh.half_edges(neighbour as usize);
            let cut = edges.filter(|&h| is_cut(&whole, h)).count();
            if cut > 1 && !whole[neighbour as usize] {
                whole[neighbour as usize] = true;
                pending.push(neighbour);
            }
        }
    }
    whole
}

/// Splits the marked faces 1-to-4, with whatever else that takes ([`closure`]).
///
/// `subdivided`: `[vertices + edges]`, the points of the mesh that is subdivided once everywhere, those of vertices before those of edges
/// ([`crate::model::subdivide`]). An edge that is cut leaves its crease to both halves, one level less sharp.
///
/// # Errors
/// Where the mesh is no oriented manifold, has a face other than a triangle, or a crease that is no edge.
pub fn split(control: &ControlMesh, marked: &[bool], subdivided: &[DVec3]) -> Result<Split> {
    let mesh = Connectivity::of(&control.mesh)?;
    check_triangles(&mesh)?;
    let whole = closure(&mesh, marked);
    let mut positions = control.mesh.positions.clone();
    let vertex_count = positions.len();
    let mut middles = vec![None; mesh.edge_count()];
    for f in (0..mesh.face_count()).filter(|&f| whole[f]) {
        for h in mesh.half_edges(f) {
            let v = mesh.origin(h) as usize;
            positions[v] = subdivided[v];
        }
    }
    for e in 0..mesh.edge_count() as u32 {
        let h = mesh.half_edge(e);
        let sides = [Some(h), mesh.opposite(h)].into_iter().flatten();
        if sides.into_iter().any(|h| whole[mesh.face_of(h) as usize]) {
            middles[e as usize] = Some(positions.len() as u32);
            positions.push(subdivided[vertex_count + e as usize]);
        }
    }
    let mut faces = Vec::with_capacity(mesh.face_count() + 3 * (positions.len() - vertex_count));
    let mut corners = Vec::with_capacity(faces.capacity());
    let mut starts = vec![0];
    for f in 0..mesh.face_count() {
        let face = [0, 1, 2].map(|k| mesh.face(f)[k]);
        let edges = mesh.half_edges(f).start;
        let cut = [0, 1, 2].map(|k| middles[mesh.edge_of(edges + k) as usize]);
        for (face, at) in pieces(face, cut) {
            faces.push(face);
            corners.push(at);
        }
        starts.push(faces.len() as u32);
    }
    let creases = cut_creases(&mesh, &control.creases, &middles)?;
    Ok(Split {
        control: ControlMesh {
            mesh: PolygonMesh::from_faces(positions, faces),
            creases,
            corners: control.corners.clone(),
        },
        starts,
        corners,
    })
}

impl Split {
    /// The faces cut from old face `f`; a single one where it is as it was.
    pub fn pieces_of(&self, f: u32) -> std::ops::Range<u32> {
        self.starts[f as usize]..self.starts[f as usize + 1]
    }

    /// The face and parameters of what was at `at` in old face `f`.
    pub fn locate(&self, f: u32, at: DVec2) -> (u32, DVec2) {
        let inside = |at: DVec2| (1.0 - at.x - at.y).min(at.x).min(at.y);
        let mut best = (f64::NEG_INFINITY, self.starts[f as usize], at);
        for piece in self.pieces_of(f) {
            let here = relative(self.corners[piece as usize], at);
            if inside(here) > best.0 {
                best = (inside(here), piece, here);
            }
        }
        (best.1, best.2)
    }
}

/// The parameters in a triangle of parameters.
fn relative([a, b, c]: [DVec2; 3], at: DVec2) -> DVec2 {
    let (x, y, p) = (b - a, c - a, at - a);
    DVec2::new(p.perp_dot(y), x.perp_dot(p)) / x.perp_dot(y)
}

/// The faces that a face is cut into by the vertices on its edges (`cut[k]` follows corner `k`): one, two or four.
fn pieces(face: [u32; 3], cut: [Option<u32>; 3]) -> Vec<([u32; 3], [DVec2; 3])> {
    let middle = |k: usize| 0.5 * (WHOLE[k] + WHOLE[(k + 1) % 3]);
    match cut {
        [None, None, None] => vec![(face, WHOLE)],
        [Some(x), Some(y), Some(z)] => {
            let m = [x, y, z];
            let corner = |k: usize| {
                let before = (k + 2) % 3;
                (
                    [face[k], m[k], m[before]],
                    [WHOLE[k], middle(k), middle(before)],
                )
            };
            vec![
                corner(0),
                corner(1),
                corner(2),
                (m, [middle(0), middle(1), middle(2)]),
            ]
        }
        // The closure leaves no face with two.
        _ => {
            let k = cut.iter().position(Option::is_some).unwrap_or_default();
            let m = cut[k].unwrap_or_default();
            let (next, last) = ((k + 1) % 3, (k + 2) % 3);
            vec![
                ([face[k], m, face[last]], [WHOLE[k], middle(k), WHOLE[last]]),
                (
                    [m, face[next], face[last]],
                    [middle(k), WHOLE[next], WHOLE[last]],
                ),
            ]
        }
    }
}

/// The creases, those of cut edges in two halves.
fn cut_creases(
    mesh: &Connectivity,
    creases: &[Crease],
    middles: &[Option<u32>],
) -> Result<Vec<Crease>> {
    let mut result = Vec::with_capacity(creases.len());
    for crease in creases {
        let [a, b] = crease.edge;
        let known = (a as usize) < mesh.vertex_count();
        let Some(e) = known.then(|| mesh.edge_between(a, b)).flatten() else {
            return Err(Error::input(
                format!("the crease between vertices {a} and {b} is no edge of the control mesh"),
                "remove the crease or add the edge",
            ));
        };
        match middles[e as usize] {
            None => result.push(*crease),
            Some(_) if crease.sharpness <= 1.0 => {}
            Some(m) => result.extend([[a, m], [m, b]].map(|edge| Crease {
                edge,
                sharpness: crease.sharpness - 1.0,
            })),
        }
    }
    Ok(result)
}

/// Refuses faces that are no triangles.
pub(super) fn check_triangles(mesh: &Connectivity) -> Result<()> {
    match mesh.faces().position(|f| f.len() != 3) {
        None => Ok(()),
        Some(f) => Err(Error::input(
            format!("face {f} has {} corners", mesh.face(f).len()),
            "triangulate the control mesh first",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Scheme, shapes};
    use crate::model::{self, Model};

    /// Of [`ball`].
    const FACES: usize = 320;
    const VERTICES: usize = 162;

    fn ball() -> ControlMesh {
        PolygonMesh::from(shapes::sphere(1.0, 2)).into()
    }

    fn split_of(control: &ControlMesh, marked: &[bool]) -> Split {
        let fine = model::subdivide(control, Scheme::Loop).expect("triangles");
        split(control, marked, &fine.mesh.positions).expect("triangles")
    }

    #[test]
    fn polygons_and_creases_that_are_no_edges_are_refused() {
        let quads = ControlMesh::from(shapes::torus(3.0, 1.0, 8, 6));
        let error = split(&quads, &[false; 48], &[]).expect_err("quads");
        assert!(error.to_string().contains("face 0 has 4 corners"));
        let mut ball = ball();
        for edge in [[0, 0], [999, 1]] {
            ball.creases = vec![Crease {
                edge,
                sharpness: 2.0,
            }];
            let error = split(&ball, &[false; FACES], &[]).expect_err("no edge");
            assert!(error.to_string().contains("is no edge"));
        }
    }

    #[test]
    fn nothing_marked_changes_nothing() {
        let ball = ball();
        let same = split_of(&ball, &[false; FACES]);
        assert_eq!(same.control, ball);
        let at = DVec2::new(0.3, 0.6);
        assert_eq!(same.locate(77, at), (77, at));
    }

    #[test]
    fn one_split_face_cuts_its_neighbours_in_two_and_two_make_a_third() {
        let ball = ball();
        let mesh = Connectivity::of(&ball.mesh).unwrap();
        let mut marked = vec![false; FACES];
        marked[5] = true;
        let one = split_of(&ball, &marked);
        assert_eq!(one.control.mesh.positions.len(), VERTICES + 3);
        assert_eq!(one.control.mesh.face_count(), FACES + 3 + 3);
        // Two neighbours of face 9, not of each other.
        let around: Vec<u32> = mesh
            .half_edges(9)
            .filter_map(|h| mesh.opposite(h))
            .map(|o| mesh.face_of(o))
            .collect();
        let mut marked = vec![false; FACES];
        marked[around[0] as usize] = true;
        marked[around[1] as usize] = true;
        assert_eq!(closure(&mesh, &marked).iter().filter(|&&w| w).count(), 3);
        let two = split_of(&ball, &marked);
        assert_eq!(two.pieces_of(9).len(), 4);
        assert_eq!(two.control.mesh.face_count(), FACES + 9 + 5);
    }

    #[test]
    fn splitting_all_is_subdividing_and_moves_nothing() {
        let mut ball = ball();
        let mesh = Connectivity::of(&ball.mesh).unwrap();
        ball.creases = mesh
            .spokes(3)
            .map(|(_, v)| Crease {
                edge: [3, v],
                sharpness: 2.5,
            })
            .collect();
        let all = split_of(&ball, &[true; FACES]);
        let fine = model::subdivide(&ball, Scheme::Loop).unwrap();
        assert_eq!(all.control.mesh, fine.mesh);
        let ends = |c: &Crease| (c.edge[0].min(c.edge[1]), c.edge[0].max(c.edge[1]));
        let mut halves: Vec<_> = all.control.creases.iter().map(ends).collect();
        let mut expected: Vec<_> = fine.creases.iter().map(ends).collect();
        halves.sort_unstable();
        expected.sort_unstable();
        assert_eq!(halves, expected);
        assert!(all.control.creases.iter().all(|c| c.sharpness == 1.5));
    }

    #[test]
    fn parameters_follow_their_points() {
        let ball = ball();
        let mut marked = vec![false; FACES];
        marked[40] = true;
        let split = split_of(&ball, &marked);
        let flat = |control: &ControlMesh, f: u32, at: DVec2| {
            let [a, b, c] = [0, 1, 2].map(|k| control.mesh.face(f as usize)[k] as usize);
            let p = &control.mesh.positions;
            p[a] * (1.0 - at.x - at.y) + p[b] * at.x + p[c] * at.y
        };
        // With middles of edges in place of subdivided points, faces do not move.
        let mut straight = split.control.clone();
        straight.mesh.positions[..VERTICES].copy_from_slice(&ball.mesh.positions);
        let mesh = Connectivity::of(&ball.mesh).unwrap();
        for h in mesh.half_edges(40) {
            let [a, b] = [mesh.origin(h), mesh.target(h)].map(|v| ball.mesh.positions[v as usize]);
            let fine = model::subdivide(&ball, Scheme::Loop).unwrap();
            let there = fine.mesh.positions[VERTICES + mesh.edge_of(h) as usize];
            let at = split
                .control
                .mesh
                .positions
                .iter()
                .position(|p| *p == there);
            straight.mesh.positions[at.expect("a vertex on the edge")] = 0.5 * (a + b);
        }
        for f in 0..FACES as u32 {
            for at in [(0.1, 0.2), (0.7, 0.2), (0.2, 0.7), (0.34, 0.33), (0.0, 0.5)] {
                let at = DVec2::new(at.0, at.1);
                let (piece, there) = split.locate(f, at);
                assert!(there.min_element() > -1e-12 && there.x + there.y < 1.0 + 1e-12);
                let moved = flat(&ball, f, at).distance(flat(&straight, piece, there));
                assert!(moved < 1e-12, "{f} {at} {moved}");
            }
        }
    }

    /// The largest distance from the limit vertices of a twice subdivided surface to another's triangles.
    fn moved(before: &ControlMesh, after: &ControlMesh) -> f64 {
        let surface = |control: &ControlMesh| {
            let model = Model::new(control, Scheme::Loop, 3, true).unwrap();
            model.surface(&control.mesh.positions).triangulate()
        };
        let (a, b) = (surface(before), surface(after));
        let distances = crate::measure::distances(&a, &b.positions).unwrap();
        distances.into_iter().fold(0.0, f64::max)
    }

    #[test]
    fn the_surface_hardly_moves() {
        let ball = ball();
        let marked: Vec<bool> = (0..FACES).map(|f| f < 16).collect();
        let split = split_of(&ball, &marked);
        // Against vertices halfway between the ends of their edges, the others as they were.
        let mesh = Connectivity::of(&ball.mesh).unwrap();
        let mut plain = ball.mesh.positions.clone();
        plain.extend((0..mesh.edge_count() as u32).map(|e| {
            let [a, b] = mesh.ends(e).map(|v| ball.mesh.positions[v as usize]);
            0.5 * (a + b)
        }));
        let halved = super::split(&ball, &marked, &plain).unwrap();
        let (here, there) = (moved(&ball, &split.control), moved(&ball, &halved.control));
        println!("moved by {here:.5} of the radius, {there:.5} with halved edges");
        assert!(here < 0.012 && here < 0.5 * there);
    }
}
