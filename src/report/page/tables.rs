//! The numbers of a report as HTML. A cell names its key in the JSON (`data-key`), so that the page can be held to it.

use super::template::escaped;
use crate::picture::{Legend, color};
use crate::report::{Directed, Figures, Report, count, significant};
use serde_json::Value;
use std::fmt::Write;

/// Digits of distances.
const DIGITS: usize = 3;
/// Colours of the legend's gradient.
const STOPS: usize = 24;

/// The figures that say it all.
pub(super) fn headline(report: &Report) -> String {
    let mut items = String::new();
    let mut item = |key: &str, number: String, unit: &str, name: &str| {
        let _ = writeln!(
            items,
            "<li><b><span data-key=\"{key}\">{number}</span> <small>{unit}</small></b><span>{name}</span></li>"
        );
    };
    if let Some(error) = &report.error {
        let figures = [
            ("max_percent", error.max_percent, "largest distance"),
            ("rms_percent", error.rms_percent, "root mean square"),
            ("mean_percent", error.mean_percent, "mean distance"),
        ];
        for (key, percent, name) in figures {
            item(
                &format!("error.{key}"),
                significant(percent, DIGITS),
                "%",
                name,
            );
        }
    }
    if let Some(points) = report.result.as_ref().and_then(|r| r.control_points) {
        item("result.control_points", count(points), "", "control points");
    }
    if let Some(timing) = &report.timing {
        item(
            "timing.total_s",
            significant(timing.total_s, DIGITS),
            "s",
            "from start to end",
        );
    }
    items
}

/// The distances both ways, in percent and in units, with what is known of holes.
pub(super) fn figures(report: &Report) -> String {
    let Some(error) = &report.error else {
        return String::new();
    };
    let directions: Vec<(&str, &str, &Directed)> = [
        (
            "target_to_surface",
            "scan to surface",
            Some(&error.target_to_surface),
        ),
        (
            "surface_to_target",
            "surface to scan",
            error.surface_to_target.as_ref(),
        ),
        (
            "data_to_limit",
            "data points to limit",
            error.data_to_limit.as_ref(),
        ),
    ]
    .into_iter()
    .filter_map(|(key, name, directed)| Some((key, name, directed?)))
    .collect();
    let mut html = String::from("<table>\n<tr><th></th>");
    for (_, name, _) in &directions {
        let _ = write!(html, "<th>{name}</th>");
    }
    type Figure = fn(&Figures) -> f64;
    let rows: [(&str, &str, Figure); 6] = [
        ("largest, %", "max_percent", |f| f.max_percent),
        ("root mean square, %", "rms_percent", |f| f.rms_percent),
        ("mean, %", "mean_percent", |f| f.mean_percent),
        ("largest, in the scan's units", "max", |f| f.max),
        ("root mean square", "rms", |f| f.rms),
        ("mean", "mean", |f| f.mean),
    ];
    for (name, key, figure) in rows {
        let _ = write!(html, "</tr>\n<tr><th>{name}</th>");
        for (direction, _, directed) in &directions {
            let number = significant(figure(&directed.figures), DIGITS);
            let _ = write!(
                html,
                "<td data-key=\"error.{direction}.{key}\">{number}</td>"
            );
        }
    }
    html += "</tr>\n</table>\n<p class=\"note\">Percentages are of the diagonal of the scan's bounding box";
    if let Some(target) = &report.target {
        let diagonal = significant(target.bbox_diagonal, 6);
        let _ = write!(
            html,
            ", <span data-key=\"target.bbox_diagonal\" data-digits=\"6\">{diagonal}</span> units"
        );
    }
    html += ". ";
    if let Some(holes) = &error.over_holes {
        let _ = write!(
            html,
            "<span data-key=\"error.over_holes.area_percent\">{}</span> % of the surface spans holes of the scan or lies beyond its rim, at most \
             <span data-key=\"error.over_holes.max_percent\">{}</span> % from it; that part is not counted in the table.",
            significant(holes.area_percent, DIGITS),
            significant(holes.max_percent, DIGITS)
        );
    } else if error.surface_to_target.is_some() {
        html += "The scan covers all of the surface.";
    }
    if let Some(rims) = &error.rims {
        let [there, back] = [rims.target_to_surface, rims.surface_to_target];
        let _ = write!(
            html,
            " Boundary curves are followed: from the scan's at most <span data-key=\"error.rims.target_to_surface.max_percent\">{}</span> %, from the \
             surface's at most <span data-key=\"error.rims.surface_to_target.max_percent\">{}</span> %.",
            significant(there.max_percent, DIGITS),
            significant(back.max_percent, DIGITS)
        );
    }
    html + "</p>"
}

/// Everything that was asked for.
pub(super) fn settings(report: &Report) -> String {
    let value = serde_json::to_value(&report.settings).unwrap_or_default();
    let mut rows = Rows::default();
    for (key, value) in value.as_object().into_iter().flatten() {
        let text = match value {
            Value::String(text) => text.clone(),
            Value::Bool(on) => if *on { "on" } else { "off" }.into(),
            other => other.to_string(),
        };
        rows.push(&key.replace('_', " "), &text);
    }
    rows.table()
}

/// Where it ran, on what, how it ended and how long each stage took.
pub(super) fn run(report: &Report) -> String {
    let mut rows = Rows::default();
    if let Some(device) = &report.device {
        rows.push("device", &device.to_string());
    }
    if let Some(target) = &report.target {
        let size = format!(
            "{} vertices, {} faces",
            count(target.vertices),
            count(target.faces)
        );
        rows.push("scan", &size);
    }
    if let Some(result) = &report.result {
        let control = [result.control_points, result.control_faces].map(Option::unwrap_or_default);
        rows.push(
            "control mesh",
            &format!("{} points, {} faces", count(control[0]), count(control[1])),
        );
        let surface = format!(
            "{} vertices, {} faces",
            count(result.surface_vertices),
            count(result.surface_faces)
        );
        rows.push("surface", &surface);
    }
    if let Some(cage) = &report.cage {
        let scan = match cage.target_euler_characteristic {
            Some(scan) if !cage.has_targets_topology() => format!(", the scan's is {scan}"),
            Some(_) => ", as the scan's".into(),
            None => String::new(),
        };
        let euler = format!("{}{scan}", cage.euler_characteristic);
        rows.push("Euler characteristic", &euler);
        let angle = significant(cage.least_angle, DIGITS);
        rows.push("smallest angle of the cage", &format!("{angle}°"));
        if let Some(percent) = cage.folded_percent {
            let folded = format!("{} %", significant(percent, DIGITS));
            rows.push("flipped part of the surface", &folded);
        }
    }
    if let Some(iterations) = &report.iterations {
        rows.push("iterations", &count(iterations.len()));
    }
    if let Ok(Value::String(reason)) = serde_json::to_value(report.stop_reason) {
        rows.push("ended by", &reason.replace('_', " "));
    }
    for (stage, seconds) in report.timing.iter().flat_map(|timing| &timing.stages) {
        rows.push(stage, &format!("{seconds:.2} s"));
    }
    rows.table()
}

/// Names with their values.
#[derive(Default)]
struct Rows(String);

impl Rows {
    fn push(&mut self, name: &str, value: &str) {
        let (name, value) = (escaped(name), escaped(value));
        let _ = writeln!(self.0, "<tr><th>{name}</th><td>{value}</td></tr>");
    }

    fn table(self) -> String {
        format!("<table>\n{}</table>", self.0)
    }
}

/// The bar of colours beside the view.
pub(super) fn legend(legend: &Legend, with_unknown: bool) -> String {
    let stop = |k: usize| {
        let [r, g, b] = color::map(k as f64 / STOPS as f64);
        format!("rgb({r} {g} {b})")
    };
    let stops: Vec<_> = (0..=STOPS).map(stop).collect();
    let mut html = format!(
        "<div id=\"legend\" hidden>\n<div class=\"title\">distance to the scan, {}</div>\n<div class=\"bar\" style=\"background: linear-gradient(to top, {})\">",
        escaped(&legend.title),
        stops.join(", ")
    );
    for (value, label) in legend.labels() {
        let at = 100.0 * value / legend.scale.top;
        let _ = write!(html, "<span style=\"bottom: {at:.2}%\">{label}</span>");
    }
    html += "</div>\n";
    if with_unknown {
        html += "<p class=\"unknown\"><i></i>over holes</p>\n";
    }
    html + "</div>"
}
