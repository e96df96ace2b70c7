//! The door for volume meshes: what a mesh of cells from outside must satisfy.
//!
//! [`sound`] refuses what cannot be made into curved cells that fit together: faces of three cells, hanging nodes, quads against two
//! triangles, cells that hang on the rest by a vertex or an edge only. Inverted cells pass: they can be untangled.

use super::{CellShape, VolumeMesh};
use crate::error::Defect;
use glam::DVec3;
use std::collections::HashMap;

/// A vertex this near to the middle of an edge or a quad, relative to the diagonal of the bounding box, hangs there. Text files have six
/// digits at least.
const HANGING: f64 = 1e-6;

/// … and this near relative to the edge itself, so that fine meshes are not mistaken.
const HANGING_ON_EDGE: f64 = 1e-3;

/// The sizes of a sound volume mesh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct VolumeCensus {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of tetrahedra.
    pub tetrahedra: usize,
    /// Number of prisms.
    pub prisms: usize,
    /// Number of hexahedra.
    pub hexahedra: usize,
    /// Faces of one cell.
    pub boundary_faces: usize,
    /// Sets of cells that are connected through faces.
    pub pieces: usize,
}

impl VolumeCensus {
    /// What a user should know, a line each.
    pub fn warnings(&self) -> Vec<String> {
        let others = self.pieces.saturating_sub(1);
        let line = || format!("{others} separate pieces beside the first");
        (others > 0).then(line).into_iter().collect()
    }
}

/// Whether curved cells can be made of the mesh: at least one cell, finite coordinates, indices in range, eight (six, four) different
/// vertices a cell, a bounding box with an extent, faces that match, pieces that are joined by faces or not at all. Cost O(n log n).
///
/// # Errors
/// The first cell that is wrong, counted from 0.
pub fn sound(mesh: &VolumeMesh) -> Result<VolumeCensus, Defect> {
    check_cells(mesh)?;
    let faces = sorted_faces(mesh);
    let mut boundary = Vec::new();
    let mut neighbours = Vec::new();
    for same in faces.chunk_by(|a, b| a.vertices == b.vertices) {
        match same {
            [face] => boundary.push(*face),
            [one, other] if one.opposite(mesh) != other.opposite(mesh) => {
                let problem = format!(
                    "its face {} has other diagonals in cell {}",
                    one.name(),
                    other.cell
                );
                return Err(at_cell(
                    one.cell,
                    problem,
                    "correct or remove one of the cells",
                ));
            }
            [one, other] => neighbours.push([one.cell, other.cell]),
            [] => {}
            [first, .., last] => {
                let problem = format!(
                    "its face {} belongs to {} cells, such as cell {}",
                    first.name(),
                    same.len(),
                    last.cell
                );
                return Err(at_cell(
                    first.cell,
                    problem,
                    "remove cells that lie over each other",
                ));
            }
        }
    }
    if boundary.is_empty() {
        let problem = "there is none: the cells lie over each other";
        return Err(Defect::new("boundary", problem, "remove duplicate cells"));
    }
    check_triangles_on_quads(&boundary)?;
    check_hanging(mesh, &boundary)?;
    let count = |shape| mesh.cells().filter(|&(s, _)| s == shape).count();
    Ok(VolumeCensus {
        vertices: mesh.positions.len(),
        tetrahedra: count(CellShape::Tetrahedron),
        prisms: count(CellShape::Prism),
        hexahedra: count(CellShape::Hexahedron),
        boundary_faces: boundary.len(),
        pieces: count_pieces(mesh, &neighbours)?,
    })
}

fn at_cell(cell: u32, problem: impl Into<String>, remedy: &str) -> Defect {
    Defect::new(format!("cell {cell} (counted from 0)"), problem, remedy)
}

fn check_cells(mesh: &VolumeMesh) -> Result<(), Defect> {
    const REMEDY: &str = "correct or remove the cell, or export the mesh again";
    if mesh.cell_count() == 0 {
        return Err(Defect::new("cells", "there are none", "give a volume mesh"));
    }
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (c, (_, vertices)) in mesh.cells().enumerate() {
        let defect = |problem: String| at_cell(c as u32, problem, REMEDY);
        for (k, &v) in vertices.iter().enumerate() {
            if vertices[..k].contains(&v) {
                return Err(defect(format!("vertex {v} is two of its corners")));
            }
            let count = mesh.positions.len();
            let p = mesh.positions.get(v as usize);
            let p = *p.ok_or_else(|| defect(format!("it names vertex {v} of {count}")))?;
            if !p.is_finite() {
                return Err(defect(format!(
                    "the coordinates of its vertex {v} are not finite"
                )));
            }
            (lo, hi) = (lo.min(p), hi.max(p));
        }
    }
    let diagonal = (hi - lo).length();
    if diagonal > 0.0 && diagonal.is_finite() {
        return Ok(());
    }
    let problem = format!("its diagonal is {diagonal}");
    Err(Defect::new(
        "bounding box",
        problem,
        "give a mesh with an extent that can be computed with",
    ))
}

/// A face of a cell, filed under its vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Face {
    /// In rising order; the fourth of a triangle is [`Face::NONE`].
    vertices: [u32; 4],
    cell: u32,
    /// Which of the cell's faces.
    local: u32,
}

impl Face {
    const NONE: u32 = u32::MAX;

    fn corners(&self) -> &[u32] {
        let count = if self.vertices[3] == Self::NONE { 3 } else { 4 };
        &self.vertices[..count]
    }

    /// The corner opposite to the first, on a quad.
    fn opposite(&self, mesh: &VolumeMesh) -> Option<u32> {
        let cell = mesh.cell(self.cell as usize);
        let cycle = mesh.shape(self.cell as usize).faces()[self.local as usize];
        let at = cycle.iter().position(|&k| cell[k] == self.vertices[0])?;
        (cycle.len() == 4).then(|| cell[cycle[(at + 2) % 4]])
    }

    fn name(&self) -> String {
        let names: Vec<String> = self.corners().iter().map(u32::to_string).collect();
        names.join(" ")
    }
}

/// The faces of all cells, those with the same vertices next to each other.
fn sorted_faces(mesh: &VolumeMesh) -> Vec<Face> {
    let mut faces = Vec::new();
    for (c, (shape, cell)) in mesh.cells().enumerate() {
        for (f, face) in shape.faces().iter().enumerate() {
            let mut vertices = [Face::NONE; 4];
            for (slot, &k) in vertices.iter_mut().zip(*face) {
                *slot = cell[k];
            }
            vertices.sort_unstable();
            faces.push(Face {
                vertices,
                cell: c as u32,
                local: f as u32,
            });
        }
    }
    faces.sort_unstable();
    faces
}

/// The faces of one cell: the cell and which of its faces, in ascending order.
pub(crate) fn boundary_faces(mesh: &VolumeMesh) -> Vec<(usize, usize)> {
    let faces = sorted_faces(mesh);
    let groups = faces.chunk_by(|a, b| a.vertices == b.vertices);
    let single = groups.filter(|same| same.len() == 1).flatten();
    let mut boundary: Vec<_> = single
        .map(|face| (face.cell as usize, face.local as usize))
        .collect();
    boundary.sort_unstable();
    boundary
}

/// Refuses a triangle on the boundary that is half of a quad there.
fn check_triangles_on_quads(boundary: &[Face]) -> Result<(), Defect> {
    let (triangles, quads): (Vec<&Face>, Vec<&Face>) =
        boundary.iter().partition(|f| f.corners().len() == 3);
    let mut halves = HashMap::new();
    for quad in quads {
        for left_out in 0..4 {
            let mut half = [Face::NONE; 4];
            let rest = (0..4).filter(|&k| k != left_out);
            half.iter_mut()
                .zip(rest)
                .for_each(|(slot, k)| *slot = quad.vertices[k]);
            halves.insert(half, quad.cell);
        }
    }
    for triangle in triangles {
        if let Some(other) = halves.get(&triangle.vertices) {
            let problem = format!(
                "its triangle {} is half of a quad of cell {other}: their faces do not match",
                triangle.name()
            );
            let remedy = "mesh again so that quads meet quads";
            return Err(at_cell(triangle.cell, problem, remedy));
        }
    }
    Ok(())
}

/// Refuses a vertex on the boundary that lies in the middle of an edge or quad there.
fn check_hanging(mesh: &VolumeMesh, boundary: &[Face]) -> Result<(), Defect> {
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for &v in boundary.iter().flat_map(Face::corners) {
        let p = mesh.positions[v as usize];
        (lo, hi) = (lo.min(p), hi.max(p));
    }
    let reach = HANGING * (hi - lo).length();
    // Boxes of twice the reach: a ball of that radius meets two in each direction.
    let key = |p: DVec3| {
        ((p - lo) / (2.0 * reach))
            .floor()
            .to_array()
            .map(|x| x as i64)
    };
    let mut boxes: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    let mut seen = vec![false; mesh.positions.len()];
    for &v in boundary.iter().flat_map(Face::corners) {
        if !std::mem::replace(&mut seen[v as usize], true) {
            boxes
                .entry(key(mesh.positions[v as usize]))
                .or_default()
                .push(v);
        }
    }
    let vertex_at = |p: DVec3, size: f64| {
        (0..8u8).find_map(|side| {
            let step = |bit: u8| if side & bit == 0 { -reach } else { reach };
            let near = boxes.get(&key(p + DVec3::new(step(1), step(2), step(4))))?;
            let close = |v: &&u32| {
                mesh.positions[**v as usize].distance(p) <= reach.min(HANGING_ON_EDGE * size)
            };
            near.iter().find(close).copied()
        })
    };
    for face in boundary {
        let (shape, cell) = (
            mesh.shape(face.cell as usize),
            mesh.cell(face.cell as usize),
        );
        let corners = shape.faces()[face.local as usize];
        let points: Vec<DVec3> = corners
            .iter()
            .map(|&k| mesh.positions[cell[k] as usize])
            .collect();
        let edges = (0..points.len()).map(|k| (points[k], points[(k + 1) % points.len()]));
        let edges = edges.map(|(a, b)| (0.5 * (a + b), a.distance(b), "an edge"));
        let center = points.iter().sum::<DVec3>() / points.len() as f64;
        let quad = (points.len() == 4).then(|| (center, points[0].distance(points[2]), "a face"));
        for (middle, size, what) in edges.chain(quad) {
            if let Some(v) = vertex_at(middle, size) {
                let problem = format!(
                    "vertex {v} hangs in the middle of {what} of its: the mesh does not match there"
                );
                return Err(at_cell(
                    face.cell,
                    problem,
                    "mesh again without hanging nodes",
                ));
            }
        }
    }
    Ok(())
}

/// The number of pieces, which must not touch.
fn count_pieces(mesh: &VolumeMesh, neighbours: &[[u32; 2]]) -> Result<usize, Defect> {
    let mut parent: Vec<u32> = (0..mesh.cell_count() as u32).collect();
    for &[a, b] in neighbours {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        parent[a.max(b) as usize] = a.min(b);
    }
    let mut owner = vec![None; mesh.positions.len()];
    for (c, (_, vertices)) in mesh.cells().enumerate() {
        let piece = root(&mut parent, c as u32);
        for &v in vertices {
            if *owner[v as usize].get_or_insert(piece) != piece {
                let problem = format!("it hangs on the rest at vertex {v}, but by no face");
                return Err(at_cell(
                    c as u32,
                    problem,
                    "remove the dangling cells or connect them by faces",
                ));
            }
        }
    }
    Ok((0..parent.len())
        .filter(|&c| parent[c] as usize == c)
        .count())
}

/// The lowest cell of a set.
fn root(parent: &mut [u32], mut c: u32) -> u32 {
    while parent[c as usize] != c {
        parent[c as usize] = parent[parent[c as usize] as usize];
        c = parent[c as usize];
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of unit cubes along x.
    fn cubes(count: u32) -> VolumeMesh {
        let point = |k: u32| DVec3::new(f64::from(k / 4), f64::from(k & 1), f64::from(k >> 1 & 1));
        let mut mesh = VolumeMesh::new((0..4 * (count + 1)).map(point).collect());
        for c in 0..count {
            let cell = [0, 4, 5, 1, 2, 6, 7, 3].map(|k| 4 * c + k);
            mesh.push_cell(CellShape::Hexahedron, &cell);
        }
        mesh
    }

    fn problem(mesh: &VolumeMesh) -> String {
        let defect = sound(mesh).unwrap_err();
        format!("{}: {}", defect.place, defect.problem)
    }

    #[test]
    fn cells_that_match_are_counted() {
        let census = sound(&cubes(3)).unwrap();
        assert_eq!(
            (census.hexahedra, census.boundary_faces, census.pieces),
            (3, 14, 1)
        );
        let mut two = cubes(1);
        let far: Vec<DVec3> = two.positions.iter().map(|p| *p + 5.0 * DVec3::Y).collect();
        two.positions.extend(far);
        two.push_cell(CellShape::Hexahedron, &[8, 12, 13, 9, 10, 14, 15, 11]);
        assert_eq!(
            sound(&two).unwrap().warnings(),
            ["1 separate pieces beside the first"]
        );
    }

    #[test]
    fn cells_that_cannot_be_used_are_refused_by_number() {
        assert!(problem(&VolumeMesh::default()).starts_with("cells: "));
        let mut mesh = cubes(2);
        mesh.positions[11].z = f64::NAN;
        assert!(problem(&mesh).starts_with("cell 1 "));
        let mut mesh = cubes(1);
        mesh.push_cell(CellShape::Tetrahedron, &[0, 1, 2, 8]);
        assert!(problem(&mesh).contains("names vertex 8 of 8"));
        let mut mesh = cubes(1);
        mesh.push_cell(CellShape::Tetrahedron, &[0, 1, 2, 0]);
        assert!(problem(&mesh).contains("two of its corners"));
        let mut mesh = cubes(1);
        mesh.push_cell(CellShape::Hexahedron, &[0, 4, 5, 1, 2, 6, 7, 3]);
        assert!(problem(&mesh).starts_with("boundary: "));
        let mut mesh = VolumeMesh::new(vec![DVec3::ONE; 4]);
        mesh.push_cell(CellShape::Tetrahedron, &[0, 1, 2, 3]);
        assert!(problem(&mesh).starts_with("bounding box"));
    }

    #[test]
    fn faces_that_do_not_match_are_refused() {
        let mut mesh = cubes(2);
        mesh.positions.push(DVec3::new(1.5, 3.0, 3.0));
        mesh.push_cell(CellShape::Prism, &[4, 5, 12, 6, 7, 0]);
        assert!(problem(&mesh).contains("belongs to 3 cells"));

        let mut mesh = cubes(1);
        mesh.positions.push(DVec3::new(3.0, 0.5, 0.5));
        mesh.push_cell(CellShape::Tetrahedron, &[4, 5, 6, 8]);
        assert!(problem(&mesh).contains("half of a quad"));

        let mut mesh = cubes(1);
        mesh.positions.extend([
            DVec3::new(1.0, 0.5, 0.0),
            DVec3::new(1.0, 0.5, 0.5),
            DVec3::new(2.0, 0.0, 0.0),
        ]);
        mesh.push_cell(CellShape::Tetrahedron, &[4, 8, 9, 10]);
        assert!(problem(&mesh).contains("middle of an edge"));
        mesh.positions[8].y = 0.3;
        assert!(problem(&mesh).contains("middle of a face"));
    }

    #[test]
    fn cells_that_hang_by_a_vertex_or_an_edge_are_refused() {
        let far = [
            DVec3::new(3.0, 3.0, 0.0),
            DVec3::new(3.0, 0.0, 3.0),
            DVec3::new(4.0, 3.0, 3.0),
        ];
        for cell in [[7, 8, 9, 10], [7, 6, 9, 10]] {
            let mut mesh = cubes(1);
            mesh.positions.extend(far);
            mesh.push_cell(CellShape::Tetrahedron, &cell);
            assert!(problem(&mesh).contains("by no face"));
        }
    }
}
