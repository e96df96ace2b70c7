//! Outliers of a scan: points that are on nothing, as far as anybody knows in advance.
//!
//! Least trimmed squares [P. J. Rousseeuw, *Least median of squares regression*, 1984]: of the target's samples the share that the user allows, those farthest from the
//! surface as it is, do not count, and it is chosen anew in every step. What of the surface is as far from the target goes with them, or
//! it would be drawn to them from the other side.

/// The distance that all but this share of the distances do not exceed; infinite for no share.
pub(super) fn cutoff(distances: impl Iterator<Item = f64>, share: f64) -> f64 {
    if share == 0.0 {
        return f64::INFINITY;
    }
    let mut distances: Vec<f64> = distances.collect();
    let kept = ((1.0 - share) * distances.len() as f64).ceil() as usize;
    match kept.checked_sub(1) {
        Some(last) => *distances.select_nth_unstable_by(last, f64::total_cmp).1,
        None => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::cutoff;

    #[test]
    fn a_share_of_the_largest_is_cut_off() {
        let distances = [4.0, 1.0, 3.0, 2.0];
        for (share, last) in [
            (0.0, f64::INFINITY),
            (0.2, 4.0),
            (0.25, 3.0),
            (0.5, 2.0),
            (0.75, 1.0),
        ] {
            assert_eq!(cutoff(distances.into_iter(), share), last, "{share}");
        }
        assert_eq!(cutoff(std::iter::empty(), 0.3), f64::INFINITY);
    }
}
