//! Eigenvalues and eigenvectors of symmetric 3 × 3 matrices.

use glam::{DMat3, DVec3};

/// Sweeps of three rotations; convergence is quadratic, and four to six reach the last bit.
const MAX_SWEEPS: usize = 20;

/// The eigenvalues in ascending order, and a rotation whose columns are their unit eigenvectors (Jacobi's method: accurate also where
/// eigenvalues coincide). Only the upper triangle is used up to symmetry; entries must be finite.
pub fn symmetric(matrix: DMat3) -> (DVec3, DMat3) {
    let mut a = matrix.to_cols_array_2d();
    let mut vectors = [DVec3::X, DVec3::Y, DVec3::Z];
    for _ in 0..MAX_SWEEPS {
        if a[0][1] == 0.0 && a[0][2] == 0.0 && a[1][2] == 0.0 {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotate(&mut a, &mut vectors, p, q);
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    let [x, y, z] = order.map(|k| vectors[k]);
    let handed = if x.cross(y).dot(z) < 0.0 { -z } else { z };
    (
        DVec3::from(order.map(|k| a[k][k])),
        DMat3::from_cols(x, y, handed),
    )
}

/// The rotation in the plane of axes p and q that makes `a[p][q]` zero, applied to `a` from both sides and to the vectors.
fn rotate(a: &mut [[f64; 3]; 3], vectors: &mut [DVec3; 3], p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    let ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
    let cosine = 1.0 / tangent.hypot(1.0);
    let sine = tangent * cosine;
    let change = tangent * a[p][q];
    a[p][p] -= change;
    a[q][q] += change;
    (a[p][q], a[q][p]) = (0.0, 0.0);
    let r = 3 - p - q;
    let (rp, rq) = (a[r][p], a[r][q]);
    a[r][p] = cosine * rp - sine * rq;
    a[r][q] = sine * rp + cosine * rq;
    (a[p][r], a[q][r]) = (a[r][p], a[r][q]);
    let (vp, vq) = (vectors[p], vectors[q]);
    vectors[p] = cosine * vp - sine * vq;
    vectors[q] = sine * vp + cosine * vq;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    #[test]
    fn eigenvectors_rebuild_the_matrix() {
        let mut random = Random::new(7);
        let mut matrices = vec![
            DMat3::ZERO,
            DMat3::IDENTITY * 3.0,
            DMat3::from_diagonal(DVec3::new(2.0, -1.0, 2.0)),
        ];
        for scale in [1e-12, 1.0, 1e12] {
            let m = DMat3::from_cols_array(&[0.0; 9].map(|_| random.between(-scale, scale)));
            matrices.extend([m + m.transpose(), m * m.transpose() / scale]);
        }
        for m in matrices {
            let (values, vectors) = symmetric(m);
            let rebuilt = vectors * DMat3::from_diagonal(values) * vectors.transpose();
            let scale = values.abs().max_element();
            assert!(
                (rebuilt - m)
                    .to_cols_array()
                    .iter()
                    .all(|e| e.abs() <= 1e-14 * scale)
            );
            assert!((vectors.determinant() - 1.0).abs() < 1e-14);
            assert!(values.x <= values.y && values.y <= values.z);
        }
    }
}
