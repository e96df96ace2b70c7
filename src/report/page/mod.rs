//! The page of a fit: one HTML file that shows it in three dimensions and says how good it is, with the pictures as files beside it.
//!
//! The file holds everything that it shows and fetches nothing, which its own content security policy enforces, so it works from a disk, an
//! archive or a mail. The view (`view.js`) is WebGL 2 without a library; where there is none, the pictures take its place. Charts and tables are plain
//! SVG and HTML, made here. The numbers are those of the report, which is in the page as JSON.

mod chart;
mod scene;
mod tables;
mod template;
mod thin;

use super::feature_layers::{FeatureLayer, point_layers, ridge_layers};
use super::{Report, count};
use crate::device::Device;
use crate::error::{Error, Result};
use crate::features::{self, Features};
use crate::files::{check_place, write_whole};
use crate::measure;
use crate::mesh::{PolygonMesh, TriangleMesh};
use crate::picture::{Axis, Legend, Paint, Picture, Scale, Scene, Shape, Strokes, View, color};
use crate::topology;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use chart::{Weighted, quantile};
use std::fmt::Write;
use std::io::Read;
use std::path::Path;
use template::{escaped, fill, json_in_script};

/// The file to open.
pub const PAGE: &str = "index.html";
/// By this a page is known to be one of ours, and may be replaced.
const MARK: &str = "<meta name=\"generator\" content=\"vorofit\">";

const HTML: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("view.js");

/// The pictures: file and caption.
const PICTURES: [(&str, &str); 3] = [
    (
        "target.png",
        "The scan; where it has faces, with its ridges by colour, its umbilics and crossings",
    ),
    ("cage.png", "The control cage"),
    (
        "surface.png",
        "The fitted surface, coloured by its distance to the scan",
    ),
];
/// Width and height of the pictures.
const SIZE: [u32; 2] = [1200, 900];
/// The share of the distances that the colours tell apart: the few largest would make all others look alike.
const COLORED: f64 = 0.99;
/// The width of a cage's edges and of a cloud's points, in pixels.
const LINE_WIDTH: f64 = 1.6;
const POINT_WIDTH: f64 = 2.6;

/// What a page shows, all in the unit frame of the target.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// What the target is called.
    pub name: &'a str,
    /// The scan; points where it has no triangles.
    pub target: &'a TriangleMesh,
    /// The control mesh.
    pub cage: &'a PolygonMesh,
    /// The dense fitted surface.
    pub surface: &'a PolygonMesh,
    /// `[surface vertices]`: from the target, if it has triangles.
    pub distances: Option<&'a [f64]>,
    /// `[surface vertices]`: whether they lie over the target rather than over one of its holes; empty where there are no distances.
    pub covered: &'a [bool],
    /// What is upwards in the pictures.
    pub up: Axis,
}

/// A page that has been drawn, but for the numbers of the report.
pub struct Page {
    title: String,
    /// PNG files, in the order of [`PICTURES`].
    pictures: [Vec<u8>; 3],
    scene: String,
    legend: String,
    histogram: String,
    thinned: String,
}

/// Refuses a folder that a page could not be written into, or that holds files of the page's names that are not from a page: to be asked before the
/// work.
///
/// # Errors
/// See above.
pub fn check_folder(folder: &Path) -> Result<()> {
    if !folder.exists() {
        let above = folder.ancestors().skip(1).find(|path| path.exists());
        return check_place(&above.unwrap_or(Path::new("")).join(PAGE));
    }
    let refuse = |path: &Path, problem: &str| {
        Err(Error::file(
            path,
            "report",
            problem,
            "give the name of a new folder",
        ))
    };
    if !folder.is_dir() {
        return refuse(folder, "it exists and is not a folder");
    }
    let ours = is_ours(&folder.join(PAGE));
    for name in PICTURES.iter().map(|(name, _)| *name).chain([PAGE]) {
        let path = folder.join(name);
        if path.exists() && !ours {
            return refuse(&path, "it exists and is not from a report of this program");
        }
        check_place(&path)?;
    }
    Ok(())
}

fn is_ours(page: &Path) -> bool {
    let mut start = Vec::new();
    let read = std::fs::File::open(page).and_then(|file| file.take(4096).read_to_end(&mut start));
    read.is_ok()
        && start
            .windows(MARK.len())
            .any(|window| window == MARK.as_bytes())
}

impl Page {
    /// Measures what is left to measure, finds the features of the target, draws the pictures and packs the geometry.
    ///
    /// # Errors
    /// Where the target or the surface has no extent, or the device fails.
    pub fn new(device: &Device, subject: &Subject<'_>) -> Result<Self> {
        let surface = subject.surface.triangulate();
        let features = feature_layers(device, subject.target)?;
        let coloring = Coloring::new(subject, &surface);
        let values = coloring.as_ref().map(|c| c.values.as_slice());
        let parts = scene::Parts {
            target: subject.target,
            features: &features,
            cage: subject.cage,
            surface: &surface,
            values,
            up: subject.up,
        };
        let scene = serde_json::to_string(&scene::Scene::new(&parts))
            .map_err(|e| Error::input(format!("the page: {e}"), "report this as a defect"))?;
        let size = [
            subject.target.triangles.len(),
            subject.target.positions.len(),
        ];
        let shown = if size[0] > 0 { size[0] } else { size[1] };
        let legend = coloring.as_ref().map(|c| (&c.legend, c.has_unknown()));
        let points = subject.cage.positions.len();
        Ok(Self {
            title: format!("{} from {} control points", subject.name, count(points)),
            pictures: pictures(subject, features, &surface, coloring.as_ref())?,
            scene,
            legend: legend.map_or(String::new(), |(legend, holes)| {
                tables::legend(legend, holes)
            }),
            histogram: histogram(subject, &surface, coloring.as_ref())?,
            thinned: match shown > scene::LIMIT {
                true => " The scan is shown with less detail than it has.".into(),
                false => String::new(),
            },
        })
    }

    /// Writes `index.html` and the pictures into a folder, which is made where it is missing; each file whole or not at all. `command` repeats
    /// the run.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn write(&self, folder: &Path, report: &Report, command: &str) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        for ((name, _), bytes) in PICTURES.iter().zip(&self.pictures) {
            write_whole(&folder.join(name), |out| out.write_all(bytes))?;
        }
        let html = self.html(report, command)?;
        write_whole(&folder.join(PAGE), |out| out.write_all(html.as_bytes()))
    }

    fn html(&self, report: &Report, command: &str) -> Result<String> {
        let mut figures = String::new();
        for ((name, caption), bytes) in PICTURES.iter().zip(&self.pictures) {
            let data = BASE64_STANDARD.encode(bytes);
            let _ = writeln!(
                figures,
                "<figure><img alt=\"{name}\" src=\"data:image/png;base64,{data}\"><figcaption>{caption}</figcaption></figure>"
            );
        }
        let iterations = report.iterations.as_deref().unwrap_or_default();
        let values: [(&str, &str); 16] = [
            ("title", &escaped(&self.title)),
            ("version", &escaped(report.version)),
            ("style", STYLE),
            ("legend", &self.legend),
            ("thinned", &self.thinned),
            ("pictures", &figures),
            ("headline", &tables::headline(report)),
            ("figures", &tables::figures(report)),
            ("histogram", &self.histogram),
            ("convergence", &chart::convergence(iterations)),
            ("settings", &tables::settings(report)),
            ("run", &tables::run(report)),
            ("command", &escaped(command)),
            ("report", &json_in_script(&report.to_json()?)),
            ("scene", &json_in_script(&self.scene)),
            ("script", SCRIPT),
        ];
        Ok(fill(HTML, &values))
    }
}

/// The colours of a surface by its distance.
struct Coloring {
    /// `[surface vertices]`: shares of the colour map, negative over holes.
    values: Vec<f64>,
    legend: Legend,
}

impl Coloring {
    /// None for a target of points, which a surface has no distance from in between.
    fn new(subject: &Subject<'_>, surface: &TriangleMesh) -> Option<Self> {
        let distances = subject.distances?;
        let covered = subject.covered;
        let known: Weighted = weighted(surface, distances)
            .into_iter()
            .zip(covered)
            .filter_map(|(pair, covered)| covered.then_some(pair))
            .collect();
        let scale = Scale::up_to(quantile(&known, COLORED));
        let shares = distances.iter().zip(covered);
        Some(Self {
            values: shares
                .map(|(distance, covered)| match covered {
                    true => 100.0 * distance / scale.top,
                    false => -1.0,
                })
                .collect(),
            legend: Legend {
                title: "% of the diagonal".into(),
                exceeded: known.iter().any(|(percent, _)| *percent > scale.top),
                scale,
            },
        })
    }

    fn has_unknown(&self) -> bool {
        self.values.iter().any(|value| *value < 0.0)
    }
}

/// Distances at the vertices of a mesh in percent, by a third of the area around each; all alike for points.
fn weighted(mesh: &TriangleMesh, distances: &[f64]) -> Weighted {
    let mut weights = vec![if mesh.triangles.is_empty() { 1.0 } else { 0.0 }; distances.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let area = mesh.area_vector(t).length();
        for &v in corners {
            weights[v as usize] += area;
        }
    }
    distances.iter().map(|d| 100.0 * d).zip(weights).collect()
}

/// Both ways; over holes the surface is not counted.
fn histogram(
    subject: &Subject<'_>,
    surface: &TriangleMesh,
    coloring: Option<&Coloring>,
) -> Result<String> {
    let forth = measure::distances(surface, &subject.target.positions)?;
    let mut series = vec![("scan to surface", weighted(subject.target, &forth))];
    if let (Some(coloring), Some(distances)) = (coloring, subject.distances) {
        let all = weighted(surface, distances)
            .into_iter()
            .zip(&coloring.values);
        let covered = all
            .filter(|(_, value)| **value >= 0.0)
            .map(|(pair, _)| pair);
        series.push(("surface to scan", covered.collect()));
    }
    Ok(chart::histogram(&series))
}

/// The features of a target with faces; of one that is shown with less detail, those of what is shown.
fn feature_layers(device: &Device, target: &TriangleMesh) -> Result<Vec<FeatureLayer>> {
    let (mesh, _) = thin::thinned(target, scene::LIMIT);
    let mesh = topology::oriented(&topology::cleaned(&mesh));
    if mesh.triangles.is_empty() {
        return Ok(Vec::new());
    }
    let features = Features::find(device, &mesh, features::Scale::Automatic)?;
    let layers = ridge_layers(&features).into_iter();
    Ok(layers.chain(point_layers(&features)).collect())
}

fn pictures(
    subject: &Subject<'_>,
    features: Vec<FeatureLayer>,
    surface: &TriangleMesh,
    coloring: Option<&Coloring>,
) -> Result<[Vec<u8>; 3]> {
    let view = View::with_up(subject.up);
    let draw = |scene: &Scene<'_>| Picture::draw(scene, &view, SIZE).png();
    let target = Shape::smooth(subject.target);
    let mut scan = Scene::default();
    match subject.target.triangles.is_empty() {
        true => scan.strokes.push(Strokes {
            segments: subject.target.positions.iter().map(|&p| [p, p]).collect(),
            color: color::INK,
            width: POINT_WIDTH,
        }),
        false => scan.surfaces.push((&target, Paint::Plain(color::TARGET))),
    }
    let lines = features.into_iter().flat_map(|layer| layer.strokes);
    scan.strokes.extend(lines);
    let faces = Shape::faceted(subject.cage);
    let cage = Scene {
        surfaces: vec![(&faces, Paint::Plain(color::CAGE))],
        strokes: vec![Strokes::edges(subject.cage, LINE_WIDTH)],
        legend: None,
    };
    let shape = Shape::smooth(surface);
    let paint = match coloring {
        Some(coloring) => Paint::Values(&coloring.values),
        None => Paint::Plain(color::CAGE),
    };
    let fitted = Scene {
        surfaces: vec![(&shape, paint)],
        strokes: Vec::new(),
        legend: coloring.map(|c| c.legend.clone()),
    };
    Ok([draw(&scan)?, draw(&cage)?, draw(&fitted)?])
}
