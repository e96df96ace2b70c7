use super::TriangleMesh;
use glam::DVec3;

/// Polygons of any valence over shared vertices, stored as one flat list of corners.
#[derive(Debug, Clone, PartialEq)]
pub struct PolygonMesh {
    /// `[vertices]`.
    pub positions: Vec<DVec3>,
    /// `[faces + 1]`: the corners of face `f` are `corners[offsets[f]..offsets[f + 1]]`; starts with 0.
    offsets: Vec<u32>,
    /// Indices into `positions`, counter-clockwise seen from outside.
    corners: Vec<u32>,
}

impl Default for PolygonMesh {
    fn default() -> Self {
        Self::new(Vec::new())
    }
}

impl PolygonMesh {
    /// A mesh without faces.
    pub fn new(positions: Vec<DVec3>) -> Self {
        Self {
            positions,
            offsets: vec![0],
            corners: Vec::new(),
        }
    }

    /// A mesh from its faces' corner lists.
    pub fn from_faces<F: AsRef<[u32]>>(
        positions: Vec<DVec3>,
        faces: impl IntoIterator<Item = F>,
    ) -> Self {
        let mut mesh = Self::new(positions);
        for face in faces {
            mesh.push_face(face.as_ref());
        }
        mesh
    }

    /// Appends a face.
    pub fn push_face(&mut self, corners: &[u32]) {
        self.corners.extend_from_slice(corners);
        self.offsets.push(self.corners.len() as u32);
    }

    /// The number of faces.
    pub fn face_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The corners of face `f`.
    pub fn face(&self, f: usize) -> &[u32] {
        &self.corners[self.offsets[f] as usize..self.offsets[f + 1] as usize]
    }

    /// The corner lists of all faces, in order.
    pub fn faces(&self) -> impl ExactSizeIterator<Item = &[u32]> + Clone {
        self.offsets
            .windows(2)
            .map(|w| &self.corners[w[0] as usize..w[1] as usize])
    }

    /// `[faces + 1]`: where each face's corners begin in [`PolygonMesh::corners`].
    pub fn offsets(&self) -> &[u32] {
        &self.offsets
    }

    /// The corners of all faces, one face after the other.
    pub fn corners(&self) -> &[u32] {
        &self.corners
    }

    /// The mesh cut into triangles, each face as a fan from its first corner (a quad along the diagonal 0–2).
    pub fn triangulate(&self) -> TriangleMesh {
        let triangles = self
            .faces()
            .flat_map(|f| (2..f.len()).map(move |k| [f[0], f[k - 1], f[k]]))
            .collect();
        TriangleMesh {
            positions: self.positions.clone(),
            triangles,
        }
    }
}

impl From<TriangleMesh> for PolygonMesh {
    fn from(mesh: TriangleMesh) -> Self {
        Self::from_faces(mesh.positions, mesh.triangles)
    }
}

/// The surface that a polygon mesh stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheme {
    /// Its own faces.
    Polygon,
    /// The Catmull–Clark limit surface.
    CatmullClark,
    /// The Loop limit surface; triangles only.
    Loop,
}

/// An edge of a control mesh that stays sharp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crease {
    /// Its end vertices.
    pub edge: [u32; 2],
    /// Subdivision levels that it stays sharp for; infinite for always (OpenSubdiv's convention).
    pub sharpness: f64,
}

/// A control mesh: polygons with the edges and vertices that stay sharp under subdivision.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ControlMesh {
    /// The control points and faces.
    pub mesh: PolygonMesh,
    /// Sharp edges. Boundary edges are always sharp and need not be listed.
    pub creases: Vec<Crease>,
    /// Vertices that stay where the control point is.
    pub corners: Vec<u32>,
}

impl Crease {
    /// From this sharpness on an edge or a corner stays sharp on every level, in files as in OpenSubdiv and USD.
    pub const INFINITE: f64 = 10.0;
}

impl From<PolygonMesh> for ControlMesh {
    fn from(mesh: PolygonMesh) -> Self {
        Self {
            mesh,
            ..Self::default()
        }
    }
}
