//! Distances between surfaces as a report states them: in input units and in percent of the diagonal.

use crate::measure::{self, Comparison, Interval, RimError, SurfaceError};
use serde::Serialize;

/// How far two surfaces are apart.
///
/// Both directions together: of the largest, the mean and the root mean square, each the larger of the two directions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorReport {
    /// The Hausdorff distance: for `compare` the upper end of the certified interval; for a fit the largest distance at the vertices and the
    /// area samples of both surfaces, without what lies over the target's holes.
    pub hausdorff: f64,
    /// The same in percent.
    pub hausdorff_percent: f64,
    /// Holds the true Hausdorff distance with certainty (`compare`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hausdorff_interval: Option<[f64; 2]>,
    /// The largest sampled distance.
    pub max_percent: f64,
    /// The mean distance.
    pub mean_percent: f64,
    /// The root mean square distance.
    pub rms_percent: f64,
    /// From the target (A) to the surface (B).
    pub target_to_surface: Directed,
    /// From the surface (B) to the target (A); absent where the target is a cloud of points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface_to_target: Option<Directed>,
    /// From the points that were fitted to to the exact limit surface (the geometric method).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_to_limit: Option<Directed>,
    /// The part of a fitted surface that spans holes of the target; absent where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub over_holes: Option<OverHoles>,
    /// Between the boundary curves of target and surface, where those are followed (`--open`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rims: Option<RimReport>,
}

/// How far boundary curves are apart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RimReport {
    /// From the target's to the surface's.
    pub target_to_surface: Figures,
    /// From the surface's to the target's.
    pub surface_to_target: Figures,
}

/// One direction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Directed {
    /// Sampled distances.
    #[serde(flatten)]
    pub figures: Figures,
    /// The number of samples, vertices included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<usize>,
    /// Holds the largest distance with certainty.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hausdorff_interval: Option<[f64; 2]>,
}

/// Sampled distances, in input units and in percent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// The largest.
    pub max: f64,
    /// The average over the area.
    pub mean: f64,
    /// The root of the average square over the area.
    pub rms: f64,
    /// `max` in percent.
    pub max_percent: f64,
    /// `mean` in percent.
    pub mean_percent: f64,
    /// `rms` in percent.
    pub rms_percent: f64,
}

/// What lies over holes of the target, or beyond its rim.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OverHoles {
    /// The share of the surface's area, in percent.
    pub area_percent: f64,
    /// The largest distance from there to the target.
    pub max: f64,
    /// The same in percent of the diagonal.
    pub max_percent: f64,
}

impl ErrorReport {
    /// The error of a fit to a cloud of points: their distances from the surface, in the unit frame of a target with this diagonal.
    pub fn of_points(figures: measure::Figures, diagonal: f64) -> Self {
        Self {
            surface_to_target: None,
            ..Self::both(
                Directed::of_fit(figures, diagonal),
                Directed::of_fit(figures, diagonal),
            )
        }
    }

    /// With the distances of the points that were fitted to.
    pub fn with_data(self, figures: Option<measure::Figures>, diagonal: f64) -> Self {
        Self {
            data_to_limit: figures.map(|figures| Directed::of_fit(figures, diagonal)),
            ..self
        }
    }

    /// With the distances between the rims, in the unit frame of a target with this diagonal.
    pub fn with_rims(self, rims: Option<RimError>, diagonal: f64) -> Self {
        let figures = |figures| Figures::new(figures, diagonal, diagonal);
        let report = |rims: RimError| RimReport {
            target_to_surface: figures(rims.target_to_surface),
            surface_to_target: figures(rims.surface_to_target),
        };
        Self {
            rims: rims.map(report),
            ..self
        }
    }

    /// The error of a fit, measured in the unit frame of a target with this diagonal.
    pub fn of_fit(error: &SurfaceError, diagonal: f64) -> Self {
        let [forth, back] = [error.target_to_surface, error.surface_to_target]
            .map(|figures| Directed::of_fit(figures, diagonal));
        let over_holes = OverHoles {
            area_percent: 100.0 * error.share_over_holes,
            max: diagonal * error.max_over_holes,
            max_percent: 100.0 * error.max_over_holes,
        };
        Self {
            hausdorff: diagonal * error.max(),
            hausdorff_percent: 100.0 * error.max(),
            hausdorff_interval: None,
            over_holes: (error.share_over_holes > 0.0).then_some(over_holes),
            ..Self::both(forth, back)
        }
    }

    /// The distances of a comparison, A as the target.
    pub fn of_comparison(comparison: &Comparison) -> Self {
        let ends = |interval: Interval| [interval.lower, interval.upper];
        let [forth, back] = [comparison.a_to_b, comparison.b_to_a].map(|directed| Directed {
            figures: Figures::new(directed.figures, 1.0, comparison.diagonal),
            samples: Some(directed.samples),
            hausdorff_interval: Some(ends(directed.hausdorff)),
        });
        let hausdorff = comparison.hausdorff();
        Self {
            hausdorff: hausdorff.upper,
            hausdorff_percent: comparison.percent(hausdorff.upper),
            hausdorff_interval: Some(ends(hausdorff)),
            ..Self::both(forth, back)
        }
    }

    fn both(forth: Directed, back: Directed) -> Self {
        let (a, b) = (&forth.figures, &back.figures);
        Self {
            hausdorff: a.max.max(b.max),
            hausdorff_percent: a.max_percent.max(b.max_percent),
            hausdorff_interval: None,
            max_percent: a.max_percent.max(b.max_percent),
            mean_percent: a.mean_percent.max(b.mean_percent),
            rms_percent: a.rms_percent.max(b.rms_percent),
            target_to_surface: forth,
            surface_to_target: Some(back),
            data_to_limit: None,
            over_holes: None,
            rims: None,
        }
    }
}

impl Directed {
    /// Sampled figures from the unit frame of a target with this diagonal.
    fn of_fit(figures: measure::Figures, diagonal: f64) -> Self {
        Self {
            figures: Figures::new(figures, diagonal, diagonal),
            samples: None,
            hausdorff_interval: None,
        }
    }
}

impl Figures {
    /// Figures in units of `unit` input units each, with a diagonal in input units.
    fn new(figures: measure::Figures, unit: f64, diagonal: f64) -> Self {
        let measure::Figures { max, mean, rms } = figures;
        let percent = 100.0 * unit / diagonal;
        Self {
            max: unit * max,
            mean: unit * mean,
            rms: unit * rms,
            max_percent: percent * max,
            mean_percent: percent * mean,
            rms_percent: percent * rms,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_and_percentages_agree() {
        let figures = |max| measure::Figures {
            max,
            mean: 0.5 * max,
            rms: 0.75 * max,
        };
        let error = SurfaceError {
            target_to_surface: figures(0.01),
            surface_to_target: figures(0.02),
            share_over_holes: 0.25,
            max_over_holes: 0.125,
            share_folded: 0.0,
        };
        let report = ErrorReport::of_fit(&error, 8.0);
        assert_eq!(report.hausdorff, 0.16);
        assert_eq!(
            [report.max_percent, report.mean_percent, report.rms_percent],
            [2.0, 1.0, 1.5]
        );
        assert_eq!(report.target_to_surface.figures.max, 0.08);
        assert_eq!(report.target_to_surface.figures.max_percent, 1.0);
        let holes = report.over_holes.unwrap();
        assert_eq!(
            [holes.area_percent, holes.max, holes.max_percent],
            [25.0, 1.0, 12.5]
        );
        let closed = SurfaceError {
            share_over_holes: 0.0,
            ..error
        };
        assert_eq!(ErrorReport::of_fit(&closed, 8.0).over_holes, None);
    }
}
