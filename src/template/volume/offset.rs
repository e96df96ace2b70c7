//! How the vertices of a surface move when all of its faces move along their normals.

use crate::mesh::PolygonMesh;
use glam::{DMat3, DVec3};

/// The weight of not moving, beside the squares of unit normals: it decides where the faces around a vertex leave a direction open or contradict each other.
const STAYING: f64 = 1e-3;

/// How one vertex of a surface moves.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Offset {
    /// The motion that takes it one unit over the planes of all faces around it, as nearly as it can be done.
    pub outwards: DVec3,
    /// The mean length of the edges around it.
    pub edge: f64,
}

/// The offsets of all vertices; those of no face do not move. `[vertices]`.
pub(super) fn offsets(surface: &PolygonMesh) -> Vec<Offset> {
    #[derive(Clone, Default)]
    struct Sums {
        squares: DMat3,
        normals: DVec3,
        length: f64,
        sides: f64,
    }
    let nothing = Sums {
        squares: DMat3::ZERO,
        ..Sums::default()
    };
    let mut sums = vec![nothing; surface.positions.len()];
    let at = |v: u32| surface.positions[v as usize];
    for face in surface.faces() {
        let n = face.len();
        for k in 0..n {
            let [before, v, after] = [k + n - 1, k, k + 1].map(|k| face[k % n]);
            let (back, on) = (at(before) - at(v), at(after) - at(v));
            let normal = on.cross(back).normalize_or_zero();
            let sum = &mut sums[v as usize];
            sum.squares +=
                DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
            sum.normals += normal;
            sum.length += back.length() + on.length();
            sum.sides += 2.0;
        }
    }
    sums.into_iter()
        .map(|sum| {
            if sum.sides == 0.0 {
                return Offset::default();
            }
            let planes = sum.squares + DMat3::from_diagonal(DVec3::splat(STAYING));
            Offset {
                outwards: planes.inverse() * sum.normals,
                edge: sum.length / sum.sides,
            }
        })
        .collect()
}
