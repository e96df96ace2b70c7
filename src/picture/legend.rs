use super::color::{self, INK};
use super::lettering::{stroke, width, write};
use super::{Picture, Scale};
use glam::DVec2;

/// What the colours of a picture mean: a bar with numbers at the right.
#[derive(Debug, Clone, PartialEq)]
pub struct Legend {
    /// A line over the bar, in the letters of the alphabet (small ones; see the source).
    pub title: String,
    /// From no error to the last colour.
    pub scale: Scale,
    /// Whether there are values beyond the last colour.
    pub exceeded: bool,
}

/// Against the height of a letter.
const BAR_WIDTH: f64 = 1.7;
const GAP: f64 = 1.0;

impl Legend {
    /// The height of a capital in a picture of some size, in pixels.
    fn letter(size: DVec2) -> f64 {
        (0.017 * size.min_element()).max(7.0)
    }

    /// The values that are named, with their names.
    pub fn labels(&self) -> Vec<(f64, String)> {
        let mut labels: Vec<_> = self.scale.ticks().collect();
        if let (true, Some((_, last))) = (self.exceeded, labels.last_mut()) {
            last.insert(0, '≥');
        }
        labels
    }

    /// The width that it takes from a picture of some size, in pixels.
    pub(super) fn width(&self, size: DVec2) -> f64 {
        let letter = Self::letter(size);
        let labels = self.labels();
        let widest = labels.iter().map(|(_, text)| width(text, letter));
        let bar = BAR_WIDTH * letter + GAP * letter + widest.fold(0.0, f64::max);
        bar.max(width(&self.title, letter)) + 3.0 * letter
    }

    /// Draws it into the right margin.
    pub(super) fn draw(&self, picture: &mut Picture) {
        let size = DVec2::new(picture.width as f64, picture.height as f64);
        let letter = Self::letter(size);
        let left = (size.x - self.width(size)).max(0.0);
        let (top, bottom) = ((0.22 * size.y).round(), (0.78 * size.y).round());
        let right = left + BAR_WIDTH * letter;
        for y in top as i64..bottom as i64 {
            let share = (bottom - (y as f64 + 0.5)) / (bottom - top);
            for x in left.round() as i64..right.round() as i64 {
                picture.blend(x, y, color::map(share), 1.0);
            }
        }
        let title = DVec2::new(left, top - 2.0 * letter);
        write(picture, &self.title, title, letter, INK);
        for (value, text) in self.labels() {
            let y = bottom - (bottom - top) * value / self.scale.top;
            let tick = [DVec2::new(right, y), DVec2::new(right + 0.4 * letter, y)];
            stroke(picture, tick, 0.12 * letter, INK);
            let at = DVec2::new(right + GAP * letter, y + 0.5 * letter);
            write(picture, &text, at, letter, INK);
        }
    }
}
