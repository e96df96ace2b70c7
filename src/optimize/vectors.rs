//! Sums and products of long vectors of points.
//!
//! Meshes of high order have millions of unknowns, and L-BFGS passes over some forty such vectors an iteration: what counts is how fast memory is
//! read. Threads take chunks of a fixed size, so that results are the same bits for any number of them.

use glam::DVec3;
use rayon::prelude::*;

/// Points that one task takes: 400 kB.
const CHUNK: usize = 1 << 14;

/// aᵀ b.
pub(crate) fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    let of_chunk = |(a, b): (&[DVec3], &[DVec3])| -> f64 {
        let products = a.iter().zip(b).map(|(a, b)| a.dot(*b));
        products.sum()
    };
    if a.len() <= CHUNK {
        return of_chunk((a, b));
    }
    let chunks = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK));
    let sums: Vec<f64> = chunks.map(of_chunk).collect();
    sums.into_iter().sum()
}

/// a + scale b.
pub(crate) fn add(a: &[DVec3], b: &[DVec3], scale: f64) -> Vec<DVec3> {
    let pairs = a.par_iter().zip(b).with_min_len(CHUNK);
    pairs.map(|(a, b)| *a + *b * scale).collect()
}

/// a ← a + scale b.
pub(crate) fn add_to(a: &mut [DVec3], b: &[DVec3], scale: f64) {
    let chunks = a.par_chunks_mut(CHUNK).zip(b.par_chunks(CHUNK));
    chunks.for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a += *b * scale));
}

/// a ← scale a.
pub(crate) fn scale_by(a: &mut [DVec3], scale: f64) {
    let chunks = a.par_chunks_mut(CHUNK);
    chunks.for_each(|a| a.iter_mut().for_each(|a| *a *= scale));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_vectors_give_what_short_ones_do() {
        for n in [0, 1, CHUNK, CHUNK + 1, 3 * CHUNK - 1] {
            let a: Vec<DVec3> = (0..n).map(|i| DVec3::splat((i % 7) as f64)).collect();
            let b: Vec<DVec3> = (0..n).map(|i| DVec3::splat((i % 5) as f64)).collect();
            // Whole numbers: no sum is rounded.
            let wanted: usize = (0..n).map(|i| 3 * (i % 7) * (i % 5)).sum();
            assert_eq!(dot(&a, &b), wanted as f64);
            let mut sum = add(&a, &b, 2.0);
            scale_by(&mut sum, 0.5);
            let half = |i: usize| 0.5 * (i % 7) as f64 + (i % 5) as f64;
            assert!((0..n).all(|i| sum[i] == DVec3::splat(half(i))));
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let a: Vec<DVec3> = (0..5 * CHUNK)
            .map(|i| DVec3::splat((i as f64).sin()))
            .collect();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            pool.build().unwrap().install(|| dot(&a, &a).to_bits())
        };
        assert_eq!(with(1), with(3));
    }
}
