//! Curved elements: the modes of hexahedra, prisms and tetrahedra at orders 1 to 16, where they are sampled, and their tables.
//!
//! **Theory.** \[PPL13\], section 3.2: the map of an element is h(u) = Σ vertex, edge, face and cell modes, hierarchical, so that
//! an order is raised by appending modes. Reference coordinates u are in the unit cube, in {u, v ≥ 0, u + v ≤ 1} × \[0, 1\], or in
//! {u, v, w ≥ 0, u + v + w ≤ 1}; [`reference_matrix`] takes them to the ideal shape.
//!
//! **Local modes** of order p, in this order:
//!
//! | shape | count | index |
//! | --- | --- | --- |
//! | hexahedron | (p+1)³ | m_x + (p+1)(m_y + (p+1) m_z), where m = 0 is 1 − x, m = 1 is x and m ≥ 2 is φ_{m−1}(x) |
//! | prism | (p+1)²(p+2)/2 | t + (p+1)(p+2)/2 · m_w, t a mode of the triangle |
//! | triangle | (p+1)(p+2)/2 | vertices, edges 01, 12, 02 with p − 1 modes each, then [`modes::triangle`] |
//! | tetrahedron | C(p+3, 3) | vertices, [`TETRAHEDRON_EDGES`], [`TETRAHEDRON_FACES`], then [`modes::tetrahedron`] |
//!
//! **Departures from the paper.** It defines modes on hexahedra only; here simplices have modes with the same traces, so that
//! every mix conforms. The integrated Legendre kernels are the default: they converge exponentially on smooth shapes, the
//! paper's integrated Fourier series as a power of the order. J = ∇h A⁻¹, where the paper prints A⁻ᵀ.

mod collapsed;
mod dual;
mod kernels;
pub mod modes;
pub mod quadrature;
mod simplex;
mod tables;
#[cfg(test)]
mod tests;

pub use collapsed::CollapsedBasis;
pub use quadrature::{Quadrature, Rule};
pub use simplex::triangle_permutation;
pub use tables::{Factor, Grid, Table, Tables};

use crate::mesh::CellShape;
use glam::{DMat3, DVec3};

/// The highest order of an element.
pub const MAX_ORDER: usize = 16;

/// The kernels φ_j from which modes are built. Both have ∫ φ_i' φ_j' = δ_ij and φ_j(1 − x) = (−1)^(j+1) φ_j(x).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum Basis {
    /// Integrated Legendre polynomials: the space of an element is that of the polynomials of its order.
    #[default]
    Legendre,
    /// The paper's integrated Fourier series, √2 sin(jπx)/(jπ).
    Fourier,
}

/// The corners of the reference cell, in the local numbering of [`CellShape`].
pub fn corners(shape: CellShape) -> &'static [DVec3] {
    const fn at(x: f64, y: f64, z: f64) -> DVec3 {
        DVec3::new(x, y, z)
    }
    const TETRAHEDRON: [DVec3; 4] = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    const PRISM: [DVec3; 6] = [
        DVec3::ZERO,
        DVec3::X,
        DVec3::Y,
        DVec3::Z,
        at(1.0, 0.0, 1.0),
        at(0.0, 1.0, 1.0),
    ];
    const HEXAHEDRON: [DVec3; 8] = [
        DVec3::ZERO,
        DVec3::X,
        at(1.0, 1.0, 0.0),
        DVec3::Y,
        DVec3::Z,
        at(1.0, 0.0, 1.0),
        DVec3::ONE,
        at(0.0, 1.0, 1.0),
    ];
    match shape {
        CellShape::Tetrahedron => &TETRAHEDRON,
        CellShape::Prism => &PRISM,
        CellShape::Hexahedron => &HEXAHEDRON,
    }
}

/// The matrix A from reference coordinates to the ideal shape: a cube, a prism over an equilateral triangle, or a regular
/// tetrahedron, all with edges of length 1 (\[PPL13\], equation 4).
pub fn reference_matrix(shape: CellShape) -> DMat3 {
    let half_root = 0.5 * 3f64.sqrt();
    let second = DVec3::new(0.5, half_root, 0.0);
    match shape {
        CellShape::Hexahedron => DMat3::IDENTITY,
        CellShape::Prism => DMat3::from_cols(DVec3::X, second, DVec3::Z),
        CellShape::Tetrahedron => {
            let third = DVec3::new(0.5, half_root / 3.0, (2f64 / 3.0).sqrt());
            DMat3::from_cols(DVec3::X, second, third)
        }
    }
}

/// The volume of the ideal shape: 1, √3/4 or √2/12.
pub fn reference_volume(shape: CellShape) -> f64 {
    match shape {
        CellShape::Hexahedron => 1.0,
        CellShape::Prism => 3f64.sqrt() / 4.0,
        CellShape::Tetrahedron => 2f64.sqrt() / 12.0,
    }
}

/// The number of local modes.
pub const fn mode_count(shape: CellShape, order: usize) -> usize {
    match shape {
        CellShape::Hexahedron => (order + 1) * (order + 1) * (order + 1),
        CellShape::Prism => triangle_mode_count(order) * (order + 1),
        CellShape::Tetrahedron => (order + 1) * (order + 2) * (order + 3) / 6,
    }
}

/// The local modes of the corners, in the order of the corners: their values sum to 1, so a translation is a translation of these.
pub fn corner_modes(shape: CellShape, order: usize) -> Vec<usize> {
    let n = order + 1;
    match shape {
        CellShape::Hexahedron => corners(shape)
            .iter()
            .map(|u| u.x as usize + n * (u.y as usize + n * u.z as usize))
            .collect(),
        CellShape::Prism => {
            let top = triangle_mode_count(order);
            vec![0, 1, 2, top, top + 1, top + 2]
        }
        CellShape::Tetrahedron => vec![0, 1, 2, 3],
    }
}

/// The number of modes of a triangle: its vertices, its edges and its interior.
pub const fn triangle_mode_count(order: usize) -> usize {
    (order + 1) * (order + 2) / 2
}

/// Edges of a triangle as pairs of its corners, in the order of its modes.
pub const TRIANGLE_EDGES: [[usize; 2]; 3] = [[0, 1], [1, 2], [0, 2]];

/// Edges of a tetrahedron as ascending pairs of its corners, in the order of its modes.
pub const TETRAHEDRON_EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Faces of a tetrahedron as ascending triples of its corners, in the order of its modes; the face k leaves corner 3 − k out.
pub const TETRAHEDRON_FACES: [[usize; 3]; 4] = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];
