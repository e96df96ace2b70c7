//! The end of a fit: the mean is within its tolerance, and a few peaks are left that least squares alone do not bring down.
//!
//! What is beyond the tolerance becomes heavier from step to step, and once the rest is calm only the control points around it move: all others would move for little and
//! take most of the time. Footpoints that rest cost little, so all points of the data are worked with then.

use super::footpoints::Sample;
use super::{Options, Run};
use crate::measure::Figures;
use rayon::prelude::*;

/// Iterations from one split to the next.
pub(super) const ROUND: usize = 6;

/// The share of its tolerance that the mean is brought to before, as peaks that come down lift it a little.
pub(super) const MARGIN: f64 = 0.96;

/// Peaks are what is left where the root mean square is under this share of the tolerance of the largest distance.
const FROM: f64 = 0.35;

/// The share of the tolerance from which on faces are split for peaks: what is just below becomes the next peak when others come down. (The bunny from 610 to 615 control
/// points ends after 28 to 38 iterations, with 1 in place of this after 28 to 46; with 0.9 the elephant takes half as many again.)
pub(super) const SPLIT: f64 = 0.95;

/// What is beyond a share of the tolerance counts so many times as much from step to step, at most so much, until it is under so much of that. With
/// weights that go at once a peak springs back, and with larger ones its neighbours become the next peaks.
pub(super) const LIMIT: f64 = 0.9;
const GAIN: f64 = 2.0;
const HEAVIEST: f64 = 20.0;
const EASED: f64 = 0.5;

/// The rest of the surface may stay where it is once a step lowers the mean to no less than this share.
pub(super) const CALM: f64 = 0.98;

impl Options {
    /// Whether peaks alone keep the largest distance above its tolerance.
    pub(super) fn are_peaks_left(&self, error: Figures) -> bool {
        self.max_error.is_some_and(|t| error.rms < FROM * t)
            && self.mean_error.is_none_or(|t| error.mean <= MARGIN * t)
    }
}

impl Run<'_> {
    /// Makes peaks heavier, and what has come down from them lighter again.
    pub(super) fn weigh_peaks(&mut self) {
        let limit = LIMIT * self.options.max_error.unwrap_or(f64::INFINITY);
        let weigh = |sample: &mut Sample| {
            let distance = sample.distance();
            if distance > limit {
                sample.weight = (sample.weight * GAIN).min(HEAVIEST);
            } else if distance < EASED * limit {
                sample.weight = (sample.weight / GAIN).max(1.0);
            }
        };
        self.samples.par_iter_mut().for_each(weigh);
        self.spread.iter_mut().for_each(weigh);
    }

    /// `[control points]`: whether it has a say in something heavy, or a neighbour has.
    pub(super) fn around_peaks(&self) -> Vec<bool> {
        let mut near = vec![false; self.control.mesh.positions.len()];
        let samples = self.samples.iter().chain(&self.spread);
        for &(c, _) in samples.filter(|s| s.weight > 1.0).flat_map(|s| &s.row) {
            near[c as usize] = true;
        }
        let mesh = self.surface.connectivity();
        let mut around = near.clone();
        for e in 0..mesh.edge_count() as u32 {
            let [a, b] = mesh.ends(e).map(|v| v as usize);
            around[a] |= near[b];
            around[b] |= near[a];
        }
        around
    }
}
