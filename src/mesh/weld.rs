use super::PolygonMesh;
use glam::DVec3;

/// The same mesh with vertices at identical positions merged into the first of them, so that seams close.
///
/// For formats that repeat a position for every face or every texture seam. Positions must be equal to the bit (0 and −0 are equal):
/// no tolerance, because a tolerance that suits one scan destroys the details of another. Faces that lose a corner's distinctness stay,
/// as degenerate faces; vertices without faces stay too. Cost O(n).
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

/// For each position the index of the first one equal to it; 0 and −0 are equal.
pub(crate) fn equal_positions(positions: &[DVec3]) -> Vec<u32> {
    // Adding zero turns −0 into 0 and changes nothing else.
    let key = |p: &DVec3| (*p + DVec3::ZERO).to_array().map(f64::to_bits);
    let keys: Vec<[u64; 3]> = positions.iter().map(key).collect();
    first_equal(&keys)
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
            DVec3::new(1.0 + f64::EPSILON, 0.0, 0.0),
        ];
        let welded = weld(&PolygonMesh::from_faces(positions, [[0, 1, 2], [3, 2, 4]]));
        assert_eq!(welded.positions.len(), 4);
        assert_eq!(welded.face(0), [0, 1, 2]);
        assert_eq!(welded.face(1), [0, 2, 3]);
    }
}
