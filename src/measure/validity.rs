//! Certificates that det J is positive everywhere in an element, not just at samples.
//!
//! **Theory.** The determinant of a Legendre element is a polynomial: of degree 3p − 1 in each coordinate of a hexahedron and along a prism,
//! 3p − 2 over the triangle of a prism, 3p − 3 on a tetrahedron; in collapsed coordinates all of them are polynomials on a cube.
//! Its values at Chebyshev nodes give its Chebyshev series. The part of degree 5 or less is bounded by its Bernstein coefficients, the
//! rest by the sum of its coefficients; a box where that does not decide is halved. On Fourier elements gradients and determinant are
//! interpolated, with a bound on what that misses.
//!
//! **In practice** a hexahedron of order 2 takes one box, of order 4 up to a dozen. Elements that are degenerate somewhere, with det J = 0 to
//! rounding, stay undecided.

use super::chebyshev::{Series, Tools, along_all, nodes, resample};
use super::scaled_jacobian::map_cells;
use super::truncation::Envelope;
use crate::mesh::CellShape;
use crate::model::element::quadrature::collapse;
use crate::model::element::{Basis, Factor, Grid, Tables, corner_modes, mode_count};
use crate::model::volume::CurvedVolume;
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// What is known about the sign of det J in an element.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Validity {
    /// det J > 0 everywhere.
    Valid,
    /// det J ≤ 0 somewhere.
    Invalid,
    /// Neither could be shown with the boxes allowed: det J comes within rounding of 0, or the element turns too fast.
    Undecided,
}

/// Boxes after which an element is left undecided. Elements of real fits take some tens.
const MAX_BOXES: usize = 2000;

/// The share of det J by which interpolation may miss the determinant of a Fourier element.
const TRUNCATION: f64 = 1e-6;

/// Chebyshev nodes an axis beyond which a Fourier element is left undecided.
const MAX_NODES: usize = 128;

/// Entries of a table beyond which a Fourier tetrahedron is left undecided: 128 MB with the derivatives.
const MAX_TABLE: usize = 1 << 22;

/// Relative rounding of a determinant from its gradients, an axis' node: ample for sums of some thousand terms.
const ROUNDING: f64 = 1e-14;

/// The validity of every cell.
pub fn validities(volume: &CurvedVolume) -> Vec<Validity> {
    let mut validities = vec![Validity::Undecided; volume.cell_count()];
    for group in volume.groups() {
        let (shape, order) = (group.shape, group.order);
        let corners = corner_modes(shape, order);
        let centred = |local: &[DVec3]| {
            let mut local = local.to_vec();
            let centre = corners.iter().map(|&k| local[k]).sum::<DVec3>() / corners.len() as f64;
            corners.iter().for_each(|&k| local[k] -= centre);
            local
        };
        let sign = |c: usize| volume.reference_inverse(c).determinant();
        let wanted = match volume.basis() {
            Basis::Legendre => {
                let sides = legendre_sides(shape, order);
                let wanted = group
                    .cells
                    .iter()
                    .map(|&c| (c as usize, Some((sides, 0.0))));
                wanted.collect()
            }
            Basis::Fourier => {
                let fourier = FourierSides::new(shape, order);
                map_cells(volume, &group.cells, |_, local| fourier.of(&centred(local)))
            }
        };
        let mut alike: BTreeMap<Sides, BTreeMap<usize, f64>> = BTreeMap::new();
        for (c, wanted) in wanted {
            if let Some((sides, missed)) = wanted {
                alike.entry(sides).or_default().insert(c, missed);
            }
        }
        for (sides, missed) in alike {
            let sampler = Sampler::new(volume.basis(), shape, order, sides);
            let cells: Vec<u32> = missed.keys().map(|&c| c as u32).collect();
            let found = map_cells(volume, &cells, |c, local| {
                sampler.decide(&centred(local), sign(c), missed[&c])
            });
            for (c, validity) in found {
                validities[c] = validity;
            }
        }
    }
    validities
}

/// Nodes an axis of the cube: for the gradients, and for the determinant.
type Sides = [[usize; 3]; 2];

fn legendre_sides(shape: CellShape, p: usize) -> Sides {
    match shape {
        CellShape::Hexahedron => [[p + 1; 3], [3 * p; 3]],
        CellShape::Prism => [[p + 1; 3], [3 * p - 1, 3 * p - 1, 3 * p]],
        CellShape::Tetrahedron => [[p; 3], [3 * p - 2; 3]],
    }
}

/// Gradients at the Chebyshev nodes of the cube that an element is collapsed from, and from there the series of the determinant.
struct Sampler {
    sides: Sides,
    tables: Tables,
    resample: [Vec<f64>; 3],
    tools: Tools,
}

impl Sampler {
    fn new(basis: Basis, shape: CellShape, order: usize, sides: Sides) -> Self {
        let [from, to] = sides;
        Self {
            sides,
            tables: Tables::new(basis, order, &collapsed_grid(shape, from)),
            resample: [0, 1, 2].map(|k| resample(from[k], to[k])),
            tools: Tools::new(to.into_iter().fold(1, usize::max)),
        }
    }

    /// The validity of an element, from its local modes, the sign (and size) that its frame gives to det ∇h, and a bound on what
    /// interpolation misses of det ∇h.
    fn decide(&self, local: &[DVec3], sign: f64, missed: f64) -> Validity {
        let [from, to] = self.sides;
        let matrices = self.resample.each_ref().map(Vec::as_slice);
        let gradients = along_all(matrices, from, &self.tables.gradients(local));
        let values: Vec<f64> = gradients.iter().map(|j| sign * j.determinant()).collect();
        let lengths = |j: &DMat3| j.x_axis.length() * j.y_axis.length() * j.z_axis.length();
        let largest = gradients.iter().map(lengths).fold(0.0, f64::max);
        let nodes: usize = to.iter().sum();
        let error = sign.abs() * (missed + ROUNDING * nodes as f64 * largest);
        if !error.is_finite() {
            return Validity::Undecided;
        }
        decide(Series::from_values(to, &values, error), &self.tools)
    }
}

/// Chebyshev nodes of the cube, taken to the reference cell.
fn collapsed_grid(shape: CellShape, sides: [usize; 3]) -> Grid {
    let [x, y, z] = sides.map(nodes);
    let factors = match shape {
        CellShape::Hexahedron => [x, y, z].map(Factor::Line).to_vec(),
        CellShape::Prism => {
            let points = y.iter().flat_map(|&t| {
                x.iter().map(move |&s| {
                    let [u, v, _] = collapse(s, t, 0.0);
                    [u, v]
                })
            });
            vec![Factor::Triangle(points.collect()), Factor::Line(z)]
        }
        CellShape::Tetrahedron => {
            let (x, y) = (&x, &y);
            let points = z.iter().flat_map(|&r| {
                y.iter()
                    .flat_map(move |&t| x.iter().map(move |&s| collapse(s, t, r)))
            });
            vec![Factor::Tetrahedron(points.collect())]
        }
    };
    Grid { factors }
}

/// Halves boxes until each is positive, one has a value of 0 or less, or there are too many.
fn decide(series: Series, tools: &Tools) -> Validity {
    let mut boxes = vec![series];
    for _ in 0..MAX_BOXES {
        let Some(mut series) = boxes.pop() else {
            return Validity::Valid;
        };
        series.trim();
        if series.lower_bound(tools) > 0.0 {
            continue;
        }
        if series.is_negative_somewhere() {
            return Validity::Invalid;
        }
        boxes.extend(series.halves(tools));
    }
    if boxes.is_empty() {
        Validity::Valid
    } else {
        Validity::Undecided
    }
}

/// How many nodes Fourier elements of a shape and an order take.
struct FourierSides {
    shape: CellShape,
    order: usize,
    /// Where the size of det ∇h is estimated.
    tables: Tables,
    envelope: Envelope,
}

impl FourierSides {
    fn new(shape: CellShape, order: usize) -> Self {
        Self {
            shape,
            order,
            tables: Tables::new(Basis::Fourier, order, &Grid::lattice(shape, order + 1)),
            envelope: Envelope::new(shape, order),
        }
    }

    /// As many as the coefficients ask for, and a bound on what they miss of det ∇h; `None` where that is too many.
    fn of(&self, local: &[DVec3]) -> Option<(Sides, f64)> {
        let gradients = self.tables.gradients(local);
        let sum: f64 = gradients.iter().map(|j| j.determinant().abs()).sum();
        let allowed = TRUNCATION * sum / gradients.len() as f64;
        let analytic = self.envelope.of(local);
        let count = |error: &dyn Fn(usize) -> f64| {
            (8..=MAX_NODES).step_by(8).find(|&n| error(n) <= allowed)
        };
        let to = count(&|n| analytic.determinant_error(n))?;
        let from = count(&|n| analytic.sampling_error(n, to))?;
        let is_large = self.shape == CellShape::Tetrahedron
            && from.pow(3) * mode_count(self.shape, self.order) > MAX_TABLE;
        let missed = analytic.determinant_error(to) + analytic.sampling_error(from, to);
        (!is_large).then_some(([[from; 3], [to; 3]], missed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::measure::scaled_jacobian::qualities;
    use crate::mesh::VolumeMesh;
    use crate::model::element::{corners, reference_matrix};

    const SHAPES: [CellShape; 3] = [
        CellShape::Tetrahedron,
        CellShape::Prism,
        CellShape::Hexahedron,
    ];

    /// A cell in its ideal shape, its vertices numbered by `labels`.
    fn ideal(shape: CellShape, basis: Basis, order: usize, labels: &[u32]) -> CurvedVolume {
        let mut positions = vec![DVec3::ZERO; labels.len()];
        for (&label, &u) in labels.iter().zip(corners(shape)) {
            positions[label as usize] = reference_matrix(shape) * u;
        }
        let mut mesh = VolumeMesh::new(positions);
        mesh.push_cell(shape, labels);
        CurvedVolume::new(&mesh, basis)
            .unwrap()
            .raised(&[order])
            .unwrap()
    }

    fn plain(shape: CellShape, basis: Basis, order: usize) -> CurvedVolume {
        let labels: Vec<u32> = (0..shape.vertex_count() as u32).collect();
        ideal(shape, basis, order, &labels)
    }

    /// The least det J of cell 0 on a lattice of `n` intervals.
    fn sampled_minimum(volume: &CurvedVolume, n: usize) -> f64 {
        let grid = Grid::lattice(volume.shape(0), n);
        let tables = Tables::new(volume.basis(), volume.kernel_order(0), &grid);
        let local = volume.gather(&[0]).apply(&volume.coefficients);
        let inverse = volume.reference_inverse(0);
        let gradients = tables.gradients(&local);
        gradients
            .iter()
            .map(|g| (*g * inverse).determinant())
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn ideal_and_mirrored_cells_are_told_apart_at_every_order() {
        for shape in SHAPES {
            for (basis, orders) in [
                (Basis::Legendre, vec![1, 2, 4, 8]),
                (Basis::Fourier, vec![1, 2, 4]),
            ] {
                for order in orders {
                    let mut volume = plain(shape, basis, order);
                    assert_eq!(
                        validities(&volume),
                        [Validity::Valid],
                        "{shape:?} {basis:?} {order}"
                    );
                    let quality = qualities(&volume)[0];
                    let off = (quality.min - 1.0).abs().max((quality.mean - 1.0).abs());
                    assert!(off < 1e-12, "{shape:?} {basis:?} {order}: {off:e}");
                    volume.coefficients.iter_mut().for_each(|c| c.x = -c.x);
                    assert_eq!(validities(&volume), [Validity::Invalid]);
                    assert!((qualities(&volume)[0].min + 1.0).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn every_labelling_of_an_ideal_simplex_is_valid() {
        for labels in [[3, 1, 0, 2], [0, 2, 1, 3], [2, 3, 0, 1]] {
            let volume = ideal(CellShape::Tetrahedron, Basis::Legendre, 3, &labels);
            assert_eq!(validities(&volume), [Validity::Valid]);
        }
        for labels in [[3, 1, 0, 2, 5, 4], [0, 5, 1, 3, 2, 4]] {
            let volume = ideal(CellShape::Prism, Basis::Legendre, 3, &labels);
            assert_eq!(validities(&volume), [Validity::Valid]);
        }
    }

    #[test]
    fn flat_and_collapsed_cells_are_not_valid() {
        for shape in SHAPES {
            let mut volume = plain(shape, Basis::Legendre, 3);
            volume.coefficients.iter_mut().for_each(|c| c.z = 0.0);
            assert_ne!(validities(&volume), [Validity::Valid], "{shape:?}");
            assert!(qualities(&volume)[0].min.abs() < 1e-12);
            volume.coefficients.fill(DVec3::ZERO);
            assert_eq!(validities(&volume), [Validity::Invalid]);
            assert_eq!(qualities(&volume)[0].min, 0.0);
        }
    }

    /// Gives a cube the map x ↦ x + Σ c(j) φ_j(x), of determinant 1 + Σ c(j) φ_j'(x).
    fn stretch(volume: &mut CurvedVolume, c: impl Fn(usize) -> f64) {
        let shape = CellShape::Hexahedron;
        for (e, &[a, b]) in shape.edges().iter().enumerate() {
            if corners(shape)[b] - corners(shape)[a] == DVec3::X {
                for (global, j) in volume.edge_coefficients(0, e).zip(1..) {
                    let sign = if a > b && j % 2 == 0 { -1.0 } else { 1.0 };
                    volume.coefficients[global as usize] = sign * c(j) * DVec3::X;
                }
            }
        }
    }

    #[test]
    fn a_dip_between_the_samples_is_found() {
        // By φ_j' = −√(2j+1) P_j the determinant is 1 − depth K(x), K the reproducing kernel about 0.53: 1 there, and narrow.
        let order = 16;
        let centre = 2.0 * 0.53 - 1.0;
        let mut p = vec![1.0, centre];
        for n in 2..order {
            let k = n as f64;
            p.push(((2.0 * k - 1.0) * centre * p[n - 1] - (k - 1.0) * p[n - 2]) / k);
        }
        let total: f64 = (1..order).map(|j| (2 * j + 1) as f64 * p[j] * p[j]).sum();
        for (depth, expected) in [(0.99, Validity::Valid), (1.001, Validity::Invalid)] {
            let mut volume = plain(CellShape::Hexahedron, Basis::Legendre, order);
            stretch(&mut volume, |j| {
                depth * ((2 * j + 1) as f64).sqrt() * p[j] / total
            });
            assert_eq!(validities(&volume), [expected]);
            // A lattice that steps over the dip.
            assert!(sampled_minimum(&volume, 8) > 0.05);
        }
    }

    #[test]
    fn certificates_agree_with_dense_samples_on_random_elements() {
        let mut random = Random::new(11);
        let mut counts = [0; 2];
        for shape in SHAPES {
            for (basis, orders) in [(Basis::Legendre, 1..=8), (Basis::Fourier, 1..=4)] {
                for order in orders {
                    for size in [0.02, 0.1, 0.2, 0.4] {
                        let mut volume = plain(shape, basis, order);
                        let share = size / order as f64;
                        for c in &mut volume.coefficients {
                            *c += share * DVec3::from_array([0, 1, 2].map(|_| random.normal()));
                        }
                        let n = if basis == Basis::Legendre {
                            3 * order + 6
                        } else {
                            12
                        };
                        let sampled = sampled_minimum(&volume, n);
                        match validities(&volume)[0] {
                            Validity::Valid => {
                                counts[0] += 1;
                                assert!(sampled > 0.0, "{shape:?} {basis:?} {order}: {sampled}");
                            }
                            Validity::Invalid => {
                                counts[1] += 1;
                                let dense = sampled_minimum(&volume, 24);
                                assert!(sampled.min(dense) < 0.02, "{shape:?} {basis:?} {order}");
                            }
                            Validity::Undecided => {
                                panic!("{shape:?} {basis:?} {order} {size}: {sampled}")
                            }
                        }
                    }
                }
            }
        }
        assert!(counts.iter().all(|&c| c > 20), "{counts:?}");
    }

    #[test]
    fn an_element_that_touches_zero_is_left_undecided() {
        // x' = 1 + 2 P_2(2x − 1) = 3 (2x − 1)².
        let mut volume = plain(CellShape::Hexahedron, Basis::Legendre, 3);
        stretch(
            &mut volume,
            |j| if j == 2 { -2.0 / 5f64.sqrt() } else { 0.0 },
        );
        assert!(sampled_minimum(&volume, 2).abs() < 1e-15);
        assert_eq!(validities(&volume), [Validity::Undecided]);
    }

    #[test]
    fn the_answer_does_not_depend_on_place_size_or_threads() {
        let mut random = Random::new(12);
        for shape in SHAPES {
            let mut volume = plain(shape, Basis::Legendre, 4);
            for c in &mut volume.coefficients {
                *c += 0.03 * DVec3::from_array([0, 1, 2].map(|_| random.normal()));
            }
            let here = validities(&volume);
            for (scale, offset) in [(1e-3, 0.0), (1e3, 0.0), (1.0, 1e4)] {
                let mut moved = volume.clone();
                moved.coefficients.iter_mut().for_each(|c| *c *= scale);
                for c in &mut moved.coefficients[..shape.vertex_count()] {
                    *c += DVec3::splat(offset);
                }
                assert_eq!(validities(&moved), here);
            }
            let with = |threads| {
                let pool = rayon::ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .build()
                    .unwrap();
                pool.install(|| (validities(&volume), qualities(&volume)))
            };
            assert_eq!(with(1), with(3));
        }
    }
}
