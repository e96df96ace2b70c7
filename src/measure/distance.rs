//! Comparison of two surfaces: mean, rms, maximum and Hausdorff distance, both ways.
//!
//! Mean and rms are area integrals by evenly spread samples (see [`Figures`]); the sampled maximum is what other programs
//! report as the Hausdorff distance, and is too small. The [`Interval`] is certain to hold the true value, by branch and bound.

use super::hausdorff::{self, Interval, Limits};
use super::sampling::{Figures, Sums, for_each_sample, for_each_vertex};
use crate::error::Result;
use crate::geometry::Bvh;
use crate::mesh::{Frame, TriangleMesh};

/// Below this width, relative to the diagonal, an interval is narrow enough however small the distance is.
const NARROW: f64 = 1e-6;

/// How much work a comparison may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Samples spread over each surface, at least; each triangle gets one at least if there are no more triangles.
    pub samples: usize,
    /// The width of the Hausdorff intervals to reach, relative to the distance itself (or 10⁻⁶ of the diagonal, if that is wider).
    pub tolerance: f64,
    /// The number of triangles and parts of triangles each way after which the intervals are left as wide as they are.
    pub parts: usize,
}

impl Default for Options {
    /// About a second of work on two threads for scans of 100,000 triangles.
    fn default() -> Self {
        Self {
            samples: 500_000,
            tolerance: 1e-4,
            parts: 2_000_000,
        }
    }
}

/// The distance from each point of one surface to another surface, in input units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Directed {
    /// Sampled figures.
    pub figures: Figures,
    /// The number of samples, vertices included.
    pub samples: usize,
    /// Holds the largest distance.
    pub hausdorff: Interval,
}

/// Two surfaces compared, in input units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// The diagonal of the bounding box of A, the reference.
    pub diagonal: f64,
    /// From points of A to B.
    pub a_to_b: Directed,
    /// From points of B to A.
    pub b_to_a: Directed,
}

impl Comparison {
    /// Holds the Hausdorff distance: the larger of the two directions.
    pub fn hausdorff(&self) -> Interval {
        self.a_to_b.hausdorff.max(self.b_to_a.hausdorff)
    }

    /// A length in input units as a percentage of the reference's diagonal.
    pub fn percent(&self, length: f64) -> f64 {
        100.0 * length / self.diagonal
    }
}

/// Compares a surface `b` with the reference `a`; both need finite positions and valid indices.
///
/// # Errors
/// Where a surface has no triangle or no area.
pub fn compare(a: &TriangleMesh, b: &TriangleMesh, options: Options) -> Result<Comparison> {
    let frame = Frame::of(a)?;
    // Far from the origin the midpoints of edges would be rounded too coarsely.
    let [a, b] = [a, b].map(|mesh| TriangleMesh {
        positions: mesh.positions.iter().map(|&p| frame.to_unit(p)).collect(),
        triangles: mesh.triangles.clone(),
    });
    let tree = |mesh: &TriangleMesh| Bvh::new(&mesh.positions, &mesh.triangles);
    let (tree_a, tree_b) = (tree(&a)?, tree(&b)?);
    Ok(Comparison {
        diagonal: frame.diagonal,
        a_to_b: directed(&a, &b, &tree_b, options)?.scaled(frame.diagonal),
        b_to_a: directed(&b, &a, &tree_a, options)?.scaled(frame.diagonal),
    })
}

/// One direction, with the surfaces in the unit frame of the reference.
fn directed(
    from: &TriangleMesh,
    to: &TriangleMesh,
    tree: &Bvh,
    options: Options,
) -> Result<Directed> {
    let mut sums = Sums::default();
    for_each_sample(from, tree, options.samples, |closest, area, _| {
        sums.add(closest.distance_squared, area);
    })?;
    for_each_vertex(from, tree, sums.max, |closest| {
        sums.add(closest.distance_squared, 0.0);
        sums.max
    });
    let figures = sums.figures();
    let limits = Limits {
        relative: options.tolerance,
        absolute: NARROW,
        parts: options.parts,
    };
    Ok(Directed {
        figures,
        samples: sums.count,
        hausdorff: hausdorff::directed(from, to, tree, figures.max, limits),
    })
}

impl Directed {
    fn scaled(self, factor: f64) -> Self {
        Self {
            figures: self.figures.scaled(factor),
            hausdorff: self.hausdorff.scaled(factor),
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::shapes::{grid, sphere};
    use glam::DVec3;

    fn placed(mesh: &TriangleMesh, scale: f64, shift: DVec3) -> TriangleMesh {
        TriangleMesh {
            positions: mesh.positions.iter().map(|&p| scale * p + shift).collect(),
            triangles: mesh.triangles.clone(),
        }
    }

    fn compare_with(samples: usize, a: &TriangleMesh, b: &TriangleMesh) -> Comparison {
        let options = Options {
            samples,
            ..Options::default()
        };
        compare(a, b, options).expect("areas")
    }

    /// The interval holds the value and is as narrow as was asked for.
    fn assert_holds(interval: Interval, value: f64, diagonal: f64) {
        let rounding = 1e-14 * diagonal;
        assert!(
            interval.lower <= value + rounding && interval.upper >= value - rounding,
            "{interval:?} against {value}"
        );
        let width = f64::max(1e-4 * interval.lower, 1e-6 * diagonal);
        assert!(
            interval.upper - interval.lower <= 1.000_001 * width,
            "{interval:?}"
        );
    }

    #[test]
    fn surfaces_without_triangles_or_area_are_refused() {
        let plane = grid(2, 1.0);
        let nothing = TriangleMesh::default();
        let segment = TriangleMesh {
            positions: vec![DVec3::ZERO, DVec3::X],
            triangles: vec![[0, 1, 1]],
        };
        for bad in [&nothing, &segment] {
            assert!(compare(&plane, bad, Options::default()).is_err());
            assert!(compare(bad, &plane, Options::default()).is_err());
        }
    }

    #[test]
    fn a_surface_is_at_no_distance_from_itself() {
        let mut mesh = sphere(12);
        // With degenerate and duplicate triangles.
        mesh.triangles.extend([[0, 1, 1], [5, 5, 5], [0, 1, 2]]);
        let result = compare_with(1000, &mesh, &mesh);
        assert!(result.a_to_b.figures.max < 1e-15);
        assert_holds(result.hausdorff(), 0.0, result.diagonal);
        let triangle = grid(1, 1.0);
        assert_holds(compare_with(1, &triangle, &triangle).hausdorff(), 0.0, 1.0);
    }

    #[test]
    fn parallel_planes_are_as_far_apart_everywhere() {
        let (a, b) = (grid(7, 1.0), placed(&grid(10, 1.0), 1.0, DVec3::Z / 4.0));
        let result = compare_with(1000, &a, &b);
        for side in [result.a_to_b, result.b_to_a] {
            let Figures { max, mean, rms } = side.figures;
            for value in [max, mean, rms] {
                assert!((value - 0.25).abs() < 1e-14);
            }
            assert_holds(side.hausdorff, 0.25, result.diagonal);
        }
        assert!((result.percent(0.25) - 25.0 / 2f64.sqrt()).abs() < 1e-12);
    }

    /// Over an equilateral triangle with inradius r = 1/2 a tent of height h: the centre of the triangle is r h / √(r² + h²) from the tent, which
    /// no corner or edge of either shows; the tip of the tent is h from the triangle.
    #[test]
    fn an_extremum_inside_a_face_is_found() {
        let h = 0.3;
        let mut positions: Vec<_> = [0.0, 1.0, 2.0]
            .map(|k: f64| (std::f64::consts::TAU * k / 3.0).sin_cos())
            .map(|(y, x)| DVec3::new(x, y, 0.0))
            .to_vec();
        positions.push(h * DVec3::Z);
        let mesh = |triangles: &[[u32; 3]]| TriangleMesh {
            positions: positions.clone(),
            triangles: triangles.to_vec(),
        };
        let (floor, tent) = (mesh(&[[0, 1, 2]]), mesh(&[[0, 1, 3], [1, 2, 3], [2, 0, 3]]));
        let result = compare_with(50, &floor, &tent);
        assert_holds(
            result.a_to_b.hausdorff,
            0.5 * h / h.hypot(0.5),
            result.diagonal,
        );
        assert_holds(result.b_to_a.hausdorff, h, result.diagonal);
        assert!(result.hausdorff() == result.b_to_a.hausdorff);
    }

    /// The corner of a convex surface that points along the shift moves by all of it, and no point by more. The distance on the sphere is |x·t| to first
    /// order, of mean |t|/2 and rms |t|/√3.
    #[test]
    fn a_shifted_sphere_anywhere_and_of_any_size() {
        let shape = sphere(24);
        let t = 0.01;
        for (scale, origin) in [(1.0, 0.0), (1e-9, 0.0), (1e9, 0.0), (1.0, 5e6)] {
            let origin = DVec3::splat(origin);
            let a = placed(&shape, scale, origin);
            let b = placed(&shape, scale, origin + t * scale * DVec3::X);
            let result = compare_with(20_000, &a, &b);
            // At 5·10⁶ the coordinates themselves are rounded to 2⁻³⁰.
            let rounding = if origin.x > 0.0 { 2e-9 } else { 1e-14 } * scale;
            for side in [result.a_to_b, result.b_to_a] {
                let Interval { lower, upper } = side.hausdorff;
                assert!(lower <= t * scale + rounding && upper >= t * scale - rounding);
                assert!(upper - lower <= 1.01e-4 * lower);
                assert!((side.figures.mean / scale - 0.5 * t).abs() < 5e-3 * t);
                assert!((side.figures.rms / scale - t / 3f64.sqrt()).abs() < 5e-3 * t);
            }
        }
    }

    #[test]
    fn an_interval_that_runs_out_of_work_is_wide_but_holds_the_value() {
        let a = sphere(24);
        let b = placed(&a, 1.0, 0.01 * DVec3::X);
        let hasty = Options {
            samples: 10,
            tolerance: 1e-9,
            parts: 6000,
        };
        let interval = compare(&a, &b, hasty).expect("areas").hausdorff();
        assert!(interval.lower <= 0.01 + 1e-15 && interval.upper >= 0.01 - 1e-15);
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let a = sphere(20);
        let b = placed(&sphere(15), 1.01, DVec3::new(0.01, 0.02, 0.03));
        let run = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("a thread pool")
                .install(|| compare_with(100_000, &a, &b))
        };
        assert_eq!(run(1), run(3));
    }
}
