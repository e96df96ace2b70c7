//! How good a cage is to go on working with: the smallest angle of its faces.

use crate::mesh::PolygonMesh;
use glam::DVec3;

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
}
