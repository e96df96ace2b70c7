//! The two ways to move the control points towards the data on frozen footpoints.

use super::footpoints::Sample;
use crate::energy::laplacian;
use crate::fit::normal_equations::{Pattern, Share, split};
use crate::kernel::sparse::Csr;
use crate::mesh::{Connectivity, PolygonMesh};
use crate::model::limit_surface::{LimitSurface, SurfaceParameter};
use glam::{DMat3, DVec3};

/// μ: what a tangential distance counts against a normal one.
const SLIDING: f64 = 0.01;

/// The relative residual of the linear solves.
const TOLERANCE: f64 = 1e-2;

/// The weights of the normal and tangential part of the regularizer, the mean squared Laplacian of the control mesh, against the mean squared
/// distance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smoothness {
    pub normal: f64,
    pub tangential: f64,
}

/// The paper's step [NMM08, equations 3 to 5]: every control point moves by the mean of the error vectors around it, weighted by the
/// barycentric weights of their footpoints.
pub(super) fn displace(samples: &[Sample], mesh: &Connectivity, control_points: &mut [DVec3]) {
    let mut sums = vec![(DVec3::ZERO, 0.0); control_points.len()];
    for sample in samples {
        let SurfaceParameter { face, u, v } = sample.at;
        let corners = mesh.face(face as usize);
        for (&corner, weight) in corners.iter().zip([1.0 - u - v, u, v]) {
            let (sum, total) = &mut sums[corner as usize];
            *sum += weight * (sample.goal - sample.position);
            *total += weight;
        }
    }
    for (p, (sum, total)) in control_points.iter_mut().zip(sums) {
        if total > 0.0 {
            *p += sum / total;
        }
    }
}

/// What a sample asks for in the least squares.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pull {
    pub weight: f64,
    /// Where its footpoint is to go.
    pub goal: DVec3,
}

/// Linear least squares on the same footpoints; made once for a control mesh.
pub(super) struct Equations {
    pattern: Pattern,
    laplacian: Csr,
    /// `[faces]`: the vertices whose rows of the regularizer it adds.
    owned: Vec<Vec<u32>>,
}

impl Equations {
    /// Analyses a surface.
    pub fn new(surface: &LimitSurface) -> Self {
        let mesh = surface.connectivity();
        let laplacian = border_laplacian(mesh);
        let mut owned = vec![Vec::new(); mesh.face_count()];
        for v in 0..mesh.vertex_count() as u32 {
            if let Some(h) = mesh.around(v).next() {
                owned[mesh.face_of(h) as usize].push(v);
            }
        }
        let mut row = Vec::new();
        let supports = (0..mesh.face_count())
            .map(|f| {
                let mut support: Vec<u32> = Vec::new();
                // The interior of each quarter sees all the control points that the quarter does.
                for (u, v) in [(0.2, 0.2), (0.6, 0.2), (0.2, 0.6), (0.3, 0.3)] {
                    let face = f as u32;
                    surface.weights(SurfaceParameter { face, u, v }, &mut row);
                    support.extend(row.iter().map(|e| e.0));
                }
                for &v in &owned[f] {
                    support.extend(laplacian.row(v as usize).map(|e| e.0));
                }
                support.sort_unstable();
                support.dedup();
                support
            })
            .collect();
        Self {
            pattern: Pattern::new(supports, mesh.vertex_count()),
            laplacian,
            owned,
        }
    }

    /// Moves the control points of `control` to the minimum. `pulls`: `[samples]`.
    pub fn solve(
        &self,
        samples: &[Sample],
        pulls: &[Pull],
        smoothness: Smoothness,
        control: &mut PolygonMesh,
    ) {
        let (starts, order) = by_face(samples, self.owned.len());
        let normals = vertex_normals(control);
        let share = 1.0 / pulls.iter().map(|p| p.weight).sum::<f64>();
        let smooth_share = 1.0 / normals.len() as f64;
        let system = self.pattern.assemble(|face| -> Share {
            let support = self.pattern.support(face);
            let n = support.len();
            let mut blocks = vec![DMat3::ZERO; n * n];
            let mut right = vec![DVec3::ZERO; n];
            let mut add = |row: &[(usize, f64)], metric: DMat3, goal: DVec3| {
                for (k, &(i, a)) in row.iter().enumerate() {
                    let scaled = metric * a;
                    right[i] += scaled * goal;
                    for &(j, b) in &row[k..] {
                        blocks[i * n + j] += scaled * b;
                    }
                }
            };
            let mut local = Vec::with_capacity(n);
            for &k in &order[starts[face] as usize..starts[face + 1] as usize] {
                let sample = &samples[k as usize];
                into_local(support, sample.row.iter().copied(), &mut local);
                let metric = match sample.on_boundary {
                    true => split(sample.direction, SLIDING, 1.0),
                    false => split(sample.direction, 1.0, SLIDING),
                };
                let pull = &pulls[k as usize];
                add(&local, metric * (share * pull.weight), pull.goal);
            }
            for &v in &self.owned[face] {
                into_local(support, self.laplacian.row(v as usize), &mut local);
                let metric = split(
                    normals[v as usize],
                    smoothness.normal,
                    smoothness.tangential,
                );
                add(&local, metric * smooth_share, DVec3::ZERO);
            }
            (blocks, right)
        });
        system.conjugate_gradients(&mut control.positions, TOLERANCE);
    }
}

/// A row's entries by their places in a support; both ascending.
fn into_local(
    support: &[u32],
    row: impl Iterator<Item = (u32, f64)>,
    local: &mut Vec<(usize, f64)>,
) {
    local.clear();
    let mut place = 0;
    for (control, weight) in row {
        while support[place] != control {
            place += 1;
        }
        local.push((place, weight));
    }
}

/// The samples sorted by the faces of their footpoints, in their own order within one: where each face begins, and the samples.
fn by_face(samples: &[Sample], faces: usize) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; faces + 1];
    for sample in samples {
        starts[sample.at.face as usize + 1] += 1;
    }
    for k in 0..faces {
        starts[k + 1] += starts[k];
    }
    let mut next = starts.clone();
    let mut order = vec![0; samples.len()];
    for (k, sample) in samples.iter().enumerate() {
        let slot = &mut next[sample.at.face as usize];
        order[*slot as usize] = k as u32;
        *slot += 1;
    }
    (starts, order)
}

/// The random-walk Laplacian, on the boundary that of the boundary alone.
fn border_laplacian(mesh: &Connectivity) -> Csr {
    let inner = laplacian(mesh);
    Csr::build(inner.row_count(), inner.column_count, |v, row| {
        let v = v as u32;
        if !mesh.is_boundary_vertex(v) {
            return row.extend(inner.row(v as usize));
        }
        row.push((v, 1.0));
        let boundary = mesh.spokes(v).filter(|&(e, _)| mesh.is_boundary_edge(e));
        row.extend(boundary.map(|(_, w)| (w, -0.5)));
    })
}

/// Area-weighted unit normals at the control points.
fn vertex_normals(mesh: &PolygonMesh) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; mesh.positions.len()];
    for face in mesh.faces() {
        let [a, b, c] = [0, 1, 2].map(|k| mesh.positions[face[k] as usize]);
        let area_vector = (b - a).cross(c - a);
        for &v in face {
            normals[v as usize] += area_vector;
        }
    }
    normals.iter().map(|n| n.normalize_or_zero()).collect()
}
