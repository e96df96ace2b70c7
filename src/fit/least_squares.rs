//! Weighted least squares on frozen footpoints, solved for the control points.
//!
//! The objective is quadratic in P: Σ w (x − t)ᵀ (n nᵀ + μ (I − n nᵀ)) (x − t) over footpoints, x = Σ_k b_k (M P)_{v_k} on a
//! triangle of S, plus λ_n and λ_t times the mean square of the normal and tangential part of L M P,
//! and a little of L² P. Its matrix has one
//! 3×3 block for each pair of control points that share a patch. It is assembled patch by patch (a patch is what one
//! control face becomes): first on the patch's vertices, then by their few rows of M, which takes far fewer
//! operations than adding up outer products of footpoints. [`super::normal_equations`] solves it.

use super::normal_equations::{Pattern, Share, Support};
use super::symmetric::Symmetric3;
use crate::energy::Smoothness;
use crate::kernel::sparse::Csr;
use crate::model::Model;
use glam::DVec3;

/// What the squared Laplacian of the control mesh counts against the Laplacian of the surface, mean square against mean
/// square. A limit surface hides waves from point to point of the control mesh almost wholly, so the surface's own
/// regularizer does not keep the cage from zigzagging; the squared Laplacian hardly sees anything else. The larger, the calmer
/// the cage and the larger the error: the rms of the bunny with 1,538 points is 0.038 % without, 0.042 % with 1/256 and
/// 0.047 % with 1/16.
const CAGE: f64 = 1.0 / 512.0;

/// Where a point of S should go.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footpoint {
    /// The triangle of S.
    pub triangle: u32,
    /// The point on it.
    pub barycentric: [f64; 3],
    /// Where it should be.
    pub goal: DVec3,
    /// The unit normal of the target there: only distances along it count fully.
    pub normal: DVec3,
    /// The weight.
    pub weight: f64,
}

/// What the regularizer needs to know of the surface.
pub(super) struct Shape {
    /// `[vertices]`: unit normals of S, which split the regularizer.
    pub normals: Vec<DVec3>,
    /// `[vertices]`: factors on its weights.
    pub stiffness: Vec<f64>,
}

/// The weights of the regularizer's two parts, and of tangential distances.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weights {
    /// λ_n.
    pub normal: f64,
    /// λ_t.
    pub tangential: f64,
    /// μ.
    pub sliding: f64,
}

/// The pattern of the normal equations of a model; reused while the model stays.
pub(super) struct LeastSquares {
    patches: Vec<Patch>,
    pattern: Pattern,
    /// The patch of each triangle of S.
    patch_of: Vec<u32>,
}

/// One control face's part of the surface.
struct Patch {
    /// The number of control points that its vertices depend on: its support in the pattern.
    support: usize,
    /// Its triangles, as local vertices; the first has this index.
    triangles: Vec<[u32; 3]>,
    first_triangle: u32,
    /// The local control points that the rows of M of its vertices are over, ascending.
    seen: Vec<u32>,
    /// Those rows, over places in `seen`.
    rows: Vec<Vec<(u32, f64)>>,
    /// The rows of L M of the vertices that it owns, and of L² on the control mesh.
    smooth: Vec<SmoothRow>,
}

/// A row of the regularizer.
struct SmoothRow {
    /// The vertex of S at which it is taken.
    vertex: u32,
    /// Its weight against a row of L M.
    share: f64,
    /// Over local control points.
    entries: Vec<(u32, f64)>,
}

impl LeastSquares {
    /// Analyses a model. `cage`: the squared Laplacian of its control mesh.
    pub fn new(model: &Model, smoothness: &Smoothness, cage: &Csr) -> Self {
        let control_points = model.matrix.column_count;
        let mut owner_taken = vec![false; model.matrix.row_count()];
        let mut patches: Vec<Patch> = Vec::new();
        let mut supports = Vec::new();
        let mut first = 0;
        for group in model.patches.chunk_by(|a, b| a == b) {
            let triangles = &model.triangles[first..first + group.len()];
            let (patch, support) = Patch::new(
                model,
                smoothness,
                cage,
                triangles,
                first as u32,
                &mut owner_taken,
            );
            patches.push(patch);
            supports.push(support);
            first += group.len();
        }
        let mut patch_of = vec![0; model.triangles.len()];
        for (k, p) in patches.iter().enumerate() {
            let begin = p.first_triangle as usize;
            patch_of[begin..begin + p.triangles.len()].fill(k as u32);
        }
        Self {
            patches,
            pattern: Pattern::new(supports, control_points),
            patch_of,
        }
    }

    /// Moves `control_points` to the minimum, to a relative residual of `tolerance`.
    pub fn solve(
        &self,
        footpoints: &[Footpoint],
        shape: &Shape,
        weights: Weights,
        control_points: &mut [DVec3],
        tolerance: f64,
    ) {
        let (starts, order) = self.by_patch(footpoints);
        let smooth = Weights {
            normal: weights.normal / shape.normals.len() as f64,
            tangential: weights.tangential / shape.normals.len() as f64,
            sliding: weights.sliding,
        };
        let system = self.pattern.assemble(|k| {
            let mine = &order[starts[k] as usize..starts[k + 1] as usize];
            let mine = mine.iter().map(|&f| &footpoints[f as usize]);
            self.patches[k].assemble(mine, shape, smooth)
        });
        system.conjugate_gradients(control_points, tolerance);
    }

    /// The footpoints sorted by patch, in their own order within one.
    fn by_patch(&self, footpoints: &[Footpoint]) -> (Vec<u32>, Vec<u32>) {
        let mut starts = vec![0u32; self.patches.len() + 1];
        for f in footpoints {
            starts[self.patch_of[f.triangle as usize] as usize + 1] += 1;
        }
        for k in 0..self.patches.len() {
            starts[k + 1] += starts[k];
        }
        let mut next = starts.clone();
        let mut order = vec![0; footpoints.len()];
        for (k, f) in footpoints.iter().enumerate() {
            let slot = &mut next[self.patch_of[f.triangle as usize] as usize];
            order[*slot as usize] = k as u32;
            *slot += 1;
        }
        (starts, order)
    }
}

impl Patch {
    fn new(
        model: &Model,
        smoothness: &Smoothness,
        cage: &Csr,
        triangles: &[[u32; 3]],
        first_triangle: u32,
        owned: &mut [bool],
    ) -> (Self, Support) {
        let mut vertices: Vec<u32> = triangles.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mine: Vec<u32> = vertices
            .iter()
            .copied()
            .filter(|&v| !std::mem::replace(&mut owned[v as usize], true))
            .collect();
        // Vertex i of S belongs to control point i.
        let controls = || {
            mine.iter()
                .copied()
                .filter(|&v| (v as usize) < cage.row_count())
        };
        let cage_share = CAGE * model.matrix.row_count() as f64 / cage.row_count() as f64;
        let mut seen: Vec<u32> = vertices
            .iter()
            .flat_map(|&v| model.matrix.row(v as usize).map(|e| e.0))
            .collect();
        seen.sort_unstable();
        seen.dedup();
        let laplacians = mine.iter().map(|&v| (v, 1.0, smoothness.rows()));
        let laplacians = laplacians.chain(controls().map(|v| (v, cage_share, cage)));
        let row = |matrix: &Csr, v: u32| matrix.row(v as usize).map(|e| e.0).collect();
        let smooth_rows = laplacians.clone().map(|(v, _, matrix)| row(matrix, v));
        let support = Support::of(
            &std::iter::once(seen.clone())
                .chain(smooth_rows)
                .collect::<Vec<_>>(),
        );
        let local = |list: &[u32], x: u32| list.binary_search(&x).expect("listed above") as u32;
        let row = |matrix: &Csr, v: u32, list: &[u32]| -> Vec<(u32, f64)> {
            let entries = matrix.row(v as usize);
            entries.map(|(c, value)| (local(list, c), value)).collect()
        };
        let patch = Self {
            triangles: triangles
                .iter()
                .map(|t| t.map(|v| local(&vertices, v)))
                .collect(),
            first_triangle,
            rows: vertices
                .iter()
                .map(|&v| row(&model.matrix, v, &seen))
                .collect(),
            smooth: laplacians
                .map(|(vertex, share, matrix)| SmoothRow {
                    vertex,
                    share,
                    entries: row(matrix, vertex, &support.controls),
                })
                .collect(),
            seen: seen.iter().map(|&c| local(&support.controls, c)).collect(),
            support: support.controls.len(),
        };
        (patch, support)
    }

    /// The patch's part of the matrix, `[support, support]` from the diagonal on, and of the right-hand side.
    fn assemble<'a>(
        &self,
        footpoints: impl Iterator<Item = &'a Footpoint>,
        shape: &Shape,
        weights: Weights,
    ) -> Share {
        let n = self.support;
        let mut blocks = vec![Symmetric3::ZERO; n * n];
        let mut right = vec![DVec3::ZERO; n];
        // Half way: rows are the patch's vertices, columns already control points.
        let width = self.seen.len();
        let mut half = vec![Symmetric3::ZERO; self.rows.len() * width];
        let mut vertex_right = vec![DVec3::ZERO; self.rows.len()];
        let mut pairs = vec![[[Symmetric3::ZERO; 3]; 3]; self.triangles.len()];
        for f in footpoints {
            let metric = Symmetric3::split(f.normal, 1.0, weights.sliding) * f.weight;
            let t = (f.triangle - self.first_triangle) as usize;
            let pull = metric * f.goal;
            for k in 0..3 {
                vertex_right[self.triangles[t][k] as usize] += pull * f.barycentric[k];
                for (pair, b) in pairs[t][k].iter_mut().zip(f.barycentric) {
                    *pair += metric * (f.barycentric[k] * b);
                }
            }
        }
        for (t, pairs) in self.triangles.iter().zip(&pairs) {
            for k in 0..3 {
                let row = &mut half[t[k] as usize * width..][..width];
                for (&vertex, pair) in t.iter().zip(&pairs[k]) {
                    for &(j, m) in &self.rows[vertex as usize] {
                        row[j as usize] += *pair * m;
                    }
                }
            }
        }
        // The matrix is symmetric: columns from the diagonal on suffice.
        for (v, row) in self.rows.iter().enumerate() {
            for &(c, m) in row {
                let c = c as usize;
                let i = self.seen[c] as usize;
                right[i] += vertex_right[v] * m;
                let parts = &half[v * width + c..(v + 1) * width];
                for (&j, part) in self.seen[c..].iter().zip(parts) {
                    blocks[i * n + j as usize] += *part * m;
                }
            }
        }
        for smooth in &self.smooth {
            let normal = shape.normals[smooth.vertex as usize];
            let metric = Symmetric3::split(normal, weights.normal, weights.tangential)
                * (shape.stiffness[smooth.vertex as usize] * smooth.share);
            for (k, &(i, a)) in smooth.entries.iter().enumerate() {
                let scaled = metric * a;
                for &(j, b) in &smooth.entries[k..] {
                    blocks[i as usize * n + j as usize] += scaled * b;
                }
            }
        }
        (blocks, right)
    }
}
