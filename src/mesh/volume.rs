use glam::DVec3;

/// The kinds of cell that a volume mesh may have. The local numbering of vertices is VTK's; the determinant of the map from the
/// reference cell is positive where a cell is not inverted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum CellShape {
    /// Four vertices: 1, 2, 3 counter-clockwise seen from outside, so that (1−0)×(2−0)·(3−0) > 0.
    Tetrahedron,
    /// Six vertices: the triangle 0, 1, 2, counter-clockwise seen from the triangle 3, 4, 5 above it.
    Prism,
    /// Eight vertices: the quad 0, 1, 2, 3, counter-clockwise seen from the quad 4, 5, 6, 7 above it.
    Hexahedron,
}

impl CellShape {
    /// All shapes, in the order of their discriminants.
    pub const ALL: [Self; 3] = [Self::Tetrahedron, Self::Prism, Self::Hexahedron];

    /// The number of vertices.
    pub const fn vertex_count(self) -> usize {
        match self {
            Self::Tetrahedron => 4,
            Self::Prism => 6,
            Self::Hexahedron => 8,
        }
    }

    /// Pairs of local vertices. Where a direction is natural, from parameter 0 to parameter 1.
    pub const fn edges(self) -> &'static [[usize; 2]] {
        match self {
            Self::Tetrahedron => &[[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]],
            Self::Prism => &[
                [0, 1],
                [1, 2],
                [0, 2],
                [3, 4],
                [4, 5],
                [3, 5],
                [0, 3],
                [1, 4],
                [2, 5],
            ],
            Self::Hexahedron => &[
                [0, 1],
                [1, 2],
                [3, 2],
                [0, 3],
                [4, 5],
                [5, 6],
                [7, 6],
                [4, 7],
                [0, 4],
                [1, 5],
                [2, 6],
                [3, 7],
            ],
        }
    }

    /// Local vertices of the faces, counter-clockwise seen from outside.
    pub const fn faces(self) -> &'static [&'static [usize]] {
        match self {
            Self::Tetrahedron => &[&[0, 2, 1], &[0, 1, 3], &[1, 2, 3], &[0, 3, 2]],
            Self::Prism => &[
                &[0, 2, 1],
                &[3, 4, 5],
                &[0, 1, 4, 3],
                &[1, 2, 5, 4],
                &[0, 3, 5, 2],
            ],
            Self::Hexahedron => &[
                &[0, 3, 2, 1],
                &[4, 5, 6, 7],
                &[0, 1, 5, 4],
                &[1, 2, 6, 5],
                &[2, 3, 7, 6],
                &[0, 4, 7, 3],
            ],
        }
    }

    /// Each corner, and the three that it has edges to, right-handed. The map from the reference tetrahedron is the same at all corners, so
    /// one stands for them.
    pub const fn spokes(self) -> &'static [[usize; 4]] {
        match self {
            Self::Tetrahedron => &[[0, 1, 2, 3]],
            Self::Prism => &[
                [0, 1, 2, 3],
                [1, 2, 0, 4],
                [2, 0, 1, 5],
                [3, 5, 4, 0],
                [4, 3, 5, 1],
                [5, 4, 3, 2],
            ],
            Self::Hexahedron => &[
                [0, 1, 3, 4],
                [1, 2, 0, 5],
                [2, 3, 1, 6],
                [3, 0, 2, 7],
                [4, 7, 5, 0],
                [5, 4, 6, 1],
                [6, 5, 7, 2],
                [7, 6, 4, 3],
            ],
        }
    }

    /// The name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tetrahedron => "tetrahedron",
            Self::Prism => "prism",
            Self::Hexahedron => "hexahedron",
        }
    }
}

/// Tetrahedra, prisms and hexahedra over shared vertices, with straight edges.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VolumeMesh {
    /// `[vertices]`.
    pub positions: Vec<DVec3>,
    shapes: Vec<CellShape>,
    /// `[cells]`: where the vertices of a cell begin in `vertices`.
    starts: Vec<u32>,
    /// Indices into `positions`.
    vertices: Vec<u32>,
}

impl VolumeMesh {
    /// A mesh without cells.
    pub fn new(positions: Vec<DVec3>) -> Self {
        Self {
            positions,
            ..Self::default()
        }
    }

    /// Appends a cell.
    ///
    /// # Panics
    /// Where the number of vertices is not the shape's.
    pub fn push_cell(&mut self, shape: CellShape, vertices: &[u32]) {
        assert_eq!(
            vertices.len(),
            shape.vertex_count(),
            "vertices of a {}",
            shape.name()
        );
        self.shapes.push(shape);
        self.starts.push(self.vertices.len() as u32);
        self.vertices.extend_from_slice(vertices);
    }

    /// The number of cells.
    pub fn cell_count(&self) -> usize {
        self.shapes.len()
    }

    /// The shape of cell `c`.
    pub fn shape(&self, c: usize) -> CellShape {
        self.shapes[c]
    }

    /// The vertices of cell `c`, in the local numbering of its shape.
    pub fn cell(&self, c: usize) -> &[u32] {
        let start = self.starts[c] as usize;
        &self.vertices[start..start + self.shapes[c].vertex_count()]
    }

    /// Shape and vertices of all cells, in order.
    pub fn cells(&self) -> impl ExactSizeIterator<Item = (CellShape, &[u32])> + Clone {
        (0..self.cell_count()).map(|c| (self.shape(c), self.cell(c)))
    }
}
