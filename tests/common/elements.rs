//! Curved elements for tests: ideal ones, and random ones that are valid.

#![allow(dead_code, reason = "each test binary uses a part")]

use super::Noise;
use glam::{DMat3, DVec3};
use std::sync::Arc;
use vorofit::energy::element_tables;
use vorofit::geometry::distortion::Distortion;
use vorofit::kernel::element_energy::{self, ElementBatch, ElementInput, ElementTables};
use vorofit::mesh::CellShape;
use vorofit::model::element::{
    Basis, Rule, corners, mode_count, reference_matrix, reference_volume, triangle_mode_count,
};

pub const SHAPES: [CellShape; 3] = [
    CellShape::Hexahedron,
    CellShape::Prism,
    CellShape::Tetrahedron,
];
pub const BASES: [Basis; 2] = [Basis::Legendre, Basis::Fourier];

/// Where the mode of a corner is among an element's modes.
pub fn corner_mode(shape: CellShape, order: usize, corner: usize) -> usize {
    let u = corners(shape)[corner];
    let n = order + 1;
    match shape {
        CellShape::Hexahedron => u.x as usize + n * (u.y as usize + n * u.z as usize),
        CellShape::Prism => corner % 3 + triangle_mode_count(order) * (corner / 3),
        CellShape::Tetrahedron => corner,
    }
}

/// The coefficients of an affine image of the ideal shape.
pub fn affine(shape: CellShape, order: usize, map: impl Fn(DVec3) -> DVec3) -> Vec<DVec3> {
    let mut coefficients = vec![DVec3::ZERO; mode_count(shape, order)];
    for (k, &u) in corners(shape).iter().enumerate() {
        coefficients[corner_mode(shape, order, k)] = map(reference_matrix(shape) * u);
    }
    coefficients
}

/// The volume of the reference cell, what the weights of a rule sum to.
pub fn cell_volume(shape: CellShape) -> f64 {
    reference_volume(shape) / reference_matrix(shape).determinant()
}

/// `count` elements of unit size that share the tables, each a share of the volume, not yet with coefficients.
pub fn batch(tables: ElementTables, shape: CellShape, count: usize) -> ElementBatch {
    ElementBatch {
        tables: Arc::new(tables),
        inverse_references: vec![reference_matrix(shape).inverse(); count],
        weights: vec![cell_volume(shape).recip() / count as f64; count],
    }
}

/// Random valid elements: affine maps near rotations, and every mode disturbed.
pub fn random(
    noise: &mut Noise,
    shape: CellShape,
    basis: Basis,
    order: usize,
    count: usize,
    distortion: Distortion,
) -> ElementInput {
    let tables = element_tables(shape, basis, order, Rule::Gauss).unwrap();
    let batches = vec![batch(tables, shape, count)];
    let modes = mode_count(shape, order);
    let mut coefficients = Vec::new();
    let mut disturbances = Vec::new();
    for _ in 0..count {
        let turn = DMat3::from_axis_angle(noise.vector().normalize(), 6.0 * noise.next());
        let shear = DMat3::from_cols(noise.vector(), noise.vector(), noise.vector());
        let (map, centre) = ((DMat3::IDENTITY + 0.3 * shear) * turn, noise.vector());
        coefficients.extend(affine(shape, order, |x| map * x + centre));
        disturbances.extend((0..modes).map(|_| noise.vector()));
    }
    // Halved until all are valid: what is left is near the limit for some.
    let mut size = 1.0 / order as f64;
    loop {
        let disturbed: Vec<DVec3> = coefficients
            .iter()
            .zip(&disturbances)
            .map(|(&c, &d)| c + size * d)
            .collect();
        let output = element_energy::cpu(&batches, &disturbed, distortion);
        if output.smallest_determinant() > 0.05 {
            return ElementInput {
                batches,
                coefficients: disturbed,
                distortion,
            };
        }
        size *= 0.5;
    }
}
