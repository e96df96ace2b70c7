//! Edge collapse: cells lose edges, and hexahedra become prisms.
//!
//! A hexahedron can lose two opposite edges of a face, and is a prism then; so edges go by strips of quads ([`strip`]): along the rim of a box, such a strip takes the sharp
//! edge away. With all four parallel edges, or two edges of each end, a cell is flat and leaves the mesh.

use super::{boundary, checked};
use crate::error::{Error, Result};
use crate::mesh::{CellShape, VolumeMesh, check_volume};
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// The mesh with the ends of each of the given edges made one vertex: in their middle, or where those of them are that lie on the boundary.
///
/// # Errors
/// Where a pair of vertices is no edge, a cell would be left that is neither hexahedron nor prism nor tetrahedron, and as [`checked`].
pub fn collapse(mesh: &VolumeMesh, edges: &[[u32; 2]]) -> Result<VolumeMesh> {
    check_volume::sound(mesh)?;
    let known = mesh_edges(mesh);
    let mut root: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    for &[a, b] in edges {
        if !known.contains(&[a.min(b), a.max(b)]) {
            return Err(Error::input(
                format!("{a}–{b} is no edge of the mesh"),
                "name the two ends of an edge, counted from 0",
            ));
        }
        let (a, b) = (find(&root, a), find(&root, b));
        root[a.max(b) as usize] = a.min(b);
    }
    let mut collapsed = VolumeMesh::new(merged_positions(mesh, &root));
    for (c, (shape, cell)) in mesh.cells().enumerate() {
        let corners: Vec<u32> = cell.iter().map(|&v| find(&root, v)).collect();
        match remainder(shape, &corners) {
            Some(Remainder::Cell(shape, corners)) => collapsed.push_cell(shape, &corners),
            Some(Remainder::Flat) => {}
            None => {
                return Err(Error::input(
                    format!(
                        "{} {c} (counted from 0) would be left with {} corners, and be neither a hexahedron nor a prism nor a tetrahedron",
                        shape.name(),
                        corners.iter().collect::<BTreeSet<_>>().len()
                    ),
                    "collapse a whole strip of quads, named by a face",
                ));
            }
        }
    }
    checked(super::part(&collapsed, |_| true))
}

/// The edges across a strip of quads: those like the edge from the first to the second corner of `quad`, which must be a face of the mesh, through one quad
/// after the other to both sides, each next one sharing no cell with the one before.
///
/// # Errors
/// Where `quad` is no face, or the strip divides.
pub fn strip(mesh: &VolumeMesh, quad: [u32; 4]) -> Result<Vec<[u32; 2]>> {
    let faces = Faces::of(mesh);
    let [a, b, c, d] = quad;
    if !faces.is_face(quad) {
        return Err(Error::input(
            format!("{a}, {b}, {c}, {d} is no face of the mesh"),
            "name the corners of a quad in turn, counted from 0",
        ));
    }
    let mut edges = vec![[a, b]];
    for start in [[d, c], [a, b]] {
        let (mut face, mut edge) = (sorted(&quad), start);
        loop {
            if edges[0] != edge {
                edges.push(edge);
            }
            let Some(next) = faces.next(&face, edge)? else {
                break;
            };
            (face, edge) = next;
            if edges.contains(&edge) || edges.contains(&[edge[1], edge[0]]) {
                break;
            }
        }
    }
    Ok(edges)
}

/// The quads of a mesh.
struct Faces {
    /// By sorted corners: the corners in turn, and the cells on both sides.
    quads: BTreeMap<Vec<u32>, (Vec<u32>, Vec<usize>)>,
    /// By sorted ends: the quads at an edge.
    at_edges: BTreeMap<[u32; 2], Vec<Vec<u32>>>,
}

impl Faces {
    fn of(mesh: &VolumeMesh) -> Self {
        let mut quads: BTreeMap<Vec<u32>, (Vec<u32>, Vec<usize>)> = BTreeMap::new();
        for (c, (shape, cell)) in mesh.cells().enumerate() {
            for face in shape.faces().iter().filter(|face| face.len() == 4) {
                let cycle: Vec<u32> = face.iter().map(|&k| cell[k]).collect();
                let entry = quads.entry(sorted(&cycle));
                entry.or_insert((cycle, Vec::new())).1.push(c);
            }
        }
        let mut at_edges: BTreeMap<[u32; 2], Vec<Vec<u32>>> = BTreeMap::new();
        for (key, (cycle, _)) in &quads {
            for k in 0..4 {
                let (a, b) = (cycle[k], cycle[(k + 1) % 4]);
                let edge = [a.min(b), a.max(b)];
                at_edges.entry(edge).or_default().push(key.clone());
            }
        }
        Self { quads, at_edges }
    }

    fn is_face(&self, quad: [u32; 4]) -> bool {
        let turns = |cycle: &[u32]| {
            let at = cycle.iter().position(|&v| v == quad[0]);
            at.is_some_and(|at| {
                let onwards = (0..4).all(|k| cycle[(at + k) % 4] == quad[k]);
                onwards || (0..4).all(|k| cycle[(at + 4 - k) % 4] == quad[k])
            })
        };
        let found = self.quads.get(&sorted(&quad));
        found.is_some_and(|(cycle, _)| turns(cycle))
    }

    /// The quad beyond an edge of a quad, and its edge opposite to that one, directed alike; none at the end of a strip.
    fn next(&self, face: &[u32], edge: [u32; 2]) -> Result<Option<(Vec<u32>, [u32; 2])>> {
        let [a, b] = edge;
        let cells = &self.quads[face].1;
        let beside = self.at_edges[&[a.min(b), a.max(b)]].iter();
        let is_beyond = |other: &&Vec<u32>| {
            let near = &self.quads[*other].1;
            other.as_slice() != face && !near.iter().any(|c| cells.contains(c))
        };
        let beyond: Vec<&Vec<u32>> = beside.filter(is_beyond).collect();
        match beyond[..] {
            [] => Ok(None),
            [next] => {
                let cycle = &self.quads[next].0;
                let other = |v: u32, not: u32| {
                    let at = cycle.iter().position(|&w| w == v).unwrap_or_default();
                    let sides = [cycle[(at + 1) % 4], cycle[(at + 3) % 4]];
                    if sides[0] == not { sides[1] } else { sides[0] }
                };
                Ok(Some((next.clone(), [other(a, b), other(b, a)])))
            }
            _ => Err(Error::input(
                format!(
                    "the strip of quads divides at the edge {a}–{b}: {} go on from there",
                    beyond.len()
                ),
                "name another face, or the edges one by one",
            )),
        }
    }
}

/// What is left of a cell.
enum Remainder {
    Cell(CellShape, Vec<u32>),
    Flat,
}

/// What is left of a cell some of whose corners are the same now; none where it is no shape that there is.
fn remainder(shape: CellShape, corners: &[u32]) -> Option<Remainder> {
    let distinct: BTreeSet<u32> = corners.iter().copied().collect();
    if distinct.len() == corners.len() {
        return Some(Remainder::Cell(shape, corners.to_vec()));
    }
    // The faces that still have an area.
    let sides: Vec<BTreeSet<u32>> = shape
        .faces()
        .iter()
        .map(|face| face.iter().map(|&k| corners[k]).collect::<BTreeSet<u32>>())
        .filter(|side| side.len() > 2)
        .collect();
    match (shape, distinct.len(), sides.as_slice()) {
        (_, _, []) => Some(Remainder::Flat),
        (_, _, [one, other]) if one == other => Some(Remainder::Flat),
        (CellShape::Hexahedron, 6, _) => prism_in(corners),
        (CellShape::Prism, 4, [_, _, _, _]) => tetrahedron_in(corners),
        _ => None,
    }
}

/// A hexahedron without two opposite edges of a face.
fn prism_in(corners: &[u32]) -> Option<Remainder> {
    let shape = CellShape::Hexahedron;
    let across = |face: &[usize], k: usize| {
        let ends = shape.edges().iter().filter(|edge| edge.contains(&k));
        let mut ends = ends.map(|edge| edge[0] + edge[1] - k);
        ends.find(|end| !face.contains(end)).unwrap_or(k)
    };
    for face in shape.faces() {
        for turn in 0..2 {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| face[(k + turn) % 4]);
            if corners[a] == corners[b] && corners[c] == corners[d] {
                let [a_up, b_up, c_up, d_up] = [a, b, c, d].map(|k| across(face, k));
                let prism = [a, b_up, a_up, d, c_up, d_up].map(|k| corners[k]);
                return Some(Remainder::Cell(CellShape::Prism, prism.to_vec()));
            }
        }
    }
    None
}

/// A prism without two of the edges between its triangles.
fn tetrahedron_in(corners: &[u32]) -> Option<Remainder> {
    let kept = (0..3).find(|&k| corners[k] != corners[k + 3])?;
    let [i, j] = [(kept + 1) % 3, (kept + 2) % 3];
    let tetrahedron = [i, j, kept, kept + 3].map(|k| corners[k]).to_vec();
    Some(Remainder::Cell(CellShape::Tetrahedron, tetrahedron))
}

/// Where merged vertices go. `[vertices]`, by their roots.
fn merged_positions(mesh: &VolumeMesh, root: &[u32]) -> Vec<DVec3> {
    let mut is_outer = vec![false; root.len()];
    for &v in boundary(mesh).corners() {
        is_outer[v as usize] = true;
    }
    let mut members: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for v in 0..root.len() {
        members.entry(find(root, v as u32)).or_default().push(v);
    }
    let mut positions = mesh.positions.clone();
    for (r, all) in members.into_iter().filter(|(_, all)| all.len() > 1) {
        let outer: Vec<usize> = all.iter().copied().filter(|&v| is_outer[v]).collect();
        let leading = if outer.is_empty() { all } else { outer };
        let sum: DVec3 = leading.iter().map(|&v| mesh.positions[v]).sum();
        positions[r as usize] = sum / leading.len() as f64;
    }
    positions
}

fn mesh_edges(mesh: &VolumeMesh) -> BTreeSet<[u32; 2]> {
    mesh.cells()
        .flat_map(|(shape, cell)| {
            shape.edges().iter().map(|edge| {
                let [a, b] = edge.map(|k| cell[k]);
                [a.min(b), a.max(b)]
            })
        })
        .collect()
}

fn find(root: &[u32], mut v: u32) -> u32 {
    while root[v as usize] != v {
        v = root[v as usize];
    }
    v
}

fn sorted(vertices: &[u32]) -> Vec<u32> {
    let mut key = vertices.to_vec();
    key.sort_unstable();
    key
}

#[cfg(test)]
mod tests {
    use super::super::{Course, extrude, grid};
    use super::*;
    use crate::mesh::PolygonMesh;

    /// 3 × 3 × 3 unit cubes; the vertex (i, j, k) is i + 4 j + 16 k.
    fn cubes() -> VolumeMesh {
        grid(DVec3::ZERO, DVec3::splat(3.0), [3; 3])
    }

    fn counts(mesh: &VolumeMesh) -> [usize; 3] {
        CellShape::ALL.map(|shape| mesh.cells().filter(|c| c.0 == shape).count())
    }

    fn refusal<T: std::fmt::Debug>(result: Result<T>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn what_is_no_edge_or_face_is_refused() {
        let mesh = cubes();
        for edge in [[0, 5], [0, 0], [0, 64], [900, 901]] {
            assert!(refusal(collapse(&mesh, &[edge])).contains("no edge"));
        }
        for quad in [[0, 1, 4, 5], [0, 1, 2, 3], [0, 0, 1, 1], [0, 1, 5, 900]] {
            assert!(refusal(strip(&mesh, quad)).contains("no face"));
        }
        assert_eq!(collapse(&mesh, &[]).unwrap(), mesh);
    }

    #[test]
    fn an_edge_alone_would_leave_seven_corners() {
        let message = refusal(collapse(&cubes(), &[[0, 1]]));
        assert!(message.contains("hexahedron 0 "), "{message}");
        assert!(message.contains("7 corners"), "{message}");
    }

    #[test]
    fn a_strip_along_the_rim_makes_prisms_of_it() {
        let mesh = cubes();
        let edges = strip(&mesh, [16, 17, 33, 32]).unwrap();
        let mut starts: Vec<[u32; 2]> = edges.clone();
        starts.sort_unstable();
        assert_eq!(starts, [[0, 1], [16, 17], [32, 33], [48, 49]]);
        let rounded = collapse(&mesh, &edges).unwrap();
        assert_eq!(counts(&rounded), [0, 3, 24]);
        assert_eq!(rounded.positions.len(), 60);
        let middle = DVec3::new(0.5, 0.0, 1.0);
        assert!(rounded.positions.iter().any(|p| p.distance(middle) < 1e-14));
        // Inside, the strip goes through from one side to the other.
        assert_eq!(strip(&mesh, [21, 22, 38, 37]).unwrap().len(), 4);
    }

    #[test]
    fn a_sheet_and_a_column_leave_the_mesh() {
        let mesh = cubes();
        let sheet: Vec<[u32; 2]> = (0..16).map(|line| [4 * line, 4 * line + 1]).collect();
        let thin = collapse(&mesh, &sheet).unwrap();
        assert_eq!((counts(&thin), thin.positions.len()), ([0, 0, 18], 48));
        // The column at the rim: its neighbours meet where it was.
        let column = (0..4).flat_map(|k| [[16 * k, 16 * k + 1], [16 * k, 16 * k + 4]]);
        let without = collapse(&mesh, &column.collect::<Vec<_>>()).unwrap();
        assert_eq!(
            (counts(&without), without.positions.len()),
            ([0, 0, 24], 56)
        );
    }

    #[test]
    fn a_prism_becomes_a_tetrahedron() {
        let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let triangle = PolygonMesh::from_faces(corners, [[0, 1, 2]]);
        let prism = extrude(&triangle, Course::Along(DVec3::Z), 1).unwrap();
        for edges in [[[0, 3], [1, 4]], [[1, 4], [2, 5]], [[2, 5], [0, 3]]] {
            let left = collapse(&prism, &edges).unwrap();
            assert_eq!(counts(&left), [1, 0, 0]);
        }
        assert!(refusal(collapse(&prism, &[[0, 3]])).contains("5 corners"));
    }
}
