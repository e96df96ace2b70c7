//! The gate: whether a quad mesh is fit to start from.

use super::skin::Subject;
use crate::error::Result;
use crate::mesh::{Connectivity, PolygonMesh};
use glam::DVec3;

/// How far the number of points may be from that asked for, as a share of it.
const COUNT: f64 = 0.05;

/// The largest share of the area that may face away from the target. A fit seldom mends folds.
const FOLDS: f64 = 0.003;

/// Up to this share closest points may lead a fit all the same (a gear's teeth have 0.3 %, and Voronoi steps do not help there; a dragon's claws have 0.7 %,
/// and they halve the error).
const BEARABLE: f64 = 0.005;

/// The largest standard deviation of the edges' lengths, in means: beyond it the small quads fold.
const VARIATION: f64 = 0.5;

/// From this share of the area on that opposes the closest point of the target, though there is one close by that it does not, the target is taken for a double wall that
/// is thin against the quads. (One 0.8 % thick makes 16 %; a dragon's claws make 0.9 %, and them Voronoi steps lay out better.)
const WALLS: f64 = 0.05;

/// How close by, in diagonals.
const THIN: f64 = 0.01;

/// What is known of a template.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judgement {
    points: usize,
    asked: usize,
    euler: i64,
    wanted: i64,
    folds: f64,
    /// Whether the target is a wall that is thin against the quads. What sags through it is not folded.
    pub thin: bool,
    variation: f64,
    /// Whether it should be open.
    open: bool,
    /// The share of the vertices that do not have four faces, or two on the boundary.
    pub irregular: f64,
}

/// From this share on folds are no fault of the template: the target is an open sheet, wrapped on both sides, and one of them faces away.
const TWO_SIDED: f64 = 0.1;

impl Judgement {
    /// Judges a mesh of `asked` points that should have the Euler characteristic `wanted`.
    ///
    /// # Errors
    /// Where it is no oriented manifold.
    pub fn of(mesh: &PolygonMesh, subject: &Subject, asked: usize, wanted: i64) -> Result<Self> {
        let connectivity = Connectivity::of(mesh)?;
        let points = mesh.positions.len();
        let regular = |v: u32| {
            if connectivity.is_boundary_vertex(v) {
                2
            } else {
                4
            }
        };
        let irregular = |v: &u32| connectivity.around(*v).count() != regular(*v);
        let (opposed, folded) = folds(mesh, subject);
        let thin = opposed > WALLS && folded <= FOLDS;
        Ok(Self {
            points,
            asked,
            euler: connectivity.euler_characteristic(),
            wanted,
            folds: if thin { folded } else { opposed },
            thin,
            variation: variation(mesh, &connectivity),
            open: subject.rim.is_some(),
            irregular: (0..points as u32).filter(irregular).count() as f64 / points.max(1) as f64,
        })
    }

    /// The folded share of the area.
    pub fn folds(&self) -> f64 {
        self.folds
    }

    /// Whether closest points serve from the start.
    pub fn is_sound(&self) -> bool {
        self.euler == self.wanted && self.folds <= BEARABLE
    }

    /// Whether it wraps an open sheet on both sides.
    pub fn is_two_sided(&self) -> bool {
        !self.open && self.folds > TWO_SIDED
    }

    /// Why it does not pass, if it does not.
    pub fn objection(&self) -> Option<String> {
        let wrong_count = self.points.abs_diff(self.asked) as f64 > COUNT * self.asked as f64;
        if self.euler != self.wanted {
            let (found, wanted) = (self.euler, self.wanted);
            Some(format!("its Euler characteristic is {found}, not {wanted}"))
        } else if wrong_count {
            let (points, asked) = (self.points, self.asked);
            Some(format!("it has {points} points, not {asked}"))
        } else if self.folds > FOLDS {
            Some(format!("{:.2} % of it is folded", 100.0 * self.folds))
        } else if self.variation > VARIATION {
            let percent = 100.0 * self.variation;
            Some(format!("the lengths of its edges vary by {percent:.0} %"))
        } else {
            None
        }
    }

    /// Smaller is better: the topology first, then the number of points, then the folds.
    pub fn rank(&self) -> (bool, bool, f64) {
        let wrong_count = self.points.abs_diff(self.asked) as f64 > COUNT * self.asked as f64;
        (self.euler != self.wanted, wrong_count, self.folds)
    }
}

/// The share of the area whose normal opposes that of the target's closest triangle, and of that whose normal opposes all of the target about there ([`THIN`]). A quad is
/// judged by its two triangles either way.
fn folds(mesh: &PolygonMesh, subject: &Subject) -> (f64, f64) {
    let at = |v: u32| mesh.positions[v as usize];
    let corners = |f: &[u32], k: usize| [0, 1, 2].map(|i| at(f[(k + i) % f.len()]));
    let triangles: Vec<[DVec3; 3]> = mesh
        .faces()
        .flat_map(|f| (0..f.len()).map(move |k| corners(f, k)))
        .collect();
    let centers: Vec<DVec3> = (triangles.iter())
        .map(|t| t.iter().sum::<DVec3>() / 3.0)
        .collect();
    let (mut opposed, mut folded, mut all) = (0.0, 0.0, 0.0);
    for ([a, b, c], closest) in triangles.iter().zip(subject.tree.closest_all(&centers)) {
        let area_vector = (b - a).cross(c - a);
        all += area_vector.length();
        let opposes = |t: u32| area_vector.dot(subject.mesh.area_vector(t as usize)) < 0.0;
        if opposes(closest.triangle) {
            opposed += area_vector.length();
            if !subject.has_near(closest.point, THIN, |t| !opposes(t)) {
                folded += area_vector.length();
            }
        }
    }
    if all > 0.0 {
        (opposed / all, folded / all)
    } else {
        (1.0, 1.0)
    }
}

/// The standard deviation of the edges' lengths over their mean.
fn variation(mesh: &PolygonMesh, connectivity: &Connectivity) -> f64 {
    let lengths = edge_lengths(mesh, connectivity);
    let count = lengths.len().max(1) as f64;
    let mean = lengths.iter().sum::<f64>() / count;
    let square = lengths.iter().map(|l| (l - mean) * (l - mean)).sum::<f64>() / count;
    square.sqrt() / mean
}

/// `[edges]`.
pub(super) fn edge_lengths(mesh: &PolygonMesh, connectivity: &Connectivity) -> Vec<f64> {
    (0..connectivity.edge_count() as u32)
        .map(|e| {
            let [a, b] = connectivity.ends(e).map(|v| mesh.positions[v as usize]);
            a.distance(b)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;
    use crate::topology::Holes;

    #[test]
    fn a_sound_torus_passes_and_each_fault_is_named() {
        let target = shapes::torus(1.0, 0.4, 60, 30).triangulate();
        let subject = Subject::new(&target, Holes::Bridge).expect("triangles");
        let torus = shapes::torus(1.0, 0.4, 30, 12);
        let objection = |mesh: &PolygonMesh, asked, euler| {
            let judgement = Judgement::of(mesh, &subject, asked, euler).expect("a manifold");
            judgement.objection().unwrap_or_default()
        };
        assert_eq!(objection(&torus, 360, 0), "");
        assert_eq!(objection(&torus, 375, 0), "");
        assert!(objection(&torus, 360, 2).contains("Euler characteristic is 0, not 2"));
        assert!(objection(&torus, 400, 0).contains("360 points, not 400"));
        let mut folded = torus.clone();
        for v in [40, 100, 160, 220] {
            folded.positions.swap(v, v + 1);
        }
        assert!(objection(&folded, 360, 0).contains("is folded"));
        let mut uneven = torus.clone();
        for p in &mut uneven.positions {
            p.z *= 9.0;
        }
        assert!(objection(&uneven, 360, 0).contains("lengths of its edges"));
        let mut turned = torus.clone();
        turned = PolygonMesh::from_faces(
            std::mem::take(&mut turned.positions),
            torus
                .faces()
                .map(|f| f.iter().rev().copied().collect::<Vec<_>>()),
        );
        assert!(objection(&turned, 360, 0).contains("100.00 % of it is folded"));
        let book = PolygonMesh::from_faces(torus.positions.clone(), [[0, 1, 2], [0, 1, 3]]);
        assert!(Judgement::of(&book, &subject, 360, 0).is_err());
    }

    #[test]
    fn what_sags_through_a_thin_wall_is_not_folded_and_through_a_thick_one_it_is() {
        // The surface faces outwards but is nearer to the inner side of the wall.
        let judged = |inner: f64, surface: f64| {
            let mut wall = shapes::sphere(1.0, 4);
            let inside = shapes::sphere(inner, 4);
            let first = wall.positions.len() as u32;
            wall.positions.extend(inside.positions);
            let turned = inside.triangles.iter().map(|t| [t[0], t[2], t[1]]);
            wall.triangles.extend(turned.map(|t| t.map(|v| first + v)));
            let subject = Subject::new(&wall, Holes::Bridge).expect("triangles");
            let ball: PolygonMesh = shapes::sphere(surface, 3).into();
            Judgement::of(&ball, &subject, ball.positions.len(), 2).expect("a manifold")
        };
        let thin = judged(0.98, 0.985);
        assert_eq!(
            (thin.thin, thin.folds(), thin.objection()),
            (true, 0.0, None)
        );
        let thick = judged(0.9, 0.92);
        assert_eq!((thick.thin, thick.folds()), (false, 1.0));
    }
}
