//! What closes the holes of a target, so that a fit has something to follow there and a judge knows what lies over them.
//!
//! The holes of one scan are bridged from rim to rim ([`topology::fill_holes`]). Of several scans that overlap the rims say little: what is a hole in one is mostly there in
//! another, and where none has seen the surface the rims of several run beside each other. There the winding number tells how the surface goes on, as it is
//! harmonic where there are no triangles: bridges are what of the skin around all scans ([`template::skin`]) has none of them near.

use crate::geometry::{Bvh, ClosestPoint};
use crate::mesh::TriangleMesh;
use crate::template;
use crate::topology::{self, Holes};
use glam::DVec3;

/// What of a skin is further from all scans than this is a bridge, in diagonals: a third of a cell of its grid, more than scans are apart.
const APART: f64 = 0.002;

/// A mesh without most of its holes.
pub struct Bridged {
    /// The triangles of the mesh itself come first.
    pub mesh: TriangleMesh,
    /// How many those are.
    pub real: usize,
}

/// Closes the holes of a mesh as [`topology::cleaned`] leaves it.
pub fn bridged(mut mesh: TriangleMesh, holes: Holes) -> Bridged {
    let real = mesh.triangles.len();
    match holes {
        Holes::Bridge | Holes::Follow => {
            mesh.triangles.extend(topology::fill_holes(&mesh, holes));
        }
        Holes::Leave => {
            let bridges = between_scans(&mesh);
            let first = mesh.positions.len() as u32;
            let moved = bridges.triangles.iter().map(|t| t.map(|v| first + v));
            mesh.triangles.extend(moved);
            mesh.positions.extend(bridges.positions);
        }
    }
    Bridged { mesh, real }
}

/// What of the skin around scans is none of them; nothing where they enclose nothing.
fn between_scans(scans: &TriangleMesh) -> TriangleMesh {
    let scans = topology::oriented(scans);
    let Ok(mut skin) = template::skin(&scans, 0.0) else {
        return TriangleMesh::default();
    };
    let (Ok(tree), Some((lo, hi))) = (
        Bvh::new(&scans.positions, &scans.triangles),
        scans.bounding_box(),
    ) else {
        return TriangleMesh::default();
    };
    let apart = APART * (hi - lo).length();
    let centers: Vec<DVec3> = (0..skin.triangles.len())
        .map(|t| skin.corners(t).iter().sum::<DVec3>() / 3.0)
        .collect();
    let is_bridge = |(t, c): (usize, ClosestPoint)| {
        let there = scans.area_vector(c.triangle as usize);
        c.distance_squared > apart * apart || skin.area_vector(t).dot(there) < 0.0
    };
    let closest = tree.closest_all(&centers).into_iter().enumerate();
    let bridges: Vec<bool> = closest.map(is_bridge).collect();
    let mut bridges = bridges.into_iter();
    skin.triangles.retain(|_| bridges.next() == Some(true));
    topology::cleaned(&skin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn what_encloses_nothing_gets_no_bridges() {
        let nothing = bridged(TriangleMesh::default(), Holes::Leave);
        assert_eq!((nothing.real, nothing.mesh.triangles.len()), (0, 0));
        let sheet = TriangleMesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            triangles: vec![[0, 1, 2]],
        };
        assert_eq!(bridged(sheet.clone(), Holes::Leave).mesh, sheet);
    }

    #[test]
    fn between_the_scans_of_a_ball_its_surface_goes_on() {
        let mut scans = shapes::sphere(1.0, 5);
        let height = |t: &[u32; 3]| scans.positions[t[0] as usize].z;
        let (upper, lower): (Vec<_>, Vec<_>) = (
            scans
                .triangles
                .iter()
                .copied()
                .filter(|t| height(t) > 0.2)
                .collect(),
            scans
                .triangles
                .iter()
                .copied()
                .filter(|t| height(t) < -0.2)
                .collect(),
        );
        // The upper one seen twice.
        scans.triangles = [upper.clone(), upper, lower].concat();
        let scans = topology::cleaned(&scans);
        let Bridged { mesh, real } = bridged(scans.clone(), Holes::Leave);
        assert_eq!(mesh.triangles[..real], scans.triangles);
        let bridges = TriangleMesh {
            positions: mesh.positions,
            triangles: mesh.triangles[real..].to_vec(),
        };
        let mut outwards = 0.0;
        for t in 0..bridges.triangles.len() {
            let center = bridges.corners(t).iter().sum::<DVec3>() / 3.0;
            // A surface of equal winding numbers sags a little between its rims.
            let is_between = center.z.abs() < 0.25 && (center.length() - 1.0).abs() < 0.15;
            assert!(is_between, "{center}");
            outwards += 0.5 * bridges.area_vector(t).dot(center.normalize());
        }
        let band = 0.8 * std::f64::consts::PI;
        assert!((outwards / band - 1.0).abs() < 0.2, "{outwards}");
        assert!(
            (bridges.area() / band - 1.0).abs() < 0.2,
            "{}",
            bridges.area()
        );
    }
}
