//! The report of a run: as JSON, schema [`SCHEMA`], and as a [`page`] to look at.
//!
//! The JSON is stable: keys are added, never renamed, and a key that does not apply is absent. Lengths are in the input's units; keys in `_percent` are
//! in percent of the diagonal of the target's bounding box (for `compare`, of A's).

mod error;
pub mod feature_layers;
mod numbers;
pub mod page;
mod settings;

pub use error::{Directed, ErrorReport, Figures, OverHoles, RimReport};
pub use numbers::{count, significant};
pub use settings::{Settings, VolumeSettings};

use crate::benchmark::Row;
use crate::device::{Adapter, Device};
use crate::error::{Error, Result};
use crate::files::write_whole;
use crate::fit::{Iteration, StopReason, SubdivisionLevel};
use crate::template::shell::Shell;
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};
use std::path::Path;
use std::time::Instant;

/// What a report declares itself to be.
pub const SCHEMA: &str = "vorofit.report/1";

/// Everything that a run can say about itself; commands fill in what they have.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Always [`SCHEMA`].
    pub schema: &'static str,
    /// The command: "fit", "compare" and so on.
    pub command: &'static str,
    /// The program's version.
    pub version: &'static str,
    /// Where the kernels ran.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<DeviceReport>,
    /// What was asked for, defaults included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settings: Option<Settings>,
    /// The same for a volume, under the same key.
    #[serde(rename = "settings", skip_serializing_if = "Option::is_none")]
    pub volume_settings: Option<VolumeSettings>,
    /// The surface that was fitted to or, for `compare`, A.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<TargetReport>,
    /// The size of the result or, for `compare`, of B.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub result: Option<ResultReport>,
    /// The features that were found (`features`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub features: Option<FeatureReport>,
    /// How far they are apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<ErrorReport>,
    /// How good a fitted surface is to go on working with.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cage: Option<CageReport>,
    /// How good the elements of a volume were that has been optimized.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quality_before: Option<QualityReport>,
    /// How thick a shell has become.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shell: Option<ShellReport>,
    /// How good the elements of a volume are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quality: Option<QualityReport>,
    /// Every iteration of a fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<Vec<Iteration>>,
    /// Whether a fit met the asked tolerance or, where none was asked, ran to its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub converged: Option<bool>,
    /// Why a fit ended.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stop_reason: Option<StopReason>,
    /// The adapters of the machine (`devices`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapters: Option<Vec<Adapter>>,
    /// The kernels' times (`bench`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kernels: Option<Vec<Row>>,
    /// How long it took.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timing: Option<Timing>,
}

impl Report {
    /// A report of a command that says nothing else yet.
    pub fn new(command: &'static str) -> Self {
        Self {
            schema: SCHEMA,
            command,
            version: env!("CARGO_PKG_VERSION"),
            device: None,
            settings: None,
            volume_settings: None,
            target: None,
            result: None,
            features: None,
            error: None,
            cage: None,
            quality_before: None,
            shell: None,
            quality: None,
            iterations: None,
            converged: None,
            stop_reason: None,
            adapters: None,
            kernels: None,
            timing: None,
        }
    }

    /// As JSON, indented, with a line break at the end.
    ///
    /// # Errors
    /// None in practice: every key is a string and every number finite or written as null.
    pub fn to_json(&self) -> Result<String> {
        let mut text = serde_json::to_string_pretty(self)
            .map_err(|e| Error::input(format!("the report: {e}"), "report this as a defect"))?;
        text.push('\n');
        Ok(text)
    }

    /// Writes the JSON into a file, whole or not at all.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = self.to_json()?;
        write_whole(path, |out| out.write_all(text.as_bytes()))
    }
}

/// Where the kernels ran.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// "cpu", or the sort of adapter: "discrete", "integrated", "virtual", "software", "other".
    pub kind: String,
    /// As the driver calls it; for the CPU its threads.
    pub name: String,
    /// Vulkan, Metal or DX12.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backend: Option<String>,
    /// The driver and its version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub driver: Option<String>,
}

impl DeviceReport {
    /// The description of a device.
    pub fn of(device: &Device) -> Self {
        match device {
            Device::Cpu => Self {
                kind: "cpu".into(),
                name: match rayon::current_num_threads() {
                    1 => "1 thread".into(),
                    threads => format!("{threads} threads"),
                },
                backend: None,
                driver: None,
            },
            Device::Gpu(gpu) => Self::of_adapter(gpu.adapter()),
        }
    }

    /// The description of an adapter.
    pub fn of_adapter(adapter: &Adapter) -> Self {
        Self {
            kind: adapter.kind.to_string(),
            name: adapter.name.clone(),
            backend: Some(adapter.backend.clone()),
            driver: Some(adapter.driver.clone()),
        }
    }
}

impl std::fmt::Display for DeviceReport {
    /// In one line: "the CPU (2 threads)", "llvmpipe (software, Vulkan, Mesa 22.3.6)".
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.kind == "cpu" {
            return write!(f, "the CPU ({})", self.name);
        }
        write!(f, "{} ({}", self.name, self.kind)?;
        for part in [&self.backend, &self.driver].into_iter().flatten() {
            write!(f, ", {part}")?;
        }
        write!(f, ")")
    }
}

/// The size of the target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TargetReport {
    /// Vertices, referenced or not.
    pub vertices: usize,
    /// Faces as they are in the file.
    pub faces: usize,
    /// The diagonal of its bounding box: what percentages refer to.
    pub bbox_diagonal: f64,
}

/// The size of the result.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ResultReport {
    /// Control points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_points: Option<usize>,
    /// Faces of the control mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_faces: Option<usize>,
    /// Vertices of the dense surface; none of a volume.
    #[serde(skip_serializing_if = "is_zero")]
    pub surface_vertices: usize,
    /// Faces of the dense surface; none of a volume.
    #[serde(skip_serializing_if = "is_zero")]
    pub surface_faces: usize,
    /// Elements of a volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elements: Option<usize>,
    /// Their highest order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub order: Option<usize>,
    /// Nodes of a volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nodes: Option<usize>,
    /// What orders by need have saved of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adaptive: Option<AdaptiveReport>,
    /// The levels of a subdivision volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subdivision: Option<Vec<SubdivisionLevel>>,
}

/// A volume of orders by need.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AdaptiveReport {
    /// Nodes that there are. Files elevate all elements to one order and hold more.
    pub nodes: usize,
    /// Their share of those of a mesh whose every element has the highest order that was allowed.
    pub of_full_percent: f64,
}

/// How many features of each sort, and how strong.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureReport {
    /// The radius of the neighbourhoods, in percent of the diagonal.
    pub scale_percent: f64,
    /// Ridges by colour: red, blue, yellow, green.
    pub ridges: [LineReport; 4],
    /// Sharp edges, which are not counted among the ridges.
    pub sharp_edges: LineReport,
    /// Umbilics with three ridges.
    pub elliptic_umbilics: usize,
    /// Umbilics with one ridge.
    pub hyperbolic_umbilics: usize,
    /// Crossings of ridges, and corners of sharp edges.
    pub crossings: usize,
    /// Where ridges change between elliptic and hyperbolic.
    pub turning_points: usize,
    /// The points chosen for control points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sites: Option<SiteReport>,
}

/// Lines of a sort.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct LineReport {
    /// How many.
    pub count: usize,
    /// Their length in all, in input units.
    pub length: f64,
    /// Their strength in all.
    pub strength: f64,
}

/// The points chosen for control points, by what they are, and the thresholds that came of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct SiteReport {
    /// All of them.
    pub count: usize,
    /// Umbilics.
    pub umbilics: usize,
    /// Crossings.
    pub crossings: usize,
    /// Points along lines.
    pub on_lines: usize,
    /// Vertices that fill what is left.
    pub fill: usize,
    /// The least strength of a crossing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least_strength: Option<f64>,
    /// The least curvature of an umbilic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least_curvature: Option<f64>,
}

const fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// How good a fitted surface is to go on working with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CageReport {
    /// V − E + F of the control mesh.
    pub euler_characteristic: i64,
    /// The same of the target, where that is one connected manifold, closed or with boundaries that are followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_euler_characteristic: Option<i64>,
    /// The smallest angle of the control mesh, in degrees.
    pub least_angle: f64,
    /// The share of the dense surface that faces away from the target, in percent of what lies over it; absent where the target is a cloud of points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folded_percent: Option<f64>,
}

impl CageReport {
    /// Whether it has the handles and boundaries of its target, as far as is known.
    pub fn has_targets_topology(&self) -> bool {
        self.target_euler_characteristic
            .is_none_or(|target| target == self.euler_characteristic)
    }
}

/// How good the elements of a volume are.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct QualityReport {
    /// The mean over the elements of their mean scaled Jacobians.
    pub scaled_jacobian_mean: f64,
    /// The least scaled Jacobian of all samples.
    pub scaled_jacobian_min: f64,
    /// Elements whose Jacobian is not positive somewhere.
    pub invalid: usize,
    /// Elements of which it is not known.
    pub undecided: usize,
}

/// How thick a shell has become, from its far sides to the surface; `_percent` is of the distance asked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ShellReport {
    /// The distance asked for, in input units.
    pub distance: f64,
    /// The least thickness.
    pub min_percent: f64,
    /// The mean thickness.
    pub mean_percent: f64,
    /// The largest thickness.
    pub max_percent: f64,
    /// The share of vertices over which there was no room for all of it, in percent.
    pub shortened_percent: f64,
    /// Elements with faces on the boundary that cross others, where not both are faces of the surface.
    pub crossing: usize,
    /// Triangles of the surface that cross each other.
    pub surface_crossing: usize,
}

impl ShellReport {
    /// The figures of a shell for which this distance was asked.
    pub fn of(shell: &Shell, distance: f64) -> Self {
        Self {
            distance,
            min_percent: 100.0 * shell.thickness.min,
            mean_percent: 100.0 * shell.thickness.mean,
            max_percent: 100.0 * shell.thickness.max,
            shortened_percent: 100.0 * shell.shortened,
            crossing: shell.crossing,
            surface_crossing: shell.surface_crossing,
        }
    }
}

/// Seconds by stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Timing {
    /// From the start of the command to its report.
    pub total_s: f64,
    /// In the order that they ran, as an object; stages of one name are added.
    #[serde(serialize_with = "as_object")]
    pub stages: Vec<(String, f64)>,
}

fn as_object<S: Serializer>(stages: &[(String, f64)], serializer: S) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(stages.len()))?;
    for (name, seconds) in stages {
        map.serialize_entry(name, seconds)?;
    }
    map.end()
}

/// Measures the stages of a command.
#[derive(Debug)]
pub struct Stopwatch {
    started: Instant,
    stage: Instant,
    stages: Vec<(String, f64)>,
}

impl Stopwatch {
    /// Starts the first stage.
    pub fn start() -> Self {
        let now = Instant::now();
        Self {
            started: now,
            stage: now,
            stages: Vec::new(),
        }
    }

    /// Ends a stage and starts the next one.
    pub fn lap(&mut self, name: &str) {
        self.laps([(name.into(), self.stage.elapsed().as_secs_f64())]);
    }

    /// Ends some stages that have been measured elsewhere, and starts the next one.
    pub fn laps(&mut self, stages: impl IntoIterator<Item = (String, f64)>) {
        for (name, seconds) in stages {
            match self.stages.iter_mut().find(|(known, _)| *known == name) {
                Some((_, sum)) => *sum += seconds,
                None => self.stages.push((name, seconds)),
            }
        }
        self.stage = Instant::now();
    }

    /// What has been measured until now.
    pub fn timing(&self) -> Timing {
        Timing {
            total_s: self.started.elapsed().as_secs_f64(),
            stages: self.stages.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_keys_are_absent_and_stages_keep_their_order() {
        let mut stopwatch = Stopwatch::start();
        stopwatch.lap("write");
        stopwatch.laps([
            ("polish".into(), 1.5),
            ("read".into(), 2.0),
            ("polish".into(), 0.5),
        ]);
        let mut report = Report::new("fit");
        report.timing = Some(stopwatch.timing());
        report.device = Some(DeviceReport::of(&Device::Cpu));
        let text = report.to_json().unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        let keys: Vec<_> = json
            .as_object()
            .unwrap()
            .keys()
            .map(String::as_str)
            .collect();
        assert_eq!(keys, ["command", "device", "schema", "timing", "version"]);
        assert!(json["device"].get("backend").is_none());
        assert_eq!(json["timing"]["stages"]["polish"], 2.0);
        let place = |stage: &str| text.find(stage).unwrap();
        assert!(
            place("\"write\"") < place("\"polish\"") && place("\"polish\"") < place("\"read\"")
        );
    }
}
