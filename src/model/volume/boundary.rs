//! The surface of a volume, and a triangle mesh that samples it as a linear function of the volume's coefficients.

use super::CurvedVolume;
use super::entities::Face;
use crate::kernel::sparse::Csr;
use crate::mesh::TriangleMesh;
use crate::model::element::{Factor, TRIANGLE_EDGES, Table, modes};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A sampled boundary: X = M P, P the coefficients of the volume.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundarySurface {
    /// M, `[samples, coefficients]`.
    pub matrix: Csr,
    /// Indices of samples, counter-clockwise seen from outside; neighbours share the samples between them.
    pub triangles: Vec<[u32; 3]>,
    /// `[triangles]`: which face of [`CurvedVolume::boundary`] each comes from, ascending.
    pub patches: Vec<u32>,
    /// `[triangles]`: the corners in the frame of that face.
    parameters: Vec<[DVec2; 3]>,
}

/// A point of a sampled boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryPoint {
    /// The triangle that it is on.
    pub triangle: u32,
    /// Weights of the triangle's corners: non-negative, sum 1.
    pub barycentric: [f64; 3],
}

impl BoundarySurface {
    /// The surface for given coefficients.
    pub fn mesh(&self, coefficients: &[DVec3]) -> TriangleMesh {
        TriangleMesh {
            positions: self.matrix.apply(coefficients),
            triangles: self.triangles.clone(),
        }
    }
}

/// Where the samples of the boundary are: those of vertices, then of edges, then of faces.
struct Samples {
    /// Intervals along an edge.
    n: usize,
    vertices: BTreeMap<u32, u32>,
    edges: BTreeMap<usize, u32>,
}

impl CurvedVolume {
    /// The faces that only one cell has: (cell, local face of its shape), ascending.
    pub fn boundary(&self) -> Vec<(u32, u32)> {
        (0..self.cell_count())
            .flat_map(|c| {
                let faces = self.entities.faces_of(c).iter().enumerate();
                faces
                    .filter(|&(_, &f)| self.entities.is_boundary(f))
                    .map(move |(k, _)| (c as u32, k as u32))
            })
            .collect()
    }

    /// The boundary with every edge cut into `n` ≥ 1 parts of equal parameter: 2n² triangles a quad, n² a triangle.
    pub fn boundary_surface(&self, n: usize) -> BoundarySurface {
        let boundary = self.boundary();
        let faces = self.boundary_faces(&boundary);
        let samples = self.number_samples(&faces, n);
        let mut rows: Vec<Vec<(u32, f64)>> =
            samples.vertices.keys().map(|&v| vec![(v, 1.0)]).collect();
        for &e in samples.edges.keys() {
            let points: Vec<f64> = (1..n).map(|k| k as f64 / n as f64).collect();
            let order = self.edges.order(e);
            let table = Table::new(self.basis, order, &Factor::Line(points));
            rows.extend(table.values.chunks_exact(table.modes.max(1)).map(|row| {
                let columns = self.entities.edges[e]
                    .into_iter()
                    .chain(self.edges.range(e));
                columns.zip(row.iter().copied()).collect()
            }));
        }
        let inside = |face: &Face| self.face_rows(face, &inside_points(face, n));
        let parts: Vec<Vec<_>> = faces.par_iter().map(inside).collect();
        let mut triangles = Vec::new();
        let mut patches = Vec::new();
        let mut parameters = Vec::new();
        for (patch, (face, part)) in faces.iter().zip(parts).enumerate() {
            let first = rows.len() as u32;
            rows.extend(part);
            let (c, k) = boundary[patch];
            let shape = self.shape(c as usize);
            let ids = self.vertices(c as usize);
            let outward = shape.faces()[k as usize]
                .iter()
                .map(|&v| ids[v])
                .collect::<Vec<_>>();
            let mirrored = is_mirrored(face, &outward);
            for mut corners in samples.triangles(self, face, first) {
                if mirrored {
                    corners.swap(1, 2);
                }
                triangles.push(corners.map(|c| c.0));
                parameters.push(corners.map(|c| c.1));
                patches.push(patch as u32);
            }
        }
        BoundarySurface {
            matrix: Csr::from_rows(&rows, self.coefficients.len()),
            triangles,
            patches,
            parameters,
        }
    }

    /// The curved boundary itself, not its triangles, at the parameters of some points of them: `[points, coefficients]`. All points of
    /// a face have entries, zeros included, in the same columns.
    pub fn boundary_rows(&self, surface: &BoundarySurface, points: &[BoundaryPoint]) -> Csr {
        let faces = self.boundary_faces(&self.boundary());
        let patch = |p: &BoundaryPoint| surface.patches[p.triangle as usize];
        let runs: Vec<&[BoundaryPoint]> = points.chunk_by(|a, b| patch(a) == patch(b)).collect();
        let parts: Vec<Vec<_>> = runs
            .par_iter()
            .map(|run| {
                let at = |p: &BoundaryPoint| {
                    let corners = surface.parameters[p.triangle as usize];
                    corners.iter().zip(p.barycentric).map(|(c, b)| *c * b).sum()
                };
                let parameters: Vec<DVec2> = run.iter().map(at).collect();
                self.face_rows(&faces[patch(&run[0]) as usize], &parameters)
            })
            .collect();
        Csr::from_rows(&parts.concat(), self.coefficients.len())
    }

    fn boundary_faces(&self, boundary: &[(u32, u32)]) -> Vec<Face> {
        let face = |&(c, k): &(u32, u32)| {
            let f = self.entities.faces_of(c as usize)[k as usize];
            self.entities.faces[f as usize]
        };
        boundary.iter().map(face).collect()
    }

    fn number_samples(&self, faces: &[Face], n: usize) -> Samples {
        let mut vertices = BTreeMap::new();
        let mut edges = BTreeMap::new();
        for face in faces {
            let cycle = face.vertices();
            for (k, &v) in cycle.iter().enumerate() {
                vertices.insert(v, 0);
                let next = cycle[(k + 1) % cycle.len()];
                edges.insert(self.entities.edge_between(v, next), 0);
            }
        }
        let vertex_samples = vertices.len() as u32;
        vertices.values_mut().zip(0..).for_each(|(s, k)| *s = k);
        let per_edge = n as u32 - 1;
        edges
            .values_mut()
            .zip(0..)
            .for_each(|(s, k)| *s = vertex_samples + k * per_edge);
        Samples { n, vertices, edges }
    }

    /// The rows of points in the frame of a face.
    fn face_rows(&self, face: &Face, points: &[DVec2]) -> Vec<Vec<(u32, f64)>> {
        match face {
            Face::Triangle(v) => self.triangle_rows(face, *v, points),
            Face::Quad(v) => self.quad_rows(face, *v, points),
        }
    }

    fn triangle_rows(&self, face: &Face, v: [u32; 3], points: &[DVec2]) -> Vec<Vec<(u32, f64)>> {
        let f = self.entities.face_number(face);
        let edges = TRIANGLE_EDGES.map(|[a, b]| self.entities.edge_between(v[a], v[b]));
        let order = edges
            .iter()
            .map(|&e| self.edges.order(e))
            .fold(self.faces.order(f), usize::max);
        let points = points.iter().map(|p| p.to_array()).collect();
        let table = Table::new(self.basis, order, &Factor::Triangle(points));
        table
            .values
            .chunks_exact(table.modes.max(1))
            .map(|row| {
                let mut entries: Vec<(u32, f64)> = v.into_iter().zip(row.iter().copied()).collect();
                for (e, block) in edges.iter().zip(row[3..].chunks(order.max(2) - 1)) {
                    entries.extend(self.edges.range(*e).zip(block.iter().copied()));
                }
                let inside = &row[3 * order..];
                entries.extend(self.faces.range(f).zip(inside.iter().copied()));
                entries
            })
            .collect()
    }

    fn quad_rows(
        &self,
        face: &Face,
        [o, s, d, t]: [u32; 4],
        points: &[DVec2],
    ) -> Vec<Vec<(u32, f64)>> {
        let f = self.entities.face_number(face);
        // (from, to, whether along s, at the end 1 of the other axis).
        let sides = [
            (o, s, true, 0),
            (t, d, true, 1),
            (o, t, false, 0),
            (s, d, false, 1),
        ];
        let edges = sides.map(|(a, b, ..)| self.entities.edge_between(a, b));
        let order = edges
            .iter()
            .map(|&e| self.edges.order(e))
            .fold(self.faces.order(f), usize::max);
        let line = |x: fn(&DVec2) -> f64| Factor::Line(points.iter().map(x).collect());
        let along_s = Table::new(self.basis, order, &line(|p| p.x));
        let along_t = Table::new(self.basis, order, &line(|p| p.y));
        let inner = modes::quad(self.faces.order(f));
        along_s
            .values
            .chunks_exact(along_s.modes.max(1))
            .zip(along_t.values.chunks_exact(along_t.modes.max(1)))
            .map(|(x, y)| {
                let mut entries = vec![
                    (o, x[0] * y[0]),
                    (s, x[1] * y[0]),
                    (d, x[1] * y[1]),
                    (t, x[0] * y[1]),
                ];
                for (&e, (from, to, along_s, end)) in edges.iter().zip(sides) {
                    let (along, across) = if along_s { (x, y[end]) } else { (y, x[end]) };
                    for (global, m) in self.edges.range(e).zip(2usize..) {
                        let sign = if from > to && m % 2 == 1 { -1.0 } else { 1.0 };
                        entries.push((global, sign * along[m] * across));
                    }
                }
                let inside = self.faces.range(f).zip(&inner);
                entries.extend(inside.map(|(global, m)| (global, x[m[0]] * y[m[1]])));
                entries
            })
            .collect()
    }
}

impl Samples {
    /// The triangles of a face whose inside samples begin at `first`, counter-clockwise in its frame: samples and where they are
    /// in that frame.
    fn triangles(&self, volume: &CurvedVolume, face: &Face, first: u32) -> Vec<[(u32, DVec2); 3]> {
        let n = self.n;
        let place = |i: usize, j: usize| DVec2::new(i as f64, j as f64) / n as f64;
        // Sample k of n along the edge from a to b.
        let along = |a: u32, b: u32, k: usize| {
            let k = if a < b { k } else { n - k };
            let (low, high) = (a.min(b), a.max(b));
            match k {
                0 => self.vertices[&low],
                k if k == n => self.vertices[&high],
                k => self.edges[&volume.entities.edge_between(a, b)] + k as u32 - 1,
            }
        };
        let mut triangles = Vec::new();
        match *face {
            Face::Quad([o, s, d, t]) => {
                let sample = |i: usize, j: usize| match (i, j) {
                    (i, 0) => along(o, s, i),
                    (0, j) => along(o, t, j),
                    (i, j) if j == n => along(t, d, i),
                    (i, j) if i == n => along(s, d, j),
                    (i, j) => first + ((j - 1) * (n - 1) + i - 1) as u32,
                };
                let at = |i, j| (sample(i, j), place(i, j));
                for j in 0..n {
                    for i in 0..n {
                        triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                        triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
                    }
                }
            }
            Face::Triangle([a, b, c]) => {
                // Rows j of n − 1 − j inside samples.
                let inside = |i: usize, j: usize| (1..j).map(|r| n - 1 - r).sum::<usize>() + i - 1;
                let sample = |i: usize, j: usize| match (i, j) {
                    (i, 0) => along(a, b, i),
                    (0, j) => along(a, c, j),
                    (i, j) if i + j == n => along(b, c, j),
                    (i, j) => first + inside(i, j) as u32,
                };
                let at = |i, j| (sample(i, j), place(i, j));
                for j in 0..n {
                    for i in 0..n - j {
                        triangles.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                        if i + j + 1 < n {
                            triangles.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                        }
                    }
                }
            }
        }
        triangles
    }
}

/// The samples inside a face, s (or u) fastest.
fn inside_points(face: &Face, n: usize) -> Vec<DVec2> {
    let row = |j: usize| match face {
        Face::Quad(_) => 1..n,
        Face::Triangle(_) => 1..n - j,
    };
    let place = |i: usize, j: usize| DVec2::new(i as f64, j as f64) / n as f64;
    (1..n)
        .flat_map(|j| row(j).map(move |i| place(i, j)))
        .collect()
}

/// Whether the cycle of a face's frame runs against an outward one.
fn is_mirrored(face: &Face, outward: &[u32]) -> bool {
    let [first, second] = [face.vertices()[0], face.vertices()[1]];
    let at = outward.iter().position(|&v| v == first).unwrap_or(0);
    outward[(at + 1) % outward.len()] != second
}
