//! The modes inside an edge, a face or a cell, as multi-indices.
//!
//! Every list is hierarchical: the modes of order p are the first ones of the list of order p + 1.

use crate::mesh::CellShape;

/// The number of modes inside an edge.
pub const fn edge_count(order: usize) -> usize {
    order - 1
}

/// The number of modes inside a triangle.
pub const fn triangle_count(order: usize) -> usize {
    (order - 1) * order.saturating_sub(2) / 2
}

/// The number of modes inside a quadrilateral.
pub const fn quad_count(order: usize) -> usize {
    (order - 1) * (order - 1)
}

/// The number of modes inside a cell.
pub const fn interior_count(shape: CellShape, order: usize) -> usize {
    match shape {
        CellShape::Hexahedron => quad_count(order) * (order - 1),
        CellShape::Prism => triangle_count(order) * (order - 1),
        CellShape::Tetrahedron => triangle_count(order) * order.saturating_sub(3) / 3,
    }
}

/// Modes (m_s, m_t), each from 2 to `order`, inside a quadrilateral.
pub fn quad(order: usize) -> Vec<[usize; 2]> {
    hierarchical(
        (2..=order).flat_map(|s| (2..=order).map(move |t| [s, t])),
        |&[s, t]| s.max(t),
    )
}

/// Modes (i, j) ≥ 1 of degree i + j + 1 up to `order` inside a triangle.
pub fn triangle(order: usize) -> Vec<[usize; 2]> {
    hierarchical(
        (1..order).flat_map(|i| (1..order.saturating_sub(i)).map(move |j| [i, j])),
        |&[i, j]| i + j,
    )
}

/// Modes (m_x, m_y, m_z), each from 2 to `order`, inside a hexahedron.
pub fn hexahedron(order: usize) -> Vec<[usize; 3]> {
    hierarchical(
        (2..=order)
            .flat_map(|x| (2..=order).flat_map(move |y| (2..=order).map(move |z| [x, y, z]))),
        |m| m.iter().copied().max().unwrap_or(0),
    )
}

/// Modes (t, m_w) inside a prism: t an index into [`triangle`], m_w from 2 to `order`.
pub fn prism(order: usize) -> Vec<[usize; 2]> {
    let base = triangle(order);
    hierarchical(
        (0..base.len()).flat_map(|t| (2..=order).map(move |m| [t, m])),
        |&[t, m]| m.max(base[t][0] + base[t][1] + 1),
    )
}

/// Modes (i, j, k) ≥ 1 of degree i + j + k + 1 up to `order` inside a tetrahedron.
pub fn tetrahedron(order: usize) -> Vec<[usize; 3]> {
    let rest = move |used: usize| 1..order.saturating_sub(used);
    hierarchical(
        rest(0).flat_map(move |i| rest(i).flat_map(move |j| rest(i + j).map(move |k| [i, j, k]))),
        |m| m.iter().sum(),
    )
}

/// The modes in the order in which raising the order adds them.
fn hierarchical<M: Ord>(modes: impl Iterator<Item = M>, order: impl Fn(&M) -> usize) -> Vec<M> {
    let mut modes: Vec<M> = modes.collect();
    modes.sort_by(|a, b| order(a).cmp(&order(b)).then_with(|| a.cmp(b)));
    modes
}
