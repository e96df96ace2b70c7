//! The regularizer R(P) = mean_i |(L M P)_i|², L the random-walk Laplacian of the surface's mesh.
//!
//! \[NYL12\] writes Xᵀ L² X with a combinatorial Laplacian; the mean over random-walk rows is the same form without the
//! dependence on the number of vertices and their valence, so one schedule of weights serves every model.

use crate::kernel::sparse::Csr;
use crate::mesh::Connectivity;
use glam::DVec3;

/// The smoothness of a surface as a function of its control points.
#[derive(Debug, Clone)]
pub struct Smoothness {
    /// L M.
    rows: Csr,
    transpose: Csr,
}

impl Smoothness {
    /// For a surface with the connectivity of `surface` and X = `matrix` P.
    pub fn new(surface: &Connectivity, matrix: &Csr) -> Self {
        let rows = laplacian(surface).multiply(matrix);
        Self {
            transpose: rows.transpose(),
            rows,
        }
    }

    /// L M: `[vertices, control points]`.
    pub fn rows(&self) -> &Csr {
        &self.rows
    }

    /// R and its gradient on the control points.
    pub fn evaluate(&self, control_points: &[DVec3]) -> (f64, Vec<DVec3>) {
        let mut differences = self.rows.apply(control_points);
        let scale = 1.0 / differences.len() as f64;
        let value = differences.iter().map(|d| d.length_squared()).sum::<f64>() * scale;
        differences.iter_mut().for_each(|d| *d *= 2.0 * scale);
        (value, self.transpose.apply(&differences))
    }
}

/// (L x)_i = x_i − the mean of the neighbours of i along edges; zero where there are none. On the boundary only neighbours along it count: the
/// inside does not draw it in.
pub fn laplacian(surface: &Connectivity) -> Csr {
    let vertices = surface.vertex_count();
    let mut edges: Vec<[u32; 2]> = (0..surface.edge_count() as u32)
        .flat_map(|e| {
            let [a, b] = surface.ends(e);
            let counts = move |v| surface.is_boundary_edge(e) || !surface.is_boundary_vertex(v);
            let directed = [[a, b], [b, a]];
            directed.into_iter().filter(move |&[v, _]| counts(v))
        })
        .collect();
    edges.sort_unstable();
    let mut rows: Vec<Vec<(u32, f64)>> = vec![Vec::new(); vertices];
    for star in edges.chunk_by(|a, b| a[0] == b[0]) {
        let row = &mut rows[star[0][0] as usize];
        row.push((star[0][0], 1.0));
        row.extend(star.iter().map(|e| (e[1], -1.0 / star.len() as f64)));
    }
    Csr::from_rows(&rows, vertices)
}
