//! The regularized barrier: the distortion of the corners of all cells, finite where they are inverted and driven to where they are not.

use super::corners::edges;
use super::ideal::Ideals;
use crate::geometry::distortion::cofactors;
use crate::mesh::VolumeMesh;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// The weight of the volume against the shape of a cell.
const VOLUME: f64 = 0.1;

/// Corners or vertices that one task takes.
const PER_TASK: usize = 1024;

/// e(J) = \[‖J‖²/(3 χ^⅔) + θ (1 + det²)/(2χ)\]/(1 + θ), χ = (det + √(det² + ε²))/2, and a power of it: 1 where J is a rotation. With ε = 0 it is infinite where
/// det J ≤ 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Density {
    /// ε.
    pub epsilon: f64,
    /// The power: the higher it is, the more the worst corners count.
    pub power: i32,
}

/// A density at one matrix.
struct Pointwise {
    /// e^q − 1.
    value: f64,
    /// By J.
    gradient: DMat3,
    /// Of the second derivative: the multiple of the identity, that of the square of the determinant's gradient …
    isotropic: f64,
    of_determinant: f64,
    /// … and that of the square of the gradient itself.
    of_gradient: f64,
    /// ∂det J/∂J.
    cofactors: DMat3,
}

impl Density {
    /// Infinite where it is not defined.
    fn evaluate(self, j: DMat3) -> Option<Pointwise> {
        let det = j.determinant();
        let root = (det * det + self.epsilon * self.epsilon).sqrt();
        // Where det < 0 the sum would cancel.
        let chi = if det > 0.0 {
            0.5 * (det + root)
        } else {
            0.5 * self.epsilon * self.epsilon / (root - det)
        };
        if !(chi > 0.0 && chi.is_finite()) {
            return None;
        }
        let slope = chi / root;
        let cofactors = DMat3::from_cols_array_2d(&cofactors(j.to_cols_array_2d()));
        let norm = j.to_cols_array().iter().map(|x| x * x).sum::<f64>();
        let scale = 1.0 / (1.0 + VOLUME);
        let shape = norm / (3.0 * chi.cbrt().powi(2));
        let volume = 0.5 * VOLUME * (1.0 + det * det) / chi;
        let e = scale * (shape + volume);
        let outer = f64::from(self.power) * e.powi(self.power - 1);
        let by_norm = 2.0 / (3.0 * chi.cbrt().powi(2));
        let by_det = (-2.0 / 3.0 * shape - volume) * slope / chi + VOLUME * det / chi;
        let steepness = (10.0 / 9.0 * shape + 2.0 * volume) * (slope / chi).powi(2) + VOLUME / chi;
        Some(Pointwise {
            value: e.powi(self.power) - 1.0,
            gradient: (by_norm * j + by_det * cofactors) * (scale * outer),
            isotropic: scale * outer * by_norm,
            of_determinant: scale * outer * steepness,
            of_gradient: f64::from(self.power - 1) / (outer * e),
            cofactors,
        })
    }
}

/// One corner of a cell.
#[derive(Debug, Clone, Copy)]
struct Corner {
    /// Its vertex and the three that it has edges to.
    vertices: [u32; 4],
    /// A⁻¹.
    inverse: DMat3,
    /// Its share of the cell.
    weight: f64,
}

/// The corners of all cells. A cell counts 1, however many corners it has.
pub(super) struct Corners {
    corners: Vec<Corner>,
    /// `[vertices + 1]` and `[4 · corners]`: which places of which corners are a vertex's, as 4 · corner + place.
    offsets: Vec<u32>,
    places: Vec<u32>,
}

impl Corners {
    pub fn new(mesh: &VolumeMesh, ideals: &Ideals) -> Self {
        let mut corners = Vec::with_capacity(ideals.matrices.len());
        for (shape, cell) in mesh.cells() {
            let weight = 1.0 / shape.spokes().len() as f64;
            for spokes in shape.spokes() {
                corners.push(Corner {
                    vertices: spokes.map(|k| cell[k]),
                    inverse: ideals.matrices[corners.len()].inverse(),
                    weight,
                });
            }
        }
        let mut offsets = vec![0u32; mesh.positions.len() + 1];
        let vertices = || corners.iter().flat_map(|c| c.vertices);
        for v in vertices() {
            offsets[v as usize + 1] += 1;
        }
        for v in 0..mesh.positions.len() {
            offsets[v + 1] += offsets[v];
        }
        let mut next = offsets.clone();
        let mut places = vec![0; 4 * corners.len()];
        for (place, v) in vertices().enumerate() {
            let slot = &mut next[v as usize];
            places[*slot as usize] = place as u32;
            *slot += 1;
        }
        Self {
            corners,
            offsets,
            places,
        }
    }

    /// Takes the lengths that edges have now for ideal, so that only angles count. Edges that are not to be at right angles keep their proportions: triangles
    /// of other lengths have other angles.
    pub fn keep_lengths(&mut self, x: &[DVec3]) {
        for corner in &mut self.corners {
            let ideal = corner.inverse.inverse();
            let now = edges(corner.vertices.map(|v| x[v as usize]));
            let growth = |k: usize| now.col(k).length() / ideal.col(k).length();
            let scaled = |k: usize| {
                let cosine = |l: &usize| ideal.col(k).normalize().dot(ideal.col(*l).normalize());
                let oblique = (0..3).filter(|l| cosine(l).abs() > 1e-3);
                let (product, count) = oblique.fold((1.0, 0), |(product, count), l| {
                    (product * growth(l), count + 1)
                });
                ideal.col(k) * f64::powf(product, 1.0 / f64::from(count))
            };
            corner.inverse = DMat3::from_cols(scaled(0), scaled(1), scaled(2)).inverse();
        }
    }

    /// The least determinant of all corners, relative to their ideals.
    pub fn least_determinant(&self, x: &[DVec3]) -> f64 {
        let least = |corners: &[Corner]| {
            let determinants = corners.iter().map(|c| c.jacobian(x).determinant());
            determinants.fold(f64::INFINITY, f64::min)
        };
        self.corners
            .par_chunks(PER_TASK)
            .map(least)
            .reduce(|| f64::INFINITY, f64::min)
    }

    /// The largest slope of a power of e, in units of that of e itself where nothing is distorted.
    pub fn steepest(&self, x: &[DVec3], density: Density) -> f64 {
        let power = f64::from(density.power);
        let slope = |corner: &Corner| match density.evaluate(corner.jacobian(x)) {
            Some(at) => power * (1.0 + at.value).powf(1.0 - 1.0 / power),
            None => 1.0,
        };
        let of_part = |corners: &[Corner]| corners.iter().map(slope).fold(1.0, f64::max);
        self.corners
            .par_chunks(PER_TASK)
            .map(of_part)
            .reduce(|| 1.0, f64::max)
    }

    /// The sum over all cells, and its gradient. `[vertices]`.
    pub fn evaluate(&self, x: &[DVec3], density: Density) -> (f64, Vec<DVec3>) {
        let parts: Option<Vec<(f64, Vec<[DVec3; 4]>)>> = self
            .corners
            .par_chunks(PER_TASK)
            .map(|corners| {
                let mut sum = 0.0;
                let mut gradients = Vec::with_capacity(corners.len());
                for corner in corners {
                    let at = density.evaluate(corner.jacobian(x))?;
                    sum += corner.weight * at.value;
                    gradients.push(corner.gradients(at.gradient));
                }
                Some((sum, gradients))
            })
            .collect();
        let Some(parts) = parts else {
            return (f64::INFINITY, vec![DVec3::ZERO; x.len()]);
        };
        let value = parts.iter().map(|part| part.0).sum();
        (
            value,
            self.gather(DVec3::ZERO, |corner, place| {
                parts[corner / PER_TASK].1[corner % PER_TASK][place]
            }),
        )
    }

    /// The blocks of about the second derivative that belong to one vertex each. `[vertices]`.
    pub fn curvatures(&self, x: &[DVec3], density: Density) -> Vec<DMat3> {
        let parts: Vec<[DMat3; 4]> = self
            .corners
            .par_iter()
            .with_min_len(PER_TASK)
            .map(|corner| corner.curvatures(x, density))
            .collect();
        self.gather(DMat3::ZERO, |corner, place| parts[corner][place])
    }

    /// Adds up for each vertex what its corners say, always in the same order.
    fn gather<T: Copy + Send + Sync + std::ops::Add<Output = T>>(
        &self,
        zero: T,
        part: impl Fn(usize, usize) -> T + Sync,
    ) -> Vec<T> {
        (0..self.offsets.len() - 1)
            .into_par_iter()
            .with_min_len(PER_TASK)
            .map(|v| {
                let [start, end] = [v, v + 1].map(|v| self.offsets[v] as usize);
                let places = self.places[start..end].iter().map(|&p| p as usize);
                places.fold(zero, |sum, p| sum + part(p / 4, p % 4))
            })
            .collect()
    }
}

impl Corner {
    fn jacobian(&self, x: &[DVec3]) -> DMat3 {
        edges(self.vertices.map(|v| x[v as usize])) * self.inverse
    }

    /// From the derivative by J to those by the four vertices.
    fn gradients(&self, by_jacobian: DMat3) -> [DVec3; 4] {
        let by_edges = self.weight * by_jacobian * self.inverse.transpose();
        let [a, b, c] = [by_edges.x_axis, by_edges.y_axis, by_edges.z_axis];
        [-(a + b + c), a, b, c]
    }

    fn curvatures(&self, x: &[DVec3], density: Density) -> [DMat3; 4] {
        let Some(at) = density.evaluate(self.jacobian(x)) else {
            return [DMat3::ZERO; 4];
        };
        let rows = self.inverse.transpose();
        let [a, b, c] = [rows.x_axis, rows.y_axis, rows.z_axis];
        [-(a + b + c), a, b, c].map(|g| {
            let square = |n: DVec3| DMat3::from_cols(n * n.x, n * n.y, n * n.z);
            let isotropic = DMat3::from_diagonal(DVec3::splat(at.isotropic * g.length_squared()));
            let of_determinant = square(at.cofactors * g) * at.of_determinant;
            let of_gradient = square(at.gradient * g) * at.of_gradient;
            (isotropic + of_determinant + of_gradient) * self.weight
        })
    }
}
