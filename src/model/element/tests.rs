use super::dual::Dual;
use super::kernels::axis as axis_modes;
use super::quadrature::{collapse, collapsed_axes, gauss_jacobi, gauss_lobatto};
use super::*;
use crate::geometry::random::Random;
use std::f64::consts::PI;

const SHAPES: [CellShape; 3] = [
    CellShape::Tetrahedron,
    CellShape::Prism,
    CellShape::Hexahedron,
];
const BASES: [Basis; 2] = [Basis::Legendre, Basis::Fourier];

/// A random point inside the reference cell.
fn random_point(random: &mut Random, shape: CellShape) -> DVec3 {
    let [s, t, r] = [0, 1, 2].map(|_| random.uniform());
    match shape {
        CellShape::Hexahedron => DVec3::new(s, t, r),
        CellShape::Prism => {
            let [u, v, _] = collapse(s, t, 0.0);
            DVec3::new(u, v, r)
        }
        CellShape::Tetrahedron => DVec3::from_array(collapse(s, t, r)),
    }
}

fn modes_at(basis: Basis, shape: CellShape, order: usize, u: DVec3) -> Vec<f64> {
    Tables::new(basis, order, &Grid::point(shape, u)).row(0)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[test]
fn counts_are_those_of_the_polynomial_spaces() {
    for order in 1..=MAX_ORDER {
        for shape in SHAPES {
            for basis in BASES {
                let u = random_point(&mut Random::new(1), shape);
                let row = modes_at(basis, shape, order, u);
                assert_eq!(row.len(), mode_count(shape, order));
            }
        }
        assert_eq!(modes::quad(order).len(), modes::quad_count(order));
        assert_eq!(modes::triangle(order).len(), modes::triangle_count(order));
        let interior = |shape| modes::interior_count(shape, order);
        assert_eq!(
            modes::hexahedron(order).len(),
            interior(CellShape::Hexahedron)
        );
        assert_eq!(modes::prism(order).len(), interior(CellShape::Prism));
        assert_eq!(
            modes::tetrahedron(order).len(),
            interior(CellShape::Tetrahedron)
        );
    }
}

#[test]
fn a_higher_order_appends_modes() {
    for order in 1..MAX_ORDER {
        assert!(modes::quad(order + 1).starts_with(&modes::quad(order)));
        assert!(modes::triangle(order + 1).starts_with(&modes::triangle(order)));
        assert!(modes::hexahedron(order + 1).starts_with(&modes::hexahedron(order)));
        assert!(modes::prism(order + 1).starts_with(&modes::prism(order)));
        assert!(modes::tetrahedron(order + 1).starts_with(&modes::tetrahedron(order)));
    }
}

#[test]
fn kernels_are_orthonormal_in_their_derivatives_and_vanish_at_the_ends() {
    let rule = gauss_jacobi(50, 0);
    for basis in BASES {
        let slopes: Vec<Vec<f64>> = rule
            .iter()
            .map(|&(x, _)| axis_modes(basis, 16, x)[2..].iter().map(|m| m[1]).collect())
            .collect();
        for i in 0..15 {
            for j in 0..15 {
                let product: f64 = rule
                    .iter()
                    .zip(&slopes)
                    .map(|(p, d)| p.1 * d[i] * d[j])
                    .sum();
                assert!(
                    (product - f64::from(i == j)).abs() < 1e-12,
                    "{basis:?} {i} {j}"
                );
            }
        }
        for end in [0.0, 1.0] {
            assert!(axis_modes(basis, 16, end)[2..].iter().all(|m| m[0] == 0.0));
        }
        let (x, reversed) = (axis_modes(basis, 16, 0.3), axis_modes(basis, 16, 0.7));
        for m in 2..=16 {
            let sign = kernels::parity(m - 1);
            assert!((x[m][0] - sign * reversed[m][0]).abs() < 1e-14);
        }
    }
}

#[test]
fn kappa_is_phi_without_its_zeros() {
    for basis in BASES {
        for x in [0.003, 0.2, 0.5, 0.71, 0.999] {
            let phi = axis_modes(basis, 16, x);
            let kappa = kernels::kappa::<0>(basis, 15, Dual::constant(2.0 * x - 1.0));
            for (p, k) in phi[2..].iter().zip(kappa) {
                assert!(
                    (p[0] - x * (1.0 - x) * k.value).abs() < 1e-14,
                    "{basis:?} {x}"
                );
            }
        }
    }
}

#[test]
fn gradients_are_the_differences_of_values() {
    let mut random = Random::new(2);
    let step = 1e-5;
    for shape in SHAPES {
        for basis in BASES {
            for order in [1, 2, 5, 16] {
                let u = random_point(&mut random, shape);
                let tables = Tables::new(basis, order, &Grid::point(shape, u));
                let coefficients: Vec<DVec3> = (0..mode_count(shape, order))
                    .map(|_| DVec3::from_array([0, 1, 2].map(|_| random.between(-1.0, 1.0))))
                    .collect();
                let at = |u| {
                    Tables::new(basis, order, &Grid::point(shape, u)).positions(&coefficients)[0]
                };
                let gradient = tables.gradients(&coefficients)[0];
                let scale: f64 = coefficients.len() as f64;
                for (axis, column) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().zip([
                    gradient.x_axis,
                    gradient.y_axis,
                    gradient.z_axis,
                ]) {
                    // Fourth-order differences; h⁴ times a fifth derivative of (16π)⁵ is the worst of it.
                    let d = |k: f64| at(u + k * step * axis) - at(u - k * step * axis);
                    let slope = (8.0 * d(1.0) - d(2.0)) / (12.0 * step);
                    let error = (slope - column).length();
                    assert!(
                        error < 1e-9 * scale,
                        "{shape:?} {basis:?} {order}: {error:e}"
                    );
                }
            }
        }
    }
}

/// Every monomial of degree `order` or less (in each of the parts that the shape has), at a point.
fn polynomials(shape: CellShape, order: usize, u: DVec3) -> Vec<f64> {
    let mut list = Vec::new();
    // Legendre polynomials of the coordinates, so that high orders are not a matter of rounding.
    let p = u
        .to_array()
        .map(|x| kernels::jacobi::<0>(0, 0, order + 1, Dual::constant(2.0 * x - 1.0), Dual::ONE));
    for i in 0..=order {
        for j in 0..=order {
            for k in 0..=order {
                let inside = match shape {
                    CellShape::Hexahedron => true,
                    CellShape::Prism => i + j <= order,
                    CellShape::Tetrahedron => i + j + k <= order,
                };
                if inside {
                    list.push(p[0][i].value * p[1][j].value * p[2][k].value);
                }
            }
        }
    }
    list
}

#[test]
fn legendre_modes_span_the_polynomials_of_their_order() {
    let mut random = Random::new(3);
    for shape in SHAPES {
        for order in [1, 2, 3, 4, 6] {
            let count = mode_count(shape, order);
            let samples: Vec<DVec3> = (0..3 * count)
                .map(|_| random_point(&mut random, shape))
                .collect();
            let rows = |f: &dyn Fn(DVec3) -> Vec<f64>| -> faer::Mat<f64> {
                let rows: Vec<_> = samples.iter().map(|&u| f(u)).collect();
                faer::Mat::from_fn(rows.len(), count, |r, c| rows[r][c])
            };
            let modes = rows(&|u| modes_at(Basis::Legendre, shape, order, u));
            let wanted = rows(&|u| polynomials(shape, order, u));
            use faer::linalg::solvers::SolveLstsq;
            let solution = modes.qr().solve_lstsq(&wanted);
            let error = (&modes * &solution - &wanted).norm_max() / wanted.norm_max();
            assert!(error < 1e-12, "{shape:?} {order}: {error:e}");
        }
    }
}

/// The Gram matrix of the modes inside a triangle (the tetrahedron's face) or a tetrahedron.
fn assert_orthogonal(basis: Basis, factor: &Factor, weights: &[f64], order: usize, count: usize) {
    let table = Table::new(basis, order, factor);
    let first = table.modes - count;
    for a in first..table.modes {
        for b in first..=a {
            let product: f64 = weights
                .iter()
                .zip(table.values.chunks_exact(table.modes))
                .map(|(w, row)| w * row[a] * row[b])
                .sum();
            let square = |m: usize| -> f64 {
                let rows = table.values.chunks_exact(table.modes);
                weights
                    .iter()
                    .zip(rows)
                    .map(|(w, row)| w * row[m] * row[m])
                    .sum()
            };
            if a == b {
                let degree = (1.0 / product.sqrt()).round();
                assert!(
                    (product.sqrt() * degree - 1.0).abs() < 1e-10,
                    "{basis:?} norm of {a}"
                );
                assert!(degree >= 3.0 && degree <= order as f64);
            } else {
                let bound = 1e-10 * (square(a) * square(b)).sqrt();
                assert!(product.abs() < bound, "{basis:?} {a} {b}: {product:e}");
            }
        }
    }
}

#[test]
fn modes_inside_simplices_are_orthogonal_with_norm_one_over_degree() {
    for basis in BASES {
        // A rule for order 24 is exact for degree 51; the sines of order 6 need most of it.
        let rule = Quadrature::new(Rule::Gauss, CellShape::Prism, 24);
        let points = rule.grid.factors[0].len();
        let heights = rule.grid.factors[1].len();
        let weights: Vec<f64> = (0..points)
            .map(|k| (0..heights).map(|h| rule.weights[h * points + k]).sum())
            .collect();
        let count = modes::triangle_count(6);
        assert_orthogonal(basis, &rule.grid.factors[0], &weights, 6, count);

        let rule = Quadrature::new(Rule::Gauss, CellShape::Tetrahedron, 24);
        let count = modes::tetrahedron(6).len();
        assert_orthogonal(basis, &rule.grid.factors[0], &rule.weights, 6, count);
    }
}

#[test]
fn fourier_modes_of_triangles_are_the_determinants_of_their_definition() {
    let order = 9;
    let mut random = Random::new(4);
    for _ in 0..20 {
        let [b, c] = {
            let u = random_point(&mut random, CellShape::Prism);
            [u.x, u.y]
        };
        let row = Table::new(Basis::Fourier, order, &Factor::Triangle(vec![[b, c]])).values;
        let y = [(2.0 * b + c) / 3.0, (c - b) / 3.0, -(b + 2.0 * c) / 3.0];
        let inside = &row[row.len() - modes::triangle_count(order)..];
        for ([i, j], value) in modes::triangle(order).into_iter().zip(inside) {
            let (m, n) = (i.min(j), i.max(j));
            let [re, im] = determinant(&[m + n, n, 0], &y);
            let norm = if i == j { 3f64 } else { 1.5 }.sqrt();
            let expected = if i <= j { im } else { re } / (norm * (i + j + 1) as f64);
            assert!(
                (value - expected).abs() < 1e-12,
                "{i} {j}: {value} {expected}"
            );
        }
    }
}

#[test]
fn fourier_modes_of_tetrahedra_are_the_determinants_of_their_definition() {
    let order = 9;
    let mut random = Random::new(5);
    for _ in 0..20 {
        let u = random_point(&mut random, CellShape::Tetrahedron);
        let [b, c, d] = u.to_array();
        let row = Table::new(Basis::Fourier, order, &Factor::Tetrahedron(vec![[b, c, d]])).values;
        let y3 = -(b + 2.0 * c + 3.0 * d) / 4.0;
        let y = [y3 + d + c + b, y3 + d + c, y3 + d, y3];
        let all = modes::tetrahedron(order);
        for ([i, j, k], value) in all.iter().zip(&row[row.len() - all.len()..]) {
            let (l, m, n) = (i.min(k), j, i.max(k));
            let [re, im] = determinant(&[l + m + n, m + n, *n, 0], &y);
            let norm = if i == k { 4f64 } else { 2.0 }.sqrt();
            let expected = if i <= k { re } else { im } / (norm * (i + j + k + 1) as f64);
            assert!(
                (value - expected).abs() < 1e-12,
                "{i} {j} {k}: {value} {expected}"
            );
        }
    }
}

/// det\[exp(2πi ν_k y_l)\] by permutations: real and imaginary part.
fn determinant(frequencies: &[usize], y: &[f64]) -> [f64; 2] {
    fn expand(frequencies: &[usize], y: &[f64], angle: f64, sign: f64) -> [f64; 2] {
        let Some((&first, rest)) = frequencies.split_first() else {
            return [sign * angle.cos(), sign * angle.sin()];
        };
        let mut sum = [0.0; 2];
        for k in 0..y.len() {
            let mut others = y.to_vec();
            let taken = others.remove(k);
            let sign = if k % 2 == 0 { sign } else { -sign };
            let term = expand(rest, &others, angle + 2.0 * PI * first as f64 * taken, sign);
            sum = [sum[0] + term[0], sum[1] + term[1]];
        }
        sum
    }
    expand(frequencies, y, 0.0, 1.0)
}

#[test]
fn one_dimensional_rules_are_exact_to_their_degree() {
    for n in 2..=19 {
        for (rule, alpha, degree) in [
            (gauss_lobatto(n), 0, 2 * n - 3),
            (gauss_jacobi(n, 0), 0, 2 * n - 1),
            (gauss_jacobi(n, 1), 1, 2 * n - 1),
            (gauss_jacobi(n, 2), 2, 2 * n - 1),
        ] {
            assert_eq!(rule.len(), n);
            assert!(rule.is_sorted_by(|a, b| a.0 < b.0));
            for power in 0..=degree as u64 {
                // ∫ x^k (1−x)^α dx = α! k! / (k + α + 1)!
                let exact = (1..=alpha).map(|a| a as f64).product::<f64>()
                    / (1..=alpha + 1).map(|a| (power + a) as f64).product::<f64>();
                let sum: f64 = rule.iter().map(|(x, w)| w * x.powi(power as i32)).sum();
                assert!((sum - exact).abs() < 1e-14, "{n} {alpha} {power}");
            }
        }
    }
}

/// ∫ u^a v^b w^c over the reference cell.
fn monomial_integral(shape: CellShape, [a, b, c]: [u32; 3]) -> f64 {
    let factorial = |n: u32| (1..=n).map(f64::from).product::<f64>();
    let triangle = factorial(a) * factorial(b) / factorial(a + b + 2);
    match shape {
        CellShape::Hexahedron => 1.0 / f64::from((a + 1) * (b + 1) * (c + 1)),
        CellShape::Prism => triangle / f64::from(c + 1),
        CellShape::Tetrahedron => {
            factorial(a) * factorial(b) * factorial(c) / factorial(a + b + c + 3)
        }
    }
}

#[test]
fn element_rules_are_exact_to_twice_the_order() {
    for shape in SHAPES {
        for order in [1, 2, 4, 8] {
            let rule = Quadrature::new(Rule::Gauss, shape, order);
            let points = rule.grid.points();
            for powers in [
                [0, 0, 0],
                [1, 0, 0],
                [0, 1, 1],
                [order, 0, order],
                [0, 2 * order, 0],
            ] {
                let powers = powers.map(|k| k as u32);
                let sum: f64 = points
                    .iter()
                    .zip(&rule.weights)
                    .map(|(u, w)| {
                        let [a, b, c] = powers.map(|k| k as i32);
                        w * u.x.powi(a) * u.y.powi(b) * u.z.powi(c)
                    })
                    .sum();
                let exact = monomial_integral(shape, powers);
                assert!((sum - exact).abs() < 1e-14, "{shape:?} {order} {powers:?}");
            }
        }
    }
}

#[test]
fn the_trapezoid_is_exact_for_linear_functions_and_of_second_order() {
    for shape in SHAPES {
        let error = |order: usize, [a, b, c]: [u32; 3]| {
            let rule = Quadrature::new(Rule::Trapezoid, shape, order);
            assert_eq!(rule.grid.len(), rule.weights.len());
            assert!(rule.checks.is_none());
            let powers = [a, b, c].map(|k| k as i32);
            let sum: f64 = rule
                .grid
                .points()
                .iter()
                .zip(&rule.weights)
                .map(|(u, w)| w * u.x.powi(powers[0]) * u.y.powi(powers[1]) * u.z.powi(powers[2]))
                .sum();
            (sum - monomial_integral(shape, [a, b, c])).abs()
        };
        for order in [1, 2, 3] {
            assert!(error(order, [1, 0, 0]) < 1e-14 && error(order, [0, 0, 1]) < 1e-14);
        }
        // 4 and 8 intervals along an edge.
        let ratio = error(3, [2, 0, 0]) / error(5, [2, 0, 0]);
        assert!((3.5..4.5).contains(&ratio), "{shape:?}: {ratio}");
    }
}

#[test]
fn check_points_lie_on_the_boundary_with_all_vertices() {
    for shape in [CellShape::Prism, CellShape::Tetrahedron] {
        let checks = Quadrature::new(Rule::Gauss, shape, 3).checks.unwrap();
        let points = checks.points();
        for corner in corners(shape) {
            assert!(points.iter().any(|u| u.distance(*corner) < 1e-15));
        }
        for u in points {
            let sum = if shape == CellShape::Prism {
                u.x + u.y
            } else {
                u.element_sum()
            };
            let least = if shape == CellShape::Prism {
                u.x.min(u.y)
            } else {
                u.min_element()
            };
            assert!(least == 0.0 || (sum - 1.0).abs() < 1e-15);
        }
    }
}

#[test]
fn the_collapsed_basis_gives_the_values_and_gradients_of_the_modes() {
    for order in [1, 2, 5, 9] {
        let rule = collapsed_axes(order);
        let axes = rule
            .each_ref()
            .map(|axis| Vec::from_iter(axis.iter().map(|p| p.0)));
        let collapsed = CollapsedBasis::new(order, axes.each_ref().map(Vec::as_slice));
        let quadrature = Quadrature::new(Rule::Gauss, CellShape::Tetrahedron, order);
        let dense = Table::new(Basis::Legendre, order, &quadrature.grid.factors[0]);
        let mode = dense.modes - 1;
        let column: Vec<f64> = collapsed.matrix[mode..]
            .iter()
            .step_by(dense.modes)
            .copied()
            .collect();
        let n = order + 2;
        for point in [0, n * n * n / 2, n * n * n - 1] {
            let (a, b, c) = (point % n, point / n % n, point / (n * n));
            let (s, t, r) = (axes[0][a], axes[1][b], axes[2][c]);
            // Value, ∂s, ∂t, ∂r of every ψ.
            let mut psi: [Vec<f64>; 4] = Default::default();
            for i in 0..=order {
                for j in 0..=order - i {
                    for k in 0..=order - i - j {
                        let pick = |table: &Table, x: usize, m: usize| {
                            let at = x * table.modes + m;
                            [table.values[at], table.derivatives[0][at]]
                        };
                        let f = pick(&collapsed.first, a, i);
                        let g = pick(&collapsed.second[i], b, j);
                        let h = pick(&collapsed.third[i + j], c, k);
                        psi[0].push(f[0] * g[0] * h[0]);
                        psi[1].push(f[1] * g[0] * h[0]);
                        psi[2].push(f[0] * g[1] * h[0]);
                        psi[3].push(f[0] * g[0] * h[1]);
                    }
                }
            }
            let [value, ds, dt, dr] = psi.map(|row| dot(&row, &column));
            let du = ds / ((1.0 - r) * (1.0 - t));
            let dv = dt / (1.0 - r) + s * du;
            let dw = dr + t * dv + (1.0 - t) * s * du;
            let at = point * dense.modes + mode;
            assert!((value - dense.values[at]).abs() < 1e-12, "{order}");
            for (d, exact) in [du, dv, dw].into_iter().zip(&dense.derivatives) {
                assert!((d - exact[at]).abs() < 1e-10, "{order}: {d} {}", exact[at]);
            }
        }
    }
}

#[test]
fn permuting_the_corners_of_a_triangle_rotates_its_modes() {
    for (basis, order) in [(Basis::Legendre, 16), (Basis::Fourier, 11)] {
        let count = modes::triangle_count(order);
        for permutation in [
            [0, 1, 2],
            [0, 2, 1],
            [1, 0, 2],
            [1, 2, 0],
            [2, 0, 1],
            [2, 1, 0],
        ] {
            let r = triangle_permutation(basis, order, permutation);
            for (k, row) in r.chunks_exact(count).enumerate() {
                for (l, other) in r.chunks_exact(count).enumerate() {
                    let error = dot(row, other) - f64::from(k == l);
                    assert!(
                        error.abs() < 1e-12,
                        "{basis:?} {permutation:?} {k} {l}: {error:e}"
                    );
                }
            }
            let l = [0.2, 0.31, 0.49];
            let at = |l: [f64; 3]| {
                let mut row =
                    Table::new(basis, order, &Factor::Triangle(vec![[l[1], l[2]]])).values;
                row.split_off(triangle_mode_count(order) - count)
            };
            let (modes, permuted) = (at(l), at(permutation.map(|k| l[k])));
            for (row, value) in r.chunks_exact(count).zip(permuted) {
                assert!(
                    (dot(row, &modes) - value).abs() < 1e-12,
                    "{basis:?} {permutation:?}"
                );
            }
        }
    }
}

#[test]
fn reference_shapes_are_regular() {
    for shape in SHAPES {
        let a = reference_matrix(shape);
        for &[i, j] in shape.edges() {
            let length = (a * (corners(shape)[j] - corners(shape)[i])).length();
            assert!((length - 1.0).abs() < 1e-15, "{shape:?} {i} {j}");
        }
        let cell = monomial_integral(shape, [0, 0, 0]);
        assert!((a.determinant() * cell - reference_volume(shape)).abs() < 1e-15);
    }
}
