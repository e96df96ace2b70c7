//! The boundary of a volume mesh cut along its sharp edges: smooth patches, the curves between them, and the corners where curves end or turn.

use crate::mesh::VolumeMesh;
use crate::mesh::check_volume::boundary_faces;
use glam::DVec3;
use std::collections::BTreeMap;

/// An edge is sharp where the normals of its faces differ by more than this many degrees. Between quads of coarse round surfaces there are some 30.
const SHARP_DEGREES: f64 = 40.0;

/// The faces of the boundary, counter-clockwise seen from outside.
pub(super) fn boundary_polygons(mesh: &VolumeMesh) -> Vec<Vec<u32>> {
    let polygon = |(c, f): (usize, usize)| {
        let corners = mesh.shape(c).faces()[f].iter();
        corners.map(|&k| mesh.cell(c)[k]).collect()
    };
    boundary_faces(mesh).into_iter().map(polygon).collect()
}

/// Where a vertex of the boundary may go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Freedom {
    /// Over a patch.
    Patch(u32),
    /// Along a curve.
    Curve(u32),
    /// Nowhere.
    Corner,
}

/// What the boundary consists of.
#[derive(Debug, Default)]
pub(super) struct Features {
    /// `[faces]`: their patches.
    pub patches: Vec<u32>,
    /// The number of patches.
    pub patch_count: usize,
    /// Sharp edges, each with its curve.
    pub edges: Vec<([u32; 2], u32)>,
    /// The number of curves.
    pub curve_count: usize,
    /// Of every vertex of the boundary.
    pub vertices: BTreeMap<u32, Freedom>,
}

impl Features {
    pub fn of(positions: &[DVec3], faces: &[Vec<u32>]) -> Self {
        let mut sides: BTreeMap<[u32; 2], Vec<u32>> = BTreeMap::new();
        for (f, face) in faces.iter().enumerate() {
            for k in 0..face.len() {
                let (a, b) = (face[k], face[(k + 1) % face.len()]);
                sides
                    .entry([a.min(b), a.max(b)])
                    .or_default()
                    .push(f as u32);
            }
        }
        let normals: Vec<DVec3> = faces.iter().map(|face| normal(positions, face)).collect();
        let least = SHARP_DEGREES.to_radians().cos();
        let mut patches = Sets::new(faces.len());
        let mut sharp = Vec::new();
        for (&edge, around) in &sides {
            match around[..] {
                [f, g] if normals[f as usize].dot(normals[g as usize]) >= least => {
                    patches.join(f, g)
                }
                _ => sharp.push(edge),
            }
        }
        let (patches, patch_count) = patches.numbers();
        let mut features = Self {
            patches,
            patch_count,
            ..Self::default()
        };
        for (face, &patch) in faces.iter().zip(&features.patches) {
            for &v in face {
                features.vertices.entry(v).or_insert(Freedom::Patch(patch));
            }
        }
        features.add_curves(positions, &sharp);
        features
    }

    /// Curves run through vertices of two sharp edges that go on in about the same direction.
    fn add_curves(&mut self, positions: &[DVec3], sharp: &[[u32; 2]]) {
        let mut around: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for (e, edge) in sharp.iter().enumerate() {
            edge.iter()
                .for_each(|&v| around.entry(v).or_default().push(e as u32));
        }
        let mut curves = Sets::new(sharp.len());
        let least = SHARP_DEGREES.to_radians().cos();
        let direction = |e: u32, from: u32| {
            let [a, b] = sharp[e as usize];
            let other = if a == from { b } else { a };
            (positions[other as usize] - positions[from as usize]).normalize_or_zero()
        };
        for (&v, edges) in &around {
            let freedom = match edges[..] {
                [e, f] if -direction(e, v).dot(direction(f, v)) >= least => {
                    curves.join(e, f);
                    Freedom::Curve(e)
                }
                _ => Freedom::Corner,
            };
            self.vertices.insert(v, freedom);
        }
        let (numbers, count) = curves.numbers();
        for freedom in self.vertices.values_mut() {
            if let Freedom::Curve(e) = freedom {
                *e = numbers[*e as usize];
            }
        }
        self.curve_count = count;
        self.edges = sharp.iter().copied().zip(numbers).collect();
    }
}

/// The unit normal of a polygon; zero where it has no area.
fn normal(positions: &[DVec3], face: &[u32]) -> DVec3 {
    let at = |k: usize| positions[face[k] as usize] - positions[face[0] as usize];
    let sum: DVec3 = (2..face.len()).map(|k| at(k - 1).cross(at(k))).sum();
    sum.normalize_or_zero()
}

/// Disjoint sets of numbers.
struct Sets(Vec<u32>);

impl Sets {
    fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    fn root(&mut self, mut k: u32) -> u32 {
        while self.0[k as usize] != k {
            self.0[k as usize] = self.0[self.0[k as usize] as usize];
            k = self.0[k as usize];
        }
        k
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// Which set each number is in, the sets counted in the order of their first members; and their number.
    fn numbers(mut self) -> (Vec<u32>, usize) {
        let roots: Vec<u32> = (0..self.0.len() as u32).map(|k| self.root(k)).collect();
        let mut names = vec![0; roots.len()];
        let mut count = 0;
        for (k, &root) in roots.iter().enumerate() {
            if root as usize == k {
                names[k] = count;
                count += 1;
            }
        }
        (
            roots.iter().map(|&r| names[r as usize]).collect(),
            count as usize,
        )
    }
}
