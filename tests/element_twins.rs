//! The two implementations of the element energy agree at every order, shape and basis; planted faults make them disagree; the GPU gives the
//! same bits twice.

mod common;

use common::elements::{BASES, SHAPES, affine, batch, random};
use common::{Noise, agree, repeats, sees};
use glam::{DMat3, DVec3};
use vorofit::device::Shader;
use vorofit::energy::element_tables;
use vorofit::geometry::distortion::Distortion;
use vorofit::kernel::element_energy::{
    BASIS, COLLAPSED, Collapsed, DENSE, ElementEnergyTwins, ElementInput, ElementTables, Factors,
    HEXAHEDRON, PRISM, Samples,
};
use vorofit::mesh::CellShape;
use vorofit::model::element::quadrature::collapsed_axes;
use vorofit::model::element::{Basis, CollapsedBasis, Quadrature, Rule, Table, mode_count};

fn strain(shape: CellShape, basis: Basis, order: usize, count: usize) -> ElementInput {
    let noise = &mut Noise(100 * order as u64 + count as u64);
    random(noise, shape, basis, order, count, Distortion::Strain)
}

fn at_every_order(shape: CellShape) {
    for basis in BASES {
        for order in 1..=16 {
            let count = if order < 4 { 11 } else { 2 };
            let name = format!("{} of order {order}, {basis:?}", shape.name());
            agree::<ElementEnergyTwins>(&[(&name, strain(shape, basis, order, count))]);
        }
    }
}

#[test]
fn hexahedra_agree_at_every_order() {
    at_every_order(CellShape::Hexahedron);
}

#[test]
fn prisms_agree_at_every_order() {
    at_every_order(CellShape::Prism);
}

#[test]
fn tetrahedra_agree_at_every_order() {
    at_every_order(CellShape::Tetrahedron);
}

#[test]
fn every_density_agrees() {
    for distortion in Distortion::ALL {
        let input = random(
            &mut Noise(7),
            CellShape::Prism,
            Basis::Legendre,
            3,
            5,
            distortion,
        );
        agree::<ElementEnergyTwins>(&[(distortion.name(), input)]);
    }
}

/// The same elements, larger or smaller and somewhere else.
fn moved(input: &ElementInput, scale: f64, offset: DVec3) -> ElementInput {
    let mut input = input.clone();
    let mut first = 0;
    for batch in &mut input.batches {
        let shape = SHAPES
            .into_iter()
            .find(|&s| {
                [2, 3]
                    .iter()
                    .any(|&p| mode_count(s, p) == batch.tables.modes())
            })
            .unwrap();
        let order = [2, 3]
            .into_iter()
            .find(|&p| mode_count(shape, p) == batch.tables.modes());
        // Only corners move; the rest are displacements.
        let corners = affine(shape, order.unwrap(), |_| DVec3::ONE);
        let modes = first..first + batch.coefficients();
        first = modes.end;
        for (c, corner) in input.coefficients[modes]
            .iter_mut()
            .zip(corners.iter().cycle())
        {
            *c = scale * *c + offset * *corner;
        }
        batch
            .inverse_references
            .iter_mut()
            .for_each(|a| *a *= 1.0 / scale);
    }
    input
}

fn mixed() -> ElementInput {
    let parts = SHAPES.map(|shape| strain(shape, Basis::Legendre, 3, 7));
    ElementInput {
        batches: parts.iter().flat_map(|p| p.batches.clone()).collect(),
        coefficients: parts.iter().flat_map(|p| p.coefficients.clone()).collect(),
        distortion: Distortion::Strain,
    }
}

#[test]
fn adversarial_elements_agree() {
    let nothing = ElementInput {
        batches: Vec::new(),
        coefficients: Vec::new(),
        distortion: Distortion::Strain,
    };
    let ordinary = mixed();
    let mut inverted = ordinary.clone();
    let modes = mode_count(SHAPES[0], 3);
    inverted.coefficients[modes..2 * modes]
        .iter_mut()
        .for_each(|c| c.y = -c.y);
    inverted.coefficients[3 * modes..4 * modes].fill(DVec3::ONE);
    inverted.coefficients[5 * modes + 1].z = f64::NAN;
    inverted.coefficients[6 * modes].z = 1e300;
    let mut ideal = ordinary.clone();
    ideal.coefficients = SHAPES
        .iter()
        .flat_map(|&shape| affine(shape, 3, |x| x).repeat(7))
        .collect();
    let mut flat = ordinary.clone();
    let squash = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 1e-2));
    flat.coefficients = SHAPES
        .iter()
        .flat_map(|&shape| affine(shape, 3, |x| squash * x).repeat(7))
        .collect();
    let trapezoid = ElementInput {
        batches: vec![batch(
            element_tables(CellShape::Tetrahedron, Basis::Legendre, 3, Rule::Trapezoid).unwrap(),
            CellShape::Tetrahedron,
            2,
        )],
        ..strain(CellShape::Tetrahedron, Basis::Legendre, 3, 2)
    };
    let offset = DVec3::new(100.0, -200.0, 50.0);
    agree::<ElementEnergyTwins>(&[
        ("nothing", nothing),
        ("inverted, collapsed and not finite", inverted),
        ("ideal", ideal),
        ("nearly flat", flat),
        ("the paper's rule", trapezoid),
        ("small", moved(&ordinary, 1e-3, DVec3::ZERO)),
        ("large", moved(&ordinary, 1e3, DVec3::ZERO)),
        ("far away", moved(&ordinary, 1.0, offset)),
        ("all shapes", ordinary.clone()),
    ]);
    repeats::<ElementEnergyTwins>(&ordinary);
}

/// Legendre tetrahedra without check points, so that no other shader of the name runs.
fn without_checks(order: usize, count: usize) -> ElementInput {
    let samples = |table: Table| Samples {
        modes: table.modes,
        values: table.values,
        derivatives: table.derivatives,
    };
    let rule = Quadrature::new(Rule::Gauss, CellShape::Tetrahedron, order);
    let axes = collapsed_axes(order).map(|axis| axis.into_iter().map(|p| p.0).collect::<Vec<_>>());
    let basis = CollapsedBasis::new(order, axes.each_ref().map(Vec::as_slice));
    let factors = Factors::Collapsed(Collapsed {
        axes,
        first: samples(basis.first),
        second: basis.second.into_iter().map(samples).collect(),
        third: basis.third.into_iter().map(samples).collect(),
        matrix: basis.matrix,
    });
    let tables = ElementTables::new(factors, rule.weights, None).unwrap();
    ElementInput {
        batches: vec![batch(tables, CellShape::Tetrahedron, count)],
        ..strain(CellShape::Tetrahedron, Basis::Legendre, order, count)
    }
}

/// A shader, an input that shows the fault, and what to replace by what.
type Fault<'a> = (&'a Shader, ElementInput, &'a [(&'a str, &'a str)]);

#[test]
fn planted_faults_are_seen() {
    let faults: [Fault; 5] = [
        (
            &HEXAHEDRON,
            strain(CellShape::Hexahedron, Basis::Legendre, 3, 3),
            &[
                ("vec3f(value, slope, value)", "vec3f(value, value, slope)"),
                ("half * half + c * c", "half * half"),
                (
                    "here.gradient) * transpose(inverse)",
                    "here.gradient) * inverse * 1.001",
                ),
                ("min(result.y, det)", "result.y"),
                ("sums += vec2f(slope *", "sums += vec2f(value *"),
            ],
        ),
        (
            &PRISM,
            strain(CellShape::Prism, Basis::Legendre, 3, 3),
            &[
                ("along.y * slope", "along.x * slope"),
                (
                    "sums[2] += tables[t] * slope",
                    "sums[2] += tables[t] * value",
                ),
            ],
        ),
        (
            &DENSE,
            strain(CellShape::Tetrahedron, Basis::Fourier, 3, 3),
            &[("sum += tables[t] * d[0]", "sum += tables[t] * d[1]")],
        ),
        (
            &COLLAPSED,
            without_checks(3, 3),
            &[
                ("metric.w * sums.y", "metric.z * sums.y"),
                ("j * rest", "j * COUNT"),
            ],
        ),
        (
            &BASIS,
            strain(CellShape::Tetrahedron, Basis::Legendre, 3, 3),
            &[("m * params.modes + row", "row * params.modes + m")],
        ),
    ];
    for (shader, input, faults) in faults {
        sees::<ElementEnergyTwins>(shader, &input, faults);
    }
}
