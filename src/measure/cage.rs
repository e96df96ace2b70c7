//! How good a surface is to go on working with: which part of it is folded over, and the smallest angle of its cage.

use super::surface_error::Boundary;
use crate::error::Result;
use crate::geometry::{Bvh, ClosestPoint};
use crate::mesh::{Connectivity, PolygonMesh, TriangleMesh};
use crate::reconstruction::{Bridged, bridged};
use crate::topology::{self, Holes};
use glam::DVec3;

/// What a surface is held against: the target cleaned, facing outwards, its holes filled but for those that are followed.
pub struct Mended {
    mesh: TriangleMesh,
    /// The triangles that fill no hole come first.
    real: usize,
    holes: Holes,
}

impl Mended {
    /// Of a target with finite positions and valid indices.
    pub fn of(target: &TriangleMesh, holes: Holes) -> Self {
        let mesh = topology::oriented(&topology::cleaned(target));
        let Bridged { mesh, real } = bridged(mesh, holes);
        Self { mesh, real, holes }
    }

    /// V − E + F, where it is one connected manifold and no larger hole has been filled: a slit between two parts is filled like one, and then some handles are missing.
    pub fn euler_characteristic(&self) -> Option<i64> {
        if self.holes == Holes::Bridge && self.real < self.mesh.triangles.len() {
            return None;
        }
        let connectivity = Connectivity::of(&self.mesh.clone().into()).ok()?;
        let known = connectivity.is_connected();
        known.then(|| connectivity.euler_characteristic())
    }

    /// The share of a surface's area that faces away from the target, of what does not lie over a hole.
    ///
    /// # Errors
    /// Where the target has no triangle.
    pub fn folded_share(&self, surface: &TriangleMesh) -> Result<f64> {
        let boundary = Boundary::of(&self.mesh);
        let tree = Bvh::new(&self.mesh.positions, &self.mesh.triangles)?;
        let triangles: Vec<[DVec3; 3]> = (0..surface.triangles.len())
            .map(|t| surface.corners(t))
            .collect();
        let covered = |c: &ClosestPoint| (c.triangle as usize) < self.real && !boundary.holds(c);
        Ok(share_facing_away(&triangles, &self.mesh, &tree, covered))
    }
}

/// The share of the triangles' area whose normal opposes that of the target's closest triangle, among those whose closest points `count`; `tree` is the target's.
pub(crate) fn share_facing_away(
    triangles: &[[DVec3; 3]],
    target: &TriangleMesh,
    tree: &Bvh,
    count: impl Fn(&ClosestPoint) -> bool,
) -> f64 {
    let centers: Vec<DVec3> = triangles
        .iter()
        .map(|t| t.iter().sum::<DVec3>() / 3.0)
        .collect();
    let (mut away, mut all) = (0.0, 0.0);
    for ([a, b, c], closest) in triangles.iter().zip(tree.closest_all(&centers)) {
        if !count(&closest) {
            continue;
        }
        let area_vector = (b - a).cross(c - a);
        all += area_vector.length();
        if area_vector.dot(target.area_vector(closest.triangle as usize)) < 0.0 {
            away += area_vector.length();
        }
    }
    if all > 0.0 { away / all } else { 1.0 }
}

/// The smallest angle between two neighbouring sides of a face, in degrees; 0 where a side has no length, 180 of a mesh without faces.
pub fn least_angle(mesh: &PolygonMesh) -> f64 {
    let at = |v: u32| mesh.positions[v as usize];
    let corners = mesh.faces().flat_map(|face| {
        let n = face.len();
        (0..n).map(move |k| [face[(k + n - 1) % n], face[k], face[(k + 1) % n]].map(at))
    });
    let angle = |[a, b, c]: [DVec3; 3]| {
        let (to_a, to_c) = (a - b, c - b);
        if to_a == DVec3::ZERO || to_c == DVec3::ZERO {
            return 0.0;
        }
        to_a.angle_between(to_c).to_degrees()
    };
    corners.map(angle).fold(180.0, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn angles_of_nothing_of_slivers_and_of_a_cube() {
        assert_eq!(least_angle(&PolygonMesh::default()), 180.0);
        let cube = shapes::box_grid(DVec3::ZERO, DVec3::ONE, [2; 3]);
        assert!((least_angle(&cube) - 90.0).abs() < 1e-9);
        let double = vec![DVec3::ZERO, DVec3::ZERO, DVec3::X];
        assert_eq!(
            least_angle(&PolygonMesh::from_faces(double, [[0, 1, 2]])),
            0.0
        );
    }

    #[test]
    fn what_is_turned_over_is_folded_and_what_spans_a_hole_is_not_asked() {
        let ball = shapes::sphere(1.0, 3);
        let mut surface = shapes::sphere(1.01, 2);
        let folded = |target: &TriangleMesh, surface: &TriangleMesh| {
            let mended = Mended::of(target, Holes::Bridge);
            mended.folded_share(surface).expect("triangles")
        };
        assert_eq!(folded(&ball, &surface), 0.0);
        let mut inward = ball.clone();
        inward.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(folded(&inward, &surface), 0.0);
        for t in surface.triangles.iter_mut().step_by(4) {
            t.swap(0, 1);
        }
        let quarter = folded(&ball, &surface);
        assert!((quarter - 0.25).abs() < 0.03, "{quarter}");
        let mut open = ball.clone();
        open.triangles
            .retain(|t| t.iter().any(|&v| ball.positions[v as usize].z < 0.9));
        let upper = surface.triangles.len();
        surface = shapes::sphere(1.01, 2);
        for t in 0..upper {
            if surface.corners(t).iter().all(|p| p.z > 0.93) {
                surface.triangles[t].swap(0, 1);
            }
        }
        assert_eq!(folded(&open, &surface), 0.0);
        assert_eq!(
            Mended::of(&ball, Holes::Bridge).euler_characteristic(),
            Some(2)
        );
        assert_eq!(
            Mended::of(&open, Holes::Bridge).euler_characteristic(),
            None
        );
        let followed = Mended::of(&open, Holes::Follow);
        assert_eq!(followed.euler_characteristic(), Some(1));
        let nothing = Mended::of(&TriangleMesh::default(), Holes::Bridge);
        assert!(nothing.folded_share(&surface).is_err());
    }
}
