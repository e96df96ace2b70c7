//! The report of `vorofit volume` in words.

use super::Args;
use crate::cli::text::{INTERRUPTED, Summary, count, significant};
use vorofit::fit::StopReason;
use vorofit::report::Report;

impl Args {
    /// The report in words.
    pub(super) fn summary(&self, report: &Report) -> String {
        let mut summary = Summary::default();
        if let Some(result) = &report.result {
            let of = |n: Option<usize>| count(n.unwrap_or_default());
            for path in &self.output {
                summary.line(
                    "wrote",
                    format!(
                        "{}   {} elements of order {}, {} nodes",
                        path.display(),
                        of(result.elements),
                        of(result.order),
                        of(result.nodes)
                    ),
                );
            }
            for path in &self.control {
                let points = of(result.control_points);
                summary.line(
                    "wrote",
                    format!("{}   {points} control points", path.display()),
                );
            }
            for level in result.subdivision.iter().flatten() {
                let [max, rms] = [level.max_percent, level.rms_percent].map(|x| significant(x, 3));
                summary.line(
                    "level",
                    format!(
                        "{} control points, {} elements: largest {max} %, rms {rms} %",
                        count(level.control_points),
                        count(level.elements)
                    ),
                );
            }
            if let Some(adaptive) = &result.adaptive {
                let share = significant(adaptive.of_full_percent, 3);
                let kept = count(adaptive.nodes);
                let full = format!("a full mesh of order {}", self.order);
                summary.line(
                    "kept",
                    format!("{kept} nodes, {share} % of those of {full}"),
                );
            }
        }
        for path in &self.surface {
            summary.line(
                "wrote",
                format!("{}   the boundary with its error", path.display()),
            );
        }
        if let Some(error) = &report.error {
            let [max, rms, mean] = [error.max_percent, error.rms_percent, error.mean_percent]
                .map(|x| significant(x, 3));
            let of = "of the bounding box's diagonal";
            summary.line(
                "error",
                format!("largest {max} %, rms {rms} %, mean {mean} % {of}"),
            );
        }
        if let Some(quality) = &report.quality {
            let result = report.result.as_ref();
            let elements = result.and_then(|r| r.elements).unwrap_or_default();
            summary.quality("quality", elements, quality);
        }
        let why = match report.stop_reason {
            Some(StopReason::Interrupted) => INTERRUPTED,
            Some(StopReason::Iterations) => "stopped at the iterations allowed",
            Some(StopReason::Tolerance) => "the error asked for is met",
            _ => "ran to the end",
        };
        let seconds = report.timing.as_ref().map_or(0.0, |timing| timing.total_s);
        let iterations = report.iterations.as_ref().map_or(0, Vec::len);
        summary.line(
            "time",
            format!("{seconds:.1} s, {} iterations; {why}", count(iterations)),
        );
        summary.text()
    }
}
