//! How the features of a surface are drawn: the same in pictures and on the page.

use crate::features::{Features, Kind, Line};
use crate::picture::{Rgb, Strokes};
use glam::DVec3;

/// Lines of more strength than this, and crossings of such, stand out.
const BOLD: f64 = 1.0;
/// Widths in pixels: of weak and strong lines, and of points.
const THIN_WIDTH: f64 = 1.2;
const BOLD_WIDTH: f64 = 3.0;
const POINT_WIDTH: f64 = 7.0;

/// The colour of umbilics.
pub const UMBILIC_COLOR: Rgb = [255, 150, 0];
/// The colour of crossings.
pub const CROSSING_COLOR: Rgb = [120, 40, 150];

/// Features of one sort.
pub struct FeatureLayer {
    /// What they are, in the plural.
    pub name: &'static str,
    /// Their colour, which that of all strokes is.
    pub color: Rgb,
    /// Lines, or points where they have no length.
    pub strokes: Vec<Strokes>,
}

/// The colour that lines of a kind are drawn in, which says its name.
pub fn ridge_color(kind: Kind) -> Rgb {
    match kind {
        Kind::Red => [205, 30, 40],
        Kind::Blue => [25, 70, 200],
        Kind::Yellow => [215, 170, 0],
        Kind::Green => [40, 150, 70],
    }
}

/// Ridges and sharp edges by their kinds, the strong ones bold.
pub fn ridge_layers(features: &Features) -> [FeatureLayer; 4] {
    let layer = |kind: Kind, name| {
        let color = ridge_color(kind);
        let strokes = |is_bold: bool| {
            let alike = |l: &&Line| l.kind == kind && (l.strength > BOLD) == is_bold;
            let pieces = |line: &Line| -> Vec<_> {
                let pairs = line.points.windows(2);
                pairs.map(|w| [w[0].position, w[1].position]).collect()
            };
            Strokes {
                segments: features
                    .lines
                    .iter()
                    .filter(alike)
                    .flat_map(pieces)
                    .collect(),
                color,
                width: if is_bold { BOLD_WIDTH } else { THIN_WIDTH },
            }
        };
        FeatureLayer {
            name,
            color,
            strokes: vec![strokes(false), strokes(true)],
        }
    };
    [
        layer(Kind::Red, "red ridges"),
        layer(Kind::Blue, "blue ridges"),
        layer(Kind::Yellow, "yellow ridges"),
        layer(Kind::Green, "green ridges"),
    ]
}

/// Crossings of strong lines, and umbilics.
pub fn point_layers(features: &Features) -> [FeatureLayer; 2] {
    let strong = features.crossings.iter().filter(|c| c.strength > BOLD);
    let umbilics = features.umbilics.iter().map(|u| u.position);
    [
        points("crossings", CROSSING_COLOR, strong.map(|c| c.position)),
        points("umbilics", UMBILIC_COLOR, umbilics),
    ]
}

/// Points as a layer.
pub fn points(name: &'static str, color: Rgb, places: impl Iterator<Item = DVec3>) -> FeatureLayer {
    FeatureLayer {
        name,
        color,
        strokes: vec![Strokes {
            segments: places.map(|p| [p, p]).collect(),
            color,
            width: POINT_WIDTH,
        }],
    }
}
