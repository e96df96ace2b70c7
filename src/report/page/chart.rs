//! Charts as SVG, coloured by the style sheet of the page.

use super::template::escaped;
use crate::fit::Iteration;
use crate::picture::Scale;
use crate::report::count;
use std::fmt::Write;

/// A drawing with room for labels around its plot.
struct Chart {
    width: f64,
    height: f64,
    svg: String,
}

const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 26.0;
const BOTTOM: f64 = 42.0;
/// A letter is about as wide.
const LETTER: f64 = 7.0;
/// Bars of a histogram.
const BARS: usize = 40;
/// The share of a histogram's weight that its axis holds.
const SHOWN: f64 = 0.995;
/// Series of a chart, in the order of the style sheet's classes.
const CLASSES: [&str; 4] = ["first", "second", "third", "fourth"];

impl Chart {
    fn new([width, height]: [f64; 2], label: &str) -> Self {
        let svg = format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\">\n",
            escaped(label)
        );
        Self { width, height, svg }
    }

    /// The place of shares of the plot's width and height, from the lower left.
    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let (width, height) = (self.width - LEFT - RIGHT, self.height - TOP - BOTTOM);
        [LEFT + x * width, self.height - BOTTOM - y * height]
    }

    fn path(&mut self, class: &str, points: impl IntoIterator<Item = [f64; 2]>, close: bool) {
        let mut data = String::new();
        for (k, [x, y]) in points.into_iter().enumerate() {
            let [x, y] = self.at(x, y);
            let _ = write!(data, "{}{x:.1} {y:.1}", if k == 0 { 'M' } else { 'L' });
        }
        let end = if close { "Z" } else { "" };
        let _ = writeln!(self.svg, "<path class=\"{class}\" d=\"{data}{end}\"/>");
    }

    fn text(&mut self, class: &str, [x, y]: [f64; 2], anchor: &str, text: &str) {
        let text = escaped(text);
        let _ = writeln!(
            self.svg,
            "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text}</text>"
        );
    }

    fn horizontal(&mut self, y: f64, label: &str) {
        self.path("grid", [[0.0, y], [1.0, y]], false);
        let [x, at] = self.at(0.0, y);
        self.text("", [x - 7.0, at + 4.0], "end", label);
    }

    fn tick(&mut self, x: f64, label: &str) {
        let [at, y] = self.at(x, 0.0);
        self.text("", [at, y + 17.0], "middle", label);
    }

    /// The names of the axes, and of the series in their colours.
    fn finish(mut self, across: &str, up: &str, series: &[(&str, &str)]) -> String {
        self.path("axis", [[0.0, 0.0], [1.0, 0.0]], false);
        let [x, y] = self.at(0.5, 0.0);
        self.text("", [x, y + 36.0], "middle", across);
        self.text("", [4.0, 13.0], "start", up);
        let mut right = self.width - RIGHT;
        for (name, class) in series.iter().rev() {
            self.text(class, [right, 13.0], "end", name);
            right -= LETTER * name.chars().count() as f64 + 14.0;
        }
        self.svg + "</svg>"
    }
}

/// How a fit came down: its errors, and the root of its objective, over the iterations.
pub(super) fn convergence(iterations: &[Iteration]) -> String {
    let root = |it: &Iteration| Some(100.0 * it.energy.max(0.0).sqrt());
    type Figure = fn(&Iteration) -> Option<f64>;
    let figures: [(&str, Figure); 3] = [
        ("largest", |it| it.max_percent),
        ("rms", |it| it.rms_percent),
        ("mean", |it| it.mean_percent),
    ];
    let values = |figure: &dyn Fn(&Iteration) -> Option<f64>| -> Vec<Option<f64>> {
        let positive = |x: &f64| *x > 0.0 && x.is_finite();
        iterations
            .iter()
            .map(|it| figure(it).filter(positive))
            .collect()
    };
    let mut series: Vec<(&str, Vec<Option<f64>>)> = figures
        .iter()
        .map(|(name, figure)| (*name, values(figure)))
        .collect();
    series.push(("root of the objective", values(&root)));
    // What no iteration knows has no line and no name.
    let series: Vec<_> = series
        .into_iter()
        .zip(CLASSES)
        .filter(|((_, values), _)| values.iter().any(Option::is_some))
        .collect();
    let all = series
        .iter()
        .flat_map(|((_, values), _)| values.iter().flatten());
    let (low, high) = all.fold((f64::INFINITY, 0f64), |(lo, hi), &x| (lo.min(x), hi.max(x)));
    if low > high {
        return "<p class=\"note\">There was nothing to iterate.</p>".into();
    }
    let (low, high) = (low.log10().floor(), (high.log10() + 1e-9).ceil());
    let (low, high) = (low, high.max(low + 1.0));
    let mut chart = Chart::new([900.0, 300.0], "Errors over the iterations");
    for decade in low as i32..=high as i32 {
        let label = match decade {
            -4..=3 => format!("{}", 10f64.powi(decade)),
            _ => format!("1e{decade}"),
        };
        chart.horizontal((f64::from(decade) - low) / (high - low), &label);
    }
    let last = iterations.len() as f64;
    for (tick, label) in Scale::up_to(last).ticks().filter(|(tick, _)| *tick <= last) {
        chart.tick(tick / last, label.trim_end_matches(".0"));
    }
    phases(&mut chart, iterations);
    for ((_, values), class) in &series {
        let place = |(k, value): (usize, &Option<f64>)| {
            value.map(|x| [(k + 1) as f64 / last, (x.log10() - low) / (high - low)])
        };
        let places: Vec<_> = values.iter().enumerate().map(place).collect();
        for run in places.split(Option::is_none).filter(|run| !run.is_empty()) {
            // A lone value would be no line.
            let ends = run.iter().chain(run.last()).flatten().copied();
            chart.path(&format!("line {class}"), ends, false);
        }
    }
    let names: Vec<_> = series
        .iter()
        .map(|((name, _), class)| (*name, *class))
        .collect();
    chart.finish("iteration", "% of the diagonal", &names)
}

/// A line wherever the control mesh got finer or another phase began, with its name where there is room.
fn phases(chart: &mut Chart, iterations: &[Iteration]) {
    let last = iterations.len() as f64;
    let same =
        |a: &Iteration, b: &Iteration| a.phase == b.phase && a.control_points == b.control_points;
    let mut begun = 0;
    for stage in iterations.chunk_by(same) {
        let (from, to) = (begun as f64 / last, (begun + stage.len()) as f64 / last);
        if begun > 0 {
            chart.path("grid", [[from, 0.0], [from, 1.0]], false);
        }
        let name = format!("{} · {}", stage[0].phase, count(stage[0].control_points));
        let ([left, y], [right, _]) = (chart.at(from, 1.0), chart.at(to, 1.0));
        if right - left > LETTER * name.chars().count() as f64 {
            chart.text("", [0.5 * (left + right), y + 14.0], "middle", &name);
        }
        begun += stage.len();
    }
}

/// Distances in percent with their weights, of any sum.
pub(super) type Weighted = Vec<(f64, f64)>;

/// How the distances are spread: the first series as bars, the second as a line. With the share of each, in percent, beyond the end.
pub(super) fn histogram(series: &[(&str, Weighted)]) -> String {
    let top = series
        .iter()
        .map(|(_, data)| quantile(data, SHOWN))
        .fold(0.0, f64::max);
    let scale = Scale::up_to(top);
    let shares: Vec<_> = series
        .iter()
        .map(|(_, data)| shares(data, scale.top))
        .collect();
    let tallest = shares.iter().flatten().copied().fold(0.0, f64::max);
    let heights = Scale::up_to(tallest);
    let mut chart = Chart::new([460.0, 300.0], "Histogram of the distances");
    for (tick, label) in heights.ticks() {
        chart.horizontal(tick / heights.top, &label);
    }
    for (tick, label) in scale.ticks() {
        chart.tick(tick / scale.top, &label);
    }
    for (k, shares) in shares.iter().enumerate() {
        let edge = |bar: usize| bar as f64 / BARS as f64;
        let outline: Vec<[f64; 2]> = (0..BARS)
            .flat_map(|bar| {
                let y = shares[bar] / heights.top;
                [[edge(bar), y], [edge(bar + 1), y]]
            })
            .collect();
        if k == 0 {
            let feet = [[1.0, 0.0], [0.0, 0.0]];
            chart.path("bars", outline.iter().copied().chain(feet), true);
        }
        chart.path(&format!("line {}", CLASSES[k]), outline, false);
    }
    let names: Vec<_> = series.iter().map(|(name, _)| *name).zip(CLASSES).collect();
    chart.finish("distance, % of the diagonal", "% of the area", &names)
}

/// The share of the weight in each bar, in percent; what lies beyond the last is in none.
fn shares(data: &Weighted, top: f64) -> [f64; BARS] {
    let total = data
        .iter()
        .map(|(_, weight)| weight)
        .sum::<f64>()
        .max(f64::MIN_POSITIVE);
    let mut bars = [0.0; BARS];
    for &(value, weight) in data {
        let bar = (value / top * BARS as f64) as usize;
        if let Some(bar) = bars.get_mut(bar) {
            *bar += 100.0 * weight / total;
        }
    }
    bars
}

/// The value that a share of the weight does not exceed; 0 where there is none.
pub(super) fn quantile(data: &Weighted, share: f64) -> f64 {
    let mut sorted = data.clone();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = sorted.iter().map(|(_, weight)| weight).sum();
    let mut sum = 0.0;
    let reached = sorted.iter().find(|(_, weight)| {
        sum += weight;
        sum >= share * total
    });
    reached.map_or(0.0, |(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_hold_all_of_the_weight_up_to_the_end() {
        let data: Weighted = (0..1000).map(|k| (f64::from(k) / 1000.0, 2.0)).collect();
        let bars = shares(&data, 0.5);
        assert!((bars.iter().sum::<f64>() - 50.0).abs() < 1e-9);
        assert!(bars.iter().all(|b| (b - 1.25).abs() < 0.15), "{bars:?}");
        assert_eq!(quantile(&data, 0.9), 0.899);
        assert_eq!(quantile(&Vec::new(), 0.9), 0.0);
    }

    #[test]
    fn charts_of_nothing_and_of_zeros_are_sound() {
        assert!(convergence(&[]).starts_with("<p"));
        let still = Iteration {
            iteration: 1,
            ..Iteration::default()
        };
        assert!(convergence(&[still]).starts_with("<p"));
        for data in [vec![], vec![(0.0, 1.0); 3], vec![(0.5, 0.0)]] {
            let svg = histogram(&[("a", data)]);
            assert!(
                svg.ends_with("</svg>") && !svg.contains("NaN") && !svg.contains("inf"),
                "{svg}"
            );
        }
    }
}
