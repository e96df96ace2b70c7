use super::{CellShape, VolumeMesh};
use glam::DVec3;
use std::collections::HashMap;

/// Polynomial cells of one order over shared nodes, each given by the positions of its nodes on an even lattice.
///
/// A node (i, j, k) of a cell of order p lies at (i, j, k)/p in the reference cell; its place among the cell's nodes is that of its
/// triple in [`NodalVolume::lattice`]. Neighbours name the nodes of a common face alike.
#[derive(Debug, Clone, PartialEq)]
pub struct NodalVolume {
    /// `[nodes]`.
    pub positions: Vec<DVec3>,
    order: usize,
    shapes: Vec<CellShape>,
    /// `[cells]`: where the nodes of a cell begin in `nodes`.
    starts: Vec<usize>,
    /// Indices into `positions`.
    nodes: Vec<u32>,
}

impl NodalVolume {
    /// A volume without cells.
    pub fn new(order: usize, positions: Vec<DVec3>) -> Self {
        Self {
            positions,
            order,
            shapes: Vec::new(),
            starts: Vec::new(),
            nodes: Vec::new(),
        }
    }

    /// Appends a cell by its nodes, in the order of [`NodalVolume::lattice`].
    ///
    /// # Panics
    /// Where the number of nodes is not that of the shape and order.
    pub fn push_cell(&mut self, shape: CellShape, nodes: &[u32]) {
        let wanted = Self::node_count(shape, self.order);
        assert_eq!(nodes.len(), wanted, "nodes of a {}", shape.name());
        self.shapes.push(shape);
        self.starts.push(self.nodes.len());
        self.nodes.extend_from_slice(nodes);
    }

    /// The polynomial order of all cells, per direction on hexahedra, along and across on prisms, total on triangles and tetrahedra.
    pub fn order(&self) -> usize {
        self.order
    }

    /// The number of cells.
    pub fn cell_count(&self) -> usize {
        self.shapes.len()
    }

    /// Shape and nodes of cell `c`.
    pub fn cell(&self, c: usize) -> (CellShape, &[u32]) {
        let start = self.starts[c];
        let count = Self::node_count(self.shapes[c], self.order);
        (self.shapes[c], &self.nodes[start..start + count])
    }

    /// Shapes and nodes of all cells, in order.
    pub fn cells(&self) -> impl ExactSizeIterator<Item = (CellShape, &[u32])> + Clone {
        (0..self.cell_count()).map(|c| self.cell(c))
    }

    /// The number of nodes of a cell.
    pub const fn node_count(shape: CellShape, order: usize) -> usize {
        let p = order;
        match shape {
            CellShape::Tetrahedron => (p + 1) * (p + 2) * (p + 3) / 6,
            CellShape::Prism => (p + 1) * (p + 1) * (p + 2) / 2,
            CellShape::Hexahedron => (p + 1) * (p + 1) * (p + 1),
        }
    }

    /// The lattice points (i, j, k) of a cell, i running fastest and k slowest: 0 ≤ i, j, k ≤ p, on prisms i + j ≤ p, on tetrahedra
    /// i + j + k ≤ p.
    pub fn lattice(shape: CellShape, order: usize) -> Vec<[usize; 3]> {
        let mut points = Vec::with_capacity(Self::node_count(shape, order));
        for k in 0..=order {
            let j_end = match shape {
                CellShape::Tetrahedron => order - k,
                CellShape::Prism | CellShape::Hexahedron => order,
            };
            for j in 0..=j_end {
                let i_end = match shape {
                    CellShape::Hexahedron => order,
                    CellShape::Prism | CellShape::Tetrahedron => j_end - j,
                };
                points.extend((0..=i_end).map(|i| [i, j, k]));
            }
        }
        points
    }

    /// The lattice points of the corners, in the local numbering of [`CellShape`].
    pub fn corner_points(shape: CellShape, order: usize) -> Vec<[usize; 3]> {
        let unit: &[[usize; 3]] = match shape {
            CellShape::Tetrahedron => &[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
            CellShape::Prism => &[
                [0, 0, 0],
                [1, 0, 0],
                [0, 1, 0],
                [0, 0, 1],
                [1, 0, 1],
                [0, 1, 1],
            ],
            CellShape::Hexahedron => &[
                [0, 0, 0],
                [1, 0, 0],
                [1, 1, 0],
                [0, 1, 0],
                [0, 0, 1],
                [1, 0, 1],
                [1, 1, 1],
                [0, 1, 1],
            ],
        };
        unit.iter()
            .map(|corner| corner.map(|x| x * order))
            .collect()
    }

    /// Cells over the topology of a mesh with the position of every node given, `[cells, nodes]`, in the order of
    /// [`NodalVolume::lattice`]. Neighbours share the nodes between them, with the position that the first of them gives.
    ///
    /// # Panics
    /// Where there are not as many positions as nodes of cells.
    pub fn from_cells(mesh: &VolumeMesh, order: usize, points: &[DVec3]) -> Self {
        let (nodes, count) = shared_nodes(mesh, order);
        assert_eq!(points.len(), nodes.len(), "positions of nodes");
        let mut positions = vec![DVec3::ZERO; count];
        for (&node, &p) in nodes.iter().zip(points).rev() {
            positions[node as usize] = p;
        }
        let mut volume = Self::new(order, positions);
        let mut rest = nodes.as_slice();
        for (shape, _) in mesh.cells() {
            let (cell, others) = rest.split_at(Self::node_count(shape, order));
            volume.push_cell(shape, cell);
            rest = others;
        }
        volume
    }

    /// For each of some lattice points of a cell, its place in [`NodalVolume::lattice`].
    ///
    /// # Panics
    /// Where a point is not of the lattice.
    pub(crate) fn places(shape: CellShape, order: usize, points: &[[usize; 3]]) -> Vec<usize> {
        let key = |&[i, j, k]: &[usize; 3]| [k, j, i];
        let lattice = Self::lattice(shape, order);
        let place = |p| lattice.binary_search_by_key(&key(p), key);
        points
            .iter()
            .map(|p| place(p).expect("a point of the lattice"))
            .collect()
    }

    /// The corners of all cells, numbered in the order of their nodes; nodes that are no corner are left out.
    pub fn corners(&self) -> VolumeMesh {
        let mut corners: Vec<u32> = Vec::new();
        let places = CellShape::ALL
            .map(|shape| Self::places(shape, self.order, &Self::corner_points(shape, self.order)));
        for (shape, nodes) in self.cells() {
            corners.extend(places[shape as usize].iter().map(|&at| nodes[at]));
        }
        let mut used = vec![false; self.positions.len()];
        for &node in &corners {
            used[node as usize] = true;
        }
        let mut number = vec![0; self.positions.len()];
        let mut positions = Vec::new();
        for node in (0..self.positions.len()).filter(|&n| used[n]) {
            number[node] = positions.len() as u32;
            positions.push(self.positions[node]);
        }
        let mut mesh = VolumeMesh::new(positions);
        let mut rest = corners.as_mut_slice();
        for &shape in &self.shapes {
            let (cell, others) = rest.split_at_mut(shape.vertex_count());
            cell.iter_mut().for_each(|v| *v = number[*v as usize]);
            mesh.push_cell(shape, cell);
            rest = others;
        }
        mesh
    }
}

/// Numbers the nodes of cells whose places are given cell by cell, so that neighbours share them.
fn shared_nodes(mesh: &VolumeMesh, order: usize) -> (Vec<u32>, usize) {
    let mut numbers: HashMap<Vec<(u32, u32)>, u32> = HashMap::new();
    let mut nodes = Vec::new();
    let mut count = 0;
    let lattices = CellShape::ALL.map(|shape| NodalVolume::lattice(shape, order));
    for (shape, vertices) in mesh.cells() {
        for &point in &lattices[shape as usize] {
            let mut key: Vec<(u32, u32)> = corner_weights(shape, order, point)
                .into_iter()
                .zip(vertices)
                .filter(|&(weight, _)| weight > 0)
                .map(|(weight, &v)| (v, weight))
                .collect();
            let mut fresh = || {
                count += 1;
                count - 1
            };
            // A node that all corners weigh in is inside the cell, and nobody else's.
            nodes.push(if key.len() == vertices.len() {
                fresh()
            } else {
                key.sort_unstable();
                *numbers.entry(key).or_insert_with(fresh)
            });
        }
    }
    (nodes, count as usize)
}

/// How much each corner weighs in a lattice point, as whole numbers: what tells a node on a common face from all others.
fn corner_weights(shape: CellShape, order: usize, [i, j, k]: [usize; 3]) -> Vec<u32> {
    let p = order;
    let weights = match shape {
        CellShape::Tetrahedron => vec![p - i - j - k, i, j, k],
        CellShape::Prism => {
            let triangle = [p - i - j, i, j];
            let layers = [p - k, k];
            layers
                .iter()
                .flat_map(|w| triangle.map(|t| t * w))
                .collect()
        }
        CellShape::Hexahedron => NodalVolume::corner_points(shape, 1)
            .into_iter()
            .map(|corner| {
                let side = |x: usize, end: usize| if end == 1 { x } else { p - x };
                side(i, corner[0]) * side(j, corner[1]) * side(k, corner[2])
            })
            .collect(),
    };
    // Weights of a tetrahedron's face are to be those of a prism's: all add up to p³ or to what divides it.
    let total: usize = weights.iter().sum();
    weights
        .into_iter()
        .map(|w| (w * p * p * p / total) as u32)
        .collect()
}

impl From<&VolumeMesh> for NodalVolume {
    /// Cells of order 1.
    fn from(mesh: &VolumeMesh) -> Self {
        let mut volume = Self::new(1, mesh.positions.clone());
        for (shape, vertices) in mesh.cells() {
            let corners = Self::corner_points(shape, 1);
            let mut nodes = vec![0; vertices.len()];
            for (at, &v) in Self::places(shape, 1, &corners).into_iter().zip(vertices) {
                nodes[at] = v;
            }
            volume.push_cell(shape, &nodes);
        }
        volume
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lattice_has_the_number_of_nodes_and_its_corners() {
        for shape in CellShape::ALL {
            for order in 1..=16 {
                let lattice = NodalVolume::lattice(shape, order);
                assert_eq!(lattice.len(), NodalVolume::node_count(shape, order));
                let places = NodalVolume::places(shape, order, &lattice);
                assert!(places.into_iter().eq(0..lattice.len()));
                let corners = NodalVolume::corner_points(shape, order);
                assert_eq!(corners.len(), shape.vertex_count());
                NodalVolume::places(shape, order, &corners);
            }
        }
    }

    #[test]
    fn a_linear_mesh_is_its_own_corners() {
        let mut mesh = VolumeMesh::new((0..8).map(|k| DVec3::splat(f64::from(k))).collect());
        mesh.push_cell(CellShape::Hexahedron, &[3, 1, 2, 0, 7, 6, 5, 4]);
        mesh.push_cell(CellShape::Prism, &[0, 1, 2, 3, 4, 5]);
        mesh.push_cell(CellShape::Tetrahedron, &[7, 5, 3, 1]);
        assert_eq!(NodalVolume::from(&mesh).corners(), mesh);
    }
}
