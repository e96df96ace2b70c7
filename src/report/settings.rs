//! What a fit was asked for.

use crate::fit::{self, geometric};
use crate::mesh::Scheme;
use crate::model::element::{Basis, Rule};
use crate::topology::Holes;
use serde::Serialize;

/// The settings of a fit, defaults included, in the words of the command line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Settings {
    /// "vsdm", "geometric" or "interpolate".
    pub method: &'static str,
    /// "bbox", "torus", "simplify", "ridges", "adaptive", or the file.
    pub template: String,
    /// Control points asked for; absent where the template has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_points: Option<usize>,
    /// What becomes of the target's holes: "bridge" or "follow".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub holes: Option<Holes>,
    /// "catmull-clark", "loop" or "polygon".
    pub scheme: &'static str,
    /// Subdivisions from control mesh to surface vertices.
    pub levels: usize,
    /// Whether the surface vertices lie on the limit surface.
    pub limit: bool,
    /// The smoothness weight λ.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smoothness: Option<f64>,
    /// The normal anisotropy s, where one was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub anisotropy: Option<f64>,
    /// Whether least squares finish the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub polish: Option<bool>,
    /// How the geometric method moves control points: "displacement" or "least-squares".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<&'static str>,
    /// How often the edges of the template are halved before interpolation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinements: Option<usize>,
    /// Points spread over the target that are fitted to, where not its vertices.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<usize>,
    /// Control points at most.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_control_points: Option<usize>,
    /// The largest error to reach, in percent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_error_percent: Option<f64>,
    /// The mean error to reach, in percent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_error_percent: Option<f64>,
    /// Iterations allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// The share of the target that may be ignored, in percent, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outliers_percent: Option<f64>,
    /// The seed of all sampling.
    pub seed: u64,
}

impl Settings {
    /// The settings of a fit by Voronoi squared distances with a template of this name.
    pub fn new(
        template: String,
        control_points: Option<usize>,
        holes: Holes,
        options: &fit::Options,
    ) -> Self {
        Self {
            method: "vsdm",
            template,
            control_points,
            holes: Some(holes),
            scheme: match options.scheme {
                Scheme::CatmullClark => "catmull-clark",
                Scheme::Loop => "loop",
                Scheme::Polygon => "polygon",
            },
            levels: options.levels,
            limit: options.limit,
            smoothness: Some(options.smoothness),
            anisotropy: options.anisotropy,
            polish: Some(options.polish),
            step: None,
            refinements: None,
            samples: None,
            max_control_points: None,
            max_error_percent: percent(options.max_error),
            mean_error_percent: percent(options.mean_error),
            iterations: options.iterations,
            outliers_percent: percent((options.outliers > 0.0).then_some(options.outliers)),
            seed: options.seed,
        }
    }

    /// The settings of a fit by the geometric algorithm with a template of this name.
    pub fn of_geometric(
        template: String,
        control_points: Option<usize>,
        options: &geometric::Options,
        samples: Option<usize>,
        seed: u64,
    ) -> Self {
        Self {
            step: Some(match options.step {
                geometric::Step::Displacement => "displacement",
                geometric::Step::LeastSquares => "least-squares",
            }),
            samples,
            max_control_points: options.max_control_points,
            max_error_percent: percent(options.max_error),
            mean_error_percent: percent(options.mean_error),
            iterations: options.iterations,
            ..Self::of_loop("geometric", template, control_points, options.levels, seed)
        }
    }

    /// The settings of an interpolation of a template of this name.
    pub fn of_interpolation(
        template: String,
        control_points: Option<usize>,
        options: fit::Interpolation,
        seed: u64,
    ) -> Self {
        Self {
            refinements: Some(options.refinements),
            ..Self::of_loop(
                "interpolate",
                template,
                control_points,
                options.levels,
                seed,
            )
        }
    }

    /// What methods that make Loop surfaces on their limit have in common.
    fn of_loop(
        method: &'static str,
        template: String,
        control_points: Option<usize>,
        levels: usize,
        seed: u64,
    ) -> Self {
        Self {
            method,
            template,
            control_points,
            holes: None,
            scheme: "loop",
            levels,
            limit: true,
            smoothness: None,
            anisotropy: None,
            polish: None,
            step: None,
            refinements: None,
            samples: None,
            max_control_points: None,
            max_error_percent: None,
            mean_error_percent: None,
            iterations: None,
            outliers_percent: None,
            seed,
        }
    }
}

fn percent(share: Option<f64>) -> Option<f64> {
    share.map(|share| 100.0 * share)
}

/// The settings of a volume fit, defaults included, in the words of the command line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VolumeSettings {
    /// "grid:AxBxC", "ball:N", or the file.
    pub template: String,
    /// The order of the elements.
    pub order: usize,
    /// Whether that is only the highest, where it is needed.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub adaptive: bool,
    /// Where raises end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_error_percent: Option<f64>,
    /// Whether the target was taken as points.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub point_cloud: bool,
    /// "mlca" for a subdivision volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subdivision: Option<&'static str>,
    /// Its levels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub levels: Option<u8>,
    /// From which angle on its control mesh is sharp.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sharp_degrees: Option<f64>,
    /// "legendre" or "fourier".
    pub basis: &'static str,
    /// The name of the density.
    pub distortion: &'static str,
    /// "gauss" or "trapezoid".
    pub quadrature: &'static str,
    /// λ from afar and at the end.
    pub smoothness: [f64; 2],
    /// Iterations allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// The seed of all sampling.
    pub seed: u64,
}

impl VolumeSettings {
    /// The settings of a fit with a template of this name.
    pub fn new(template: String, options: &fit::VolumeOptions) -> Self {
        Self {
            template,
            order: options.order,
            adaptive: options.adaptive.is_some(),
            max_error_percent: percent(options.adaptive.and_then(|a| a.max_error)),
            point_cloud: false,
            subdivision: None,
            levels: None,
            sharp_degrees: None,
            basis: match options.basis {
                Basis::Legendre => "legendre",
                Basis::Fourier => "fourier",
            },
            distortion: options.distortion.name(),
            quadrature: match options.rule {
                Rule::Gauss => "gauss",
                Rule::Trapezoid => "trapezoid",
            },
            smoothness: [options.far, options.close],
            iterations: options.iterations,
            seed: options.seed,
        }
    }
}
