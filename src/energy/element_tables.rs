//! Tables of the element energy's kernel from the elements of the model.

use crate::error::Result;
use crate::kernel::element_energy::{Collapsed, ElementTables, Factors, Samples};
use crate::mesh::CellShape;
use crate::model::element::quadrature::collapsed_axes;
use crate::model::element::{Basis, CollapsedBasis, Grid, Quadrature, Rule, Table};

/// What the element energy needs to know of the elements of a shape, a basis and an order, integrated by a rule.
///
/// # Errors
/// Never in practice: the tables of the model fit together.
pub fn element_tables(
    shape: CellShape,
    basis: Basis,
    order: usize,
    rule: Rule,
) -> Result<ElementTables> {
    let quadrature = Quadrature::new(rule, shape, order);
    let checks = quadrature.checks.as_ref().map(|grid| {
        let weights = vec![0.0; grid.len()];
        ElementTables::new(factors(basis, order, grid), weights, None)
    });
    let factors = if (shape, basis, rule) == (CellShape::Tetrahedron, Basis::Legendre, Rule::Gauss)
    {
        let axes = collapsed_axes(order).map(|axis| axis.into_iter().map(|(x, _)| x).collect());
        collapsed(order, axes)
    } else {
        factors(basis, order, &quadrature.grid)
    };
    ElementTables::new(factors, quadrature.weights, checks.transpose()?)
}

/// The modes at the points of a grid; on a hexahedron those of its first axis serve all three.
fn factors(basis: Basis, order: usize, grid: &Grid) -> Factors {
    let samples = |factor| samples(Table::new(basis, order, factor));
    match grid.factors.as_slice() {
        [line, _, _] => Factors::Hexahedron(samples(line)),
        [triangle, line] => Factors::Prism(samples(triangle), samples(line)),
        whole => Factors::Dense(samples(&whole[0])),
    }
}

/// The modes of Legendre tetrahedra through a basis that factors, at points of the collapsed axes (s, t, r).
pub(super) fn collapsed(order: usize, axes: [Vec<f64>; 3]) -> Factors {
    let basis = CollapsedBasis::new(order, axes.each_ref().map(Vec::as_slice));
    Factors::Collapsed(Collapsed {
        axes,
        first: samples(basis.first),
        second: basis.second.into_iter().map(samples).collect(),
        third: basis.third.into_iter().map(samples).collect(),
        matrix: basis.matrix,
    })
}

pub(super) fn samples(table: Table) -> Samples {
    Samples {
        modes: table.modes,
        values: table.values,
        derivatives: table.derivatives,
    }
}
