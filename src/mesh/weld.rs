use super::PolygonMesh;
use glam::DVec3;

/// How far apart, in diagonals of the bounding box, positions are that only rounding to single precision keeps apart. No scan is so dense.
const ROUNDING: f64 = 1e-7;

/// The side of the cells in which such positions are looked for, in that distance: large enough that few pairs lie across a border, small enough
/// that few cells hold more than one position.
const CELL: f64 = 64.0;

/// The same mesh with vertices at the same position merged into the first of them, so that seams close.
///
/// For formats that repeat a position for every face or every texture seam. Positions are the same where they are nearer to each other than
/// 1e-7 of the bounding box's diagonal, which is what rounding leaves of a common vertex; there is no larger tolerance, because one that suits one scan
/// destroys the details of another. Faces that lose a corner's distinctness stay, as degenerate faces; vertices without faces stay too. Cost O(n).
pub fn weld(mesh: &PolygonMesh) -> PolygonMesh {
    welded(mesh).0
}

/// Like [`weld`], with the new index of every vertex.
pub(crate) fn welded(mesh: &PolygonMesh) -> (PolygonMesh, Vec<u32>) {
    let first = equal_positions(&mesh.positions);
    let mut positions: Vec<DVec3> = Vec::with_capacity(mesh.positions.len());
    let mut merged: Vec<u32> = Vec::with_capacity(mesh.positions.len());
    for (v, &p) in mesh.positions.iter().enumerate() {
        if first[v] as usize == v {
            merged.push(positions.len() as u32);
            positions.push(p);
        } else {
            merged.push(merged[first[v] as usize]);
        }
    }
    let mut welded = PolygonMesh::new(positions);
    let mut corners = Vec::new();
    for face in mesh.faces() {
        corners.clear();
        corners.extend(face.iter().map(|&v| merged[v as usize]));
        welded.push_face(&corners);
    }
    (welded, merged)
}

/// For each position the index of the first one that is the same but for rounding.
pub(crate) fn equal_positions(positions: &[DVec3]) -> Vec<u32> {
    // Adding zero turns −0 into 0 and changes nothing else.
    let key = |p: DVec3| (p + DVec3::ZERO).to_array().map(f64::to_bits);
    let keys: Vec<[u64; 3]> = positions.iter().map(|&p| key(p)).collect();
    let mut first = first_equal(&keys);
    let rounding = ROUNDING * diagonal(positions);
    if !(rounding > 0.0 && rounding.is_finite()) {
        return first;
    }
    let distinct: Vec<u32> = (0..positions.len() as u32)
        .filter(|&v| first[v as usize] == v)
        .collect();
    // On each axis a pair is parted by the borders of one of these grids at most, so that one of them parts it on no axis.
    for shift in [0.0, 0.25, 0.5, 0.75] {
        let cell = |&v: &u32| key((positions[v as usize] / (CELL * rounding) + shift).floor());
        let cells: Vec<[u64; 3]> = distinct.iter().map(cell).collect();
        for (&v, found) in distinct.iter().zip(first_equal(&cells)) {
            let w = distinct[found as usize];
            let [p, q] = [v, w].map(|v| positions[v as usize]);
            if p.distance_squared(q) < rounding * rounding {
                join(&mut first, v, w);
            }
        }
    }
    for v in 0..first.len() {
        // Those before it are done.
        first[v] = first[first[v] as usize];
    }
    first
}

fn diagonal(positions: &[DVec3]) -> f64 {
    let lo = positions.iter().fold(DVec3::INFINITY, |lo, &p| lo.min(p));
    let hi = (positions.iter()).fold(DVec3::NEG_INFINITY, |hi, &p| hi.max(p));
    lo.distance(hi)
}

/// Gives the classes of two indices one first index.
fn join(first: &mut [u32], v: u32, w: u32) {
    let [a, b] = [v, w].map(|mut v| {
        while first[v as usize] != v {
            v = first[v as usize];
        }
        v
    });
    first[a.max(b) as usize] = a.min(b);
}

/// For each key the index of the first key equal to it, by a table with open addressing, at most half full. Several times the speed of
/// a general hash map, which matters where millions of corners are told apart.
pub(crate) fn first_equal(keys: &[[u64; 3]]) -> Vec<u32> {
    const FREE: u32 = u32::MAX;
    let mask = (2 * keys.len()).next_power_of_two() - 1;
    let mut table = vec![FREE; mask + 1];
    let mut first = Vec::with_capacity(keys.len());
    for (i, key) in keys.iter().enumerate() {
        let mut slot = hash(key) as usize & mask;
        while table[slot] != FREE && keys[table[slot] as usize] != *key {
            slot = (slot + 1) & mask;
        }
        if table[slot] == FREE {
            table[slot] = i as u32;
        }
        first.push(table[slot]);
    }
    first
}

/// Mixes three words: each multiplied by an odd constant (2⁶⁴ over the golden ratio), high bits folded down.
fn hash(words: &[u64; 3]) -> u64 {
    words.iter().fold(0, |h: u64, word| {
        let mixed = (h ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        mixed ^ (mixed >> 32)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_mesh_stays_empty() {
        assert_eq!(weld(&PolygonMesh::default()), PolygonMesh::default());
    }

    #[test]
    fn signed_zeros_are_one_position_and_neighbours_are_two() {
        let positions = vec![
            DVec3::ZERO,
            DVec3::X,
            DVec3::Y,
            DVec3::new(-0.0, 0.0, -0.0),
            DVec3::new(1.0 + 1e-6, 0.0, 0.0),
        ];
        let welded = weld(&PolygonMesh::from_faces(positions, [[0, 1, 2], [3, 2, 4]]));
        assert_eq!(welded.positions.len(), 4);
        assert_eq!(welded.face(0), [0, 1, 2]);
        assert_eq!(welded.face(1), [0, 2, 3]);
    }

    #[test]
    fn what_rounding_parted_is_one_position_wherever_it_lies() {
        // Around zero, at every border of the cells and between them.
        let places = (-200..200).map(|k| DVec3::new(1e-6, 2e-6, 3e-6) * f64::from(k));
        let mut positions: Vec<DVec3> = places.collect();
        let count = positions.len() as u32;
        for k in 0..count {
            let p = positions[k as usize];
            positions.push(p + DVec3::new(3e-8, -4e-8, 2e-8));
        }
        positions.extend([DVec3::ZERO, DVec3::X]);
        let first = equal_positions(&positions);
        for k in 0..count {
            assert_eq!([first[k as usize], first[(k + count) as usize]], [k; 2]);
        }
        assert_eq!(first[2 * count as usize..], [200, 2 * count + 1]);
    }

    #[test]
    fn positions_that_are_not_finite_keep_to_themselves() {
        let bad = DVec3::new(f64::INFINITY, 0.0, 0.0);
        assert_eq!(
            equal_positions(&[bad, DVec3::X, DVec3::Y, bad]),
            [0, 1, 2, 0]
        );
    }
}
