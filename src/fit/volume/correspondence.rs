//! The surface energy near the target: squared distances to correspondences that stay as they are for some iterations.
//!
//! E_S = (1/(A L²)) (Σ over quadrature points of S, by their area, + Σ over samples of T, by theirs) of the squared distance along its
//! own direction: the normal-only limit of \[PPL13\], equation 9. A point of S goes to its closest point on T, a sample of T to the
//! closest point on S. The points of S are fixed combinations of the nodes, so this is a quadratic function of them.
//!
//! **Departure from the paper**, which integrates over Voronoi cells to the end. A cell's integral measures the distance to a sample of
//! the other side; its minimum is off by the square of the spacing of the samples, which is above the error of an order-4 surface.

use crate::kernel::sparse::Csr;
use glam::{DMat3, DVec3};

/// A point of S and where it should go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Goal {
    /// The place on the target, or where a sample of it is.
    pub position: DVec3,
    /// The unit direction in which the distance counts.
    pub direction: DVec3,
    /// The area that it stands for.
    pub weight: f64,
}

/// Frozen correspondences.
#[derive(Debug, Clone)]
pub(super) struct Correspondences {
    /// `[points of S, nodes]`.
    rows: Csr,
    transpose: Csr,
    /// `[points of S]`: first those of samples of S, then those of samples of T.
    goals: Vec<Goal>,
    /// How many are of samples of S.
    of_surface: usize,
    /// 1/(A L²).
    scale: f64,
}

impl Correspondences {
    /// Takes the points of S as combinations of the nodes, and their goals: first `of_surface` for samples of S, then those
    /// for samples of T.
    pub fn new(rows: Csr, goals: Vec<Goal>, of_surface: usize, scale: f64) -> Self {
        Self {
            transpose: rows.transpose(),
            rows,
            goals,
            of_surface,
            scale,
        }
    }

    /// F_T→S/(A L²), F_S→T/(A L²), and the gradient of their sum on the nodes.
    pub fn evaluate(&self, nodes: &[DVec3]) -> ([f64; 2], Vec<DVec3>) {
        let distances = self.distances(nodes);
        let pairs = || distances.iter().zip(&self.goals);
        let sum = |part: &mut dyn Iterator<Item = (&f64, &Goal)>| {
            self.scale * part.map(|(d, g)| g.weight * d * d).sum::<f64>()
        };
        let of_surface = sum(&mut pairs().take(self.of_surface));
        let of_target = sum(&mut pairs().skip(self.of_surface));
        let forces: Vec<DVec3> = pairs()
            .map(|(d, g)| 2.0 * self.scale * g.weight * *d * g.direction)
            .collect();
        ([of_target, of_surface], self.transpose.apply(&forces))
    }

    /// The root mean square distance over both surfaces.
    pub fn rms(&self, nodes: &[DVec3]) -> f64 {
        let (parts, _) = self.evaluate(nodes);
        let area: f64 = self.goals.iter().map(|g| g.weight).sum();
        ((parts[0] + parts[1]) / (self.scale * area)).sqrt()
    }

    /// The goals of samples of S, and those of samples of T.
    pub fn goals_by_side(&self) -> (&[Goal], &[Goal]) {
        self.goals.split_at(self.of_surface)
    }

    /// The signed distance of each point of S from its goal. `[points of S]`.
    pub fn distances(&self, nodes: &[DVec3]) -> Vec<f64> {
        let points = self.rows.apply(nodes);
        let distance = |(x, g): (&DVec3, &Goal)| g.direction.dot(*x - g.position);
        points.iter().zip(&self.goals).map(distance).collect()
    }

    /// The second derivatives by each node alone. `[nodes]`.
    pub fn diagonal(&self) -> Vec<DMat3> {
        (0..self.transpose.row_count())
            .map(|node| {
                let entries = self.transpose.row(node);
                entries.fold(DMat3::ZERO, |sum, (k, b)| sum + self.curvature(k) * (b * b))
            })
            .collect()
    }

    /// The second derivatives by pairs of nodes, `(first, second, block)` with first ≥ second, each pair once for every run of
    /// points with the same nodes.
    pub fn blocks(&self) -> Vec<(u32, u32, DMat3)> {
        let mut blocks = Vec::new();
        let columns = |k: usize| {
            let range = self.rows.offsets[k] as usize..self.rows.offsets[k + 1] as usize;
            (&self.rows.columns[range.clone()], &self.rows.values[range])
        };
        let mut begin = 0;
        while begin < self.goals.len() {
            let (nodes, _) = columns(begin);
            let run = (begin..self.goals.len()).take_while(|&k| columns(k).0 == nodes);
            let end = begin + run.count();
            let first = blocks.len();
            for (i, &a) in nodes.iter().enumerate() {
                blocks.extend(nodes[..=i].iter().map(|&b| (a, b, DMat3::ZERO)));
            }
            for k in begin..end {
                let (_, values) = columns(k);
                let curvature = self.curvature(k as u32);
                let mut place = first;
                for (i, &a) in values.iter().enumerate() {
                    let scaled = curvature * a;
                    for &b in &values[..=i] {
                        blocks[place].2 += scaled * b;
                        place += 1;
                    }
                }
            }
            begin = end;
        }
        blocks
    }

    fn curvature(&self, k: u32) -> DMat3 {
        let Goal {
            direction: n,
            weight,
            ..
        } = self.goals[k as usize];
        DMat3::from_cols(n * n.x, n * n.y, n * n.z) * (2.0 * self.scale * weight)
    }
}
