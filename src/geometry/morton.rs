//! Morton order: neighbours in space become neighbours in the array, so that what one query touched is still in the cache for the next.

use glam::DVec3;
use rayon::prelude::*;

/// Bits of each coordinate in a code: three of them fit in 30 bits, and 1,024 cells a side tell millions of points apart well enough.
const BITS: u32 = 10;

/// The indices of `points` sorted along the Z-curve through the points' bounding box; equal codes keep the order of their indices.
pub fn order(points: &[DVec3]) -> Vec<u32> {
    let (lo, hi) = points
        .par_iter()
        .fold(
            || (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |(lo, hi), &p| (lo.min(p), hi.max(p)),
        )
        .reduce(
            || (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |a, b| (a.0.min(b.0), a.1.max(b.1)),
        );
    let cells = f64::from((1 << BITS) - 1) / (hi - lo).max_element().max(f64::MIN_POSITIVE);
    let mut keys: Vec<u64> = points
        .par_iter()
        .enumerate()
        .map(|(i, &p)| u64::from(code((p - lo) * cells)) << 32 | i as u64)
        .collect();
    keys.par_sort_unstable();
    keys.into_par_iter().map(|key| key as u32).collect()
}

/// Interleaves the integer parts of the coordinates, x lowest.
fn code(cell: DVec3) -> u32 {
    spread(cell.x as u32) | spread(cell.y as u32) << 1 | spread(cell.z as u32) << 2
}

/// Moves bit k of a [`BITS`]-bit number to bit 3 k.
fn spread(x: u32) -> u32 {
    let x = (x | x << 16) & 0x0300_00ff;
    let x = (x | x << 8) & 0x0300_f00f;
    let x = (x | x << 4) & 0x030c_30c3;
    (x | x << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_index_occurs_once_and_codes_ascend() {
        let points: Vec<_> = (0..1000u32)
            .map(|i| {
                DVec3::new(
                    f64::from(i * 37 % 101),
                    f64::from(i * 91 % 103),
                    f64::from(i % 7),
                )
            })
            .collect();
        let mut seen = order(&points);
        seen.sort_unstable();
        assert!(seen.iter().copied().eq(0..1000));
        let codes: Vec<_> = order(&points)
            .iter()
            .map(|&i| code(points[i as usize] * (1023.0 / 102.0)))
            .collect();
        assert!(codes.is_sorted());
    }

    #[test]
    fn coincident_points_and_none_keep_their_order() {
        assert_eq!(order(&[]), Vec::<u32>::new());
        assert_eq!(order(&[DVec3::ONE; 3]), [0, 1, 2]);
    }

    #[test]
    fn codes_interleave_bits() {
        assert_eq!(code(DVec3::new(1023.0, 0.0, 0.0)), 0x0924_9249);
        assert_eq!(code(DVec3::new(1.0, 2.0, 4.0)), 0b100_010_001);
    }
}
