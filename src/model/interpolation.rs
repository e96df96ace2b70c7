//! Control points whose limits are given points: the inverse of the limit masks.
//!
//! The masks are diagonally heavy: on Loop networks the condition number of their matrix M is about 5 whatever the size, so that of MᵀM, which is solved here, is some
//! 25, and no digit that counts is lost. Creases, corners, boundaries and quads have masks too, and need no case of their own.

use super::refinement::Level;
use crate::error::{Error, Result};
use crate::kernel::sparse::Csr;
use crate::mesh::{ControlMesh, Scheme};
use crate::optimize::cholesky::{Cholesky, LowerTriangle};
use glam::DVec3;

/// The control mesh of the same connectivity whose limit surface passes, at each control point, through that of `points`.
///
/// The relative residual is about 1e-14 \[MKJK15, section 6\].
///
/// # Errors
/// As [`super::Model::new`], and where points and weights are such that no limit surface is found (positions that are not finite).
pub fn interpolating(points: &ControlMesh, scheme: Scheme) -> Result<ControlMesh> {
    let limit = Level::of(points, scheme)?.limit();
    let transpose = limit.transpose();
    let normal = lower_triangle(&transpose.multiply(&limit));
    let unsolvable = || {
        Error::input(
            "no limit surface passes through the control points",
            "give another template",
        )
    };
    let factor = Cholesky::new(&normal).ok_or_else(unsolvable)?;
    let solve = |goals: &[DVec3]| -> Vec<DVec3> {
        let right = transpose.apply(goals);
        let mut axes = [0, 1, 2].map(|axis| right.iter().map(|r| r[axis]).collect::<Vec<f64>>());
        axes.iter_mut().for_each(|axis| factor.solve(axis));
        let [x, y, z] = axes;
        (0..x.len()).map(|i| DVec3::new(x[i], y[i], z[i])).collect()
    };
    let mut control = points.clone();
    control.mesh.positions = solve(&points.mesh.positions);
    if control.mesh.positions.iter().all(|p| p.is_finite()) {
        Ok(control)
    } else {
        Err(unsolvable())
    }
}

/// Of a symmetric matrix.
fn lower_triangle(matrix: &Csr) -> LowerTriangle {
    let mut lower = LowerTriangle {
        offsets: vec![0],
        rows: Vec::new(),
        values: Vec::new(),
    };
    for c in 0..matrix.row_count() {
        let below = matrix.row(c).filter(|&(r, _)| r as usize >= c);
        for (r, value) in below {
            lower.rows.push(r);
            lower.values.push(value);
        }
        lower.offsets.push(lower.rows.len() as u32);
    }
    lower
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Crease, PolygonMesh, shapes};
    use crate::model::Model;

    fn residual(points: &ControlMesh, scheme: Scheme) -> f64 {
        let control = interpolating(points, scheme).unwrap();
        let model = Model::new(&control, scheme, 0, true).unwrap();
        let limits = model.positions(&control.mesh.positions);
        let errors = limits.iter().zip(&points.mesh.positions);
        errors.map(|(a, b)| (*a - *b).length()).fold(0.0, f64::max)
    }

    #[test]
    fn nothing_and_what_is_not_finite_are_refused() {
        assert!(interpolating(&ControlMesh::default(), Scheme::Loop).is_err());
        let mut ball = shapes::sphere(1.0, 1);
        ball.positions[3].x = f64::NAN;
        let ball = PolygonMesh::from(ball).into();
        assert!(interpolating(&ball, Scheme::Loop).is_err());
    }

    #[test]
    fn limits_pass_through_the_points() {
        let ball: ControlMesh = PolygonMesh::from(shapes::lobed_ball(3)).into();
        assert!(residual(&ball, Scheme::Loop) < 1e-13);
        let mut open = shapes::lobed_ball(3);
        open.triangles.swap_remove(100);
        let open: ControlMesh = PolygonMesh::from(open).into();
        assert!(residual(&open, Scheme::Loop) < 1e-13);
        let mut creased = ball;
        creased.creases = [[0, 1], [1, 2]]
            .into_iter()
            .filter(|[a, b]| {
                let faces = creased.mesh.faces();
                faces.clone().any(|f| f.contains(a) && f.contains(b))
            })
            .map(|edge| Crease {
                edge,
                sharpness: f64::INFINITY,
            })
            .collect();
        creased.corners = vec![5];
        assert!(residual(&creased, Scheme::Loop) < 1e-13);
        let ring: ControlMesh = shapes::torus(2.0, 0.7, 12, 9).into();
        assert!(residual(&ring, Scheme::CatmullClark) < 1e-13);
        assert_eq!(residual(&ring, Scheme::Polygon), 0.0);
    }
}
