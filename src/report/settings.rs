//! What a fit was asked for.

use crate::fit;
use crate::mesh::Scheme;
use serde::Serialize;

/// The settings of a fit, defaults included, in the words of the command line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Settings {
    /// "bbox", "torus", or the file.
    pub template: String,
    /// Control points asked for; absent where the template has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_points: Option<usize>,
    /// "catmull-clark", "loop" or "polygon".
    pub scheme: &'static str,
    /// Subdivisions from control mesh to surface vertices.
    pub levels: usize,
    /// Whether the surface vertices lie on the limit surface.
    pub limit: bool,
    /// The smoothness weight λ.
    pub smoothness: f64,
    /// The normal anisotropy s, where one was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub anisotropy: Option<f64>,
    /// Whether least squares finish the fit.
    pub polish: bool,
    /// The largest error to reach, in percent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_error_percent: Option<f64>,
    /// The mean error to reach, in percent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_error_percent: Option<f64>,
    /// Iterations allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// The seed of all sampling.
    pub seed: u64,
}

impl Settings {
    /// The settings of a fit with a template of this name.
    pub fn new(template: String, control_points: Option<usize>, options: &fit::Options) -> Self {
        let percent = |share: Option<f64>| share.map(|share| 100.0 * share);
        Self {
            template,
            control_points,
            scheme: match options.scheme {
                Scheme::CatmullClark => "catmull-clark",
                Scheme::Loop => "loop",
                Scheme::Polygon => "polygon",
            },
            levels: options.levels,
            limit: options.limit,
            smoothness: options.smoothness,
            anisotropy: options.anisotropy,
            polish: options.polish,
            max_error_percent: percent(options.max_error),
            mean_error_percent: percent(options.mean_error),
            iterations: options.iterations,
            seed: options.seed,
        }
    }
}
