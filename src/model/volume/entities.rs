//! The edges and faces of a volume mesh, numbered.

use crate::error::Defect;
use crate::mesh::VolumeMesh;

/// In the place of a cell or a vertex that is not there.
const NONE: u32 = u32::MAX;

/// Edges and faces, and which cells have them. Numbers do not depend on the order of the cells.
#[derive(Debug, Clone, PartialEq)]
pub struct Entities {
    /// `[edges, 2]`: vertices, ascending.
    pub edges: Vec<[u32; 2]>,
    /// `[faces]`.
    pub faces: Vec<Face>,
    /// `[cells + 1]`: where the edges of a cell begin in `cell_edges`.
    edge_starts: Vec<u32>,
    cell_edges: Vec<u32>,
    /// `[cells + 1]`: where the faces of a cell begin in `cell_faces`.
    face_starts: Vec<u32>,
    cell_faces: Vec<u32>,
    /// `[faces]`: the number of cells that have it.
    uses: Vec<u8>,
}

/// A face in its own frame, which depends on nothing but its vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Face {
    /// Vertices, ascending.
    Triangle([u32; 3]),
    /// The smallest vertex, its smaller neighbour (along s), the vertex opposite to the first, its larger neighbour (along t).
    Quad([u32; 4]),
}

impl Face {
    /// From vertices in cyclic order.
    pub fn new(cycle: &[u32]) -> Self {
        let n = cycle.len();
        let first = (0..n).min_by_key(|&k| cycle[k]).unwrap_or(0);
        let at = |k: usize| cycle[(first + k) % n];
        let [next, last] = [at(1), at(n - 1)];
        let [s, t] = [next.min(last), next.max(last)];
        if n == 3 {
            Self::Triangle([at(0), s, t])
        } else {
            Self::Quad([at(0), s, at(2), t])
        }
    }

    /// Its vertices, in cyclic order.
    pub fn vertices(&self) -> &[u32] {
        match self {
            Self::Triangle(v) => v,
            Self::Quad(v) => v,
        }
    }

    /// The same for every face over the same vertices.
    fn key(&self) -> [u32; 4] {
        let mut key = [NONE; 4];
        key[..self.vertices().len()].copy_from_slice(self.vertices());
        key.sort_unstable();
        key
    }
}

impl Entities {
    /// The edges and faces of a mesh.
    ///
    /// # Errors
    /// Names the cell that has a vertex out of range or twice; the face that more than two cells have, or that two cells have with
    /// their vertices in different cycles.
    pub fn of(mesh: &VolumeMesh) -> Result<Self, Defect> {
        check_cells(mesh)?;
        let mut entities = Self {
            edges: Vec::new(),
            faces: Vec::new(),
            edge_starts: vec![0],
            cell_edges: Vec::new(),
            face_starts: vec![0],
            cell_faces: Vec::new(),
            uses: Vec::new(),
        };
        let mut edges = Vec::new();
        let mut faces = Vec::new();
        for (shape, cell) in mesh.cells() {
            edges.extend(shape.edges().iter().map(|e| {
                let [a, b] = e.map(|k| cell[k]);
                [a.min(b), a.max(b)]
            }));
            faces.extend(shape.faces().iter().map(|f| {
                let cycle: Vec<u32> = f.iter().map(|&k| cell[k]).collect();
                Face::new(&cycle)
            }));
            entities.edge_starts.push(edges.len() as u32);
            entities.face_starts.push(faces.len() as u32);
        }
        entities.edges = edges.clone();
        entities.edges.sort_unstable();
        entities.edges.dedup();
        entities.cell_edges = edges
            .iter()
            .map(|e| entities.edges.partition_point(|x| x < e) as u32)
            .collect();
        entities.number_faces(&faces)?;
        Ok(entities)
    }

    fn number_faces(&mut self, faces: &[Face]) -> Result<(), Defect> {
        let mut sorted = faces.to_vec();
        sorted.sort_by_key(|f| (f.key(), *f.vertices().get(2).unwrap_or(&NONE)));
        for group in sorted.chunk_by(|a, b| a.key() == b.key()) {
            if group.len() > 2 || group[0] != group[group.len() - 1] {
                return Err(Defect::new(
                    format!("the face with the vertices {:?}", group[0].vertices()),
                    if group.len() > 2 {
                        format!("{} cells have it", group.len())
                    } else {
                        "its two cells have its vertices in different cycles".into()
                    },
                    "remove duplicate cells and export the mesh again",
                ));
            }
            self.faces.push(group[0]);
            self.uses.push(group.len() as u8);
        }
        self.cell_faces = faces.iter().map(|f| self.face_number(f) as u32).collect();
        Ok(())
    }

    /// The edges of cell `c`, in the order of its shape.
    pub fn edges_of(&self, c: usize) -> &[u32] {
        &self.cell_edges[self.edge_starts[c] as usize..self.edge_starts[c + 1] as usize]
    }

    /// The faces of cell `c`, in the order of its shape.
    pub fn faces_of(&self, c: usize) -> &[u32] {
        &self.cell_faces[self.face_starts[c] as usize..self.face_starts[c + 1] as usize]
    }

    /// Whether a single cell has face `f`.
    pub fn is_boundary(&self, f: u32) -> bool {
        self.uses[f as usize] == 1
    }

    /// The number of a face that is there.
    pub fn face_number(&self, face: &Face) -> usize {
        let key = face.key();
        self.faces.partition_point(|f| f.key() < key)
    }

    /// The edge between two vertices that have one.
    pub fn edge_between(&self, a: u32, b: u32) -> usize {
        let key = [a.min(b), a.max(b)];
        self.edges.partition_point(|e| *e < key)
    }
}

fn check_cells(mesh: &VolumeMesh) -> Result<(), Defect> {
    let vertices = mesh.positions.len();
    for (c, (shape, cell)) in mesh.cells().enumerate() {
        let refuse = |problem| {
            Err(Defect::new(
                format!("cell {c} (a {}, counted from 0)", shape.name()),
                problem,
                "remove the cell, or export the mesh again",
            ))
        };
        if let Some(v) = cell.iter().find(|&&v| v as usize >= vertices) {
            return refuse(format!("it names vertex {v} of {vertices}"));
        }
        if let Some(v) = (1..cell.len()).find(|&k| cell[..k].contains(&cell[k])) {
            return refuse(format!("it has vertex {} twice", cell[v]));
        }
    }
    Ok(())
}
