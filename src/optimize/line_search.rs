//! A line search for the strong Wolfe conditions (Nocedal & Wright, Numerical Optimization, algorithms 3.5 and 3.6),
//! with safeguarded cubic interpolation. An infinite value is a barrier: the step is too long, nothing more is known.

/// Sufficient decrease.
const C1: f64 = 1e-4;
/// Curvature.
const C2: f64 = 0.9;
/// Trials before the best point so far is taken.
const MAX_TRIALS: usize = 20;

/// The function along the direction: value and slope at a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub step: f64,
    pub value: f64,
    pub slope: f64,
}

/// Finds a step. `evaluate` is called with trial steps; the last call is not necessarily the step returned.
///
/// `None` where no trial lowered the value: the direction is not one of descent to working precision.
pub(super) fn search(
    start: Sample,
    first_step: f64,
    mut evaluate: impl FnMut(f64) -> Sample,
) -> Option<Sample> {
    let decreases = |s: &Sample| s.value <= start.value + C1 * s.step * start.slope;
    let flat = |s: &Sample| s.slope.abs() <= -C2 * start.slope;
    let mut low = start;
    let mut high: Option<Sample> = None;
    let mut step = first_step;
    for _ in 0..MAX_TRIALS {
        let trial = evaluate(step);
        if !trial.value.is_finite()
            || !decreases(&trial)
            || trial.value >= low.value && low.step > 0.0
        {
            high = Some(trial);
        } else if flat(&trial) {
            return Some(trial);
        } else {
            // The minimum lies between the new lower point and whichever end its slope points to.
            let ahead = high.map_or(1.0, |h| h.step - low.step);
            if trial.slope * ahead >= 0.0 {
                high = Some(low);
            }
            low = trial;
        }
        step = match high {
            Some(high) => between(&low, &high),
            // The curvature condition fails on the near side: go further, by the slope where it promises.
            None => 3.0 * low.step.max(f64::MIN_POSITIVE),
        };
        if let Some(high) = high
            && (high.step - low.step).abs() <= 1e-12 * low.step.abs().max(first_step)
        {
            break;
        }
    }
    (low.step > 0.0).then_some(low)
}

/// A step inside the bracket: the minimum of the cubic through both ends, kept off the ends by a tenth.
fn between(low: &Sample, high: &Sample) -> f64 {
    let width = high.step - low.step;
    if !high.value.is_finite() {
        return low.step + 0.25 * width;
    }
    let d1 = low.slope + high.slope - 3.0 * (high.value - low.value) / width;
    let discriminant = d1 * d1 - low.slope * high.slope;
    let fraction = if discriminant >= 0.0 {
        let d2 = discriminant.sqrt() * width.signum();
        1.0 - (high.slope + d2 - d1) / (high.slope - low.slope + 2.0 * d2)
    } else {
        0.5
    };
    let safe = if fraction.is_finite() {
        fraction.clamp(0.1, 0.9)
    } else {
        0.5
    };
    low.step + safe * width
}
