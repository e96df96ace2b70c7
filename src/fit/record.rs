//! What a recipe hands back: the surface, its iterations, and why it ended.

use crate::measure::Figures;
use crate::mesh::{ControlMesh, PolygonMesh};
use std::borrow::Cow;

/// One iteration of a phase.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Iteration {
    /// Counted from 1 through all phases.
    pub iteration: usize,
    /// The phase, as "voronoi", "polish" or "geometric".
    pub phase: Cow<'static, str>,
    /// Control points at the time.
    pub control_points: usize,
    /// The objective; in the polish the mean squared distance of the footpoints. Unit frame, squared.
    pub energy: f64,
    /// The terms that it is the sum of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub terms: Option<Terms>,
    /// The norm of its gradient on the control points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradient_norm: Option<f64>,
    /// The largest distance seen, in percent of the diagonal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_percent: Option<f64>,
    /// The root mean square distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms_percent: Option<f64>,
    /// The mean distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_percent: Option<f64>,
    /// Since the start of the fit.
    pub seconds: f64,
}

/// The terms of the objective.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Terms {
    /// F_T→S / A_T.
    pub target_to_surface: f64,
    /// F_S→T / A_T.
    pub surface_to_target: f64,
    /// λ R of surfaces.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub smoothness: f64,
    /// λ E_Ω of volumes.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub distortion: f64,
}

fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

/// Why a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StopReason {
    /// The asked tolerance is met.
    Tolerance,
    /// The whole schedule has run, each phase to stagnation or to its end.
    Schedule,
    /// The asked number of iterations is used up.
    Iterations,
    /// Nothing gets better any more.
    Stagnation,
    /// The most control points that were allowed are not enough for the asked tolerance.
    ControlPoints,
    /// Somebody asked to stop; the result is the best so far.
    Interrupted,
}

/// The result of a fit, in the unit frame.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The control mesh.
    pub control: ControlMesh,
    /// The fitted surface after all levels: quads for Catmull–Clark.
    pub surface: PolygonMesh,
    /// Every iteration.
    pub iterations: Vec<Iteration>,
    /// The distances of the data points from the limit surface, where they were all measured exactly (the geometric method); the largest is also that of the
    /// surface's boundary from the rims of the data.
    pub data_error: Option<Figures>,
    /// Seconds by stage, in the order they ran.
    pub stages: Vec<(String, f64)>,
    /// Why it ended.
    pub stop_reason: StopReason,
}
