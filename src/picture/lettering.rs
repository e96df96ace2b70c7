//! A single-stroke alphabet for labels, and strokes in the plane of the picture.
//!
//! Letters lie on a grid: x from 0 to 4, y upwards from 0 (descenders) over 2 (the line) and 6 (small letters) to 8 (capitals and digits).

use super::Picture;
use super::color::Rgb;
use glam::DVec2;

/// Height of a capital, in grid units, and the line it stands on.
const CAPITAL: f64 = 6.0;
const LINE: f64 = 2.0;
/// Between two letters.
const GAP: f64 = 1.7;
/// A blank.
const BLANK: f64 = 2.6;
/// Width of the pen against the height of a capital.
const PEN: f64 = 0.13;

/// Polylines of pairs of digits x y; a polyline of one place is a dot.
const LETTERS: &[(char, &str)] = &[
    ('0', "12 32 43 47 38 18 07 03 12"),
    ('1', "06 28 22"),
    ('2', "07 18 38 47 46 02 42"),
    ('3', "07 18 38 47 46 35 15, 35 44 43 32 12 03"),
    ('4', "32 38 04 44"),
    ('5', "48 08 05 35 44 43 32 12 03"),
    ('6', "47 38 18 07 03 12 32 43 44 35 15 04"),
    ('7', "08 48 12"),
    ('8', "15 35 44 43 32 12 03 04 15 06 07 18 38 47 46 35"),
    ('9', "03 12 32 43 47 38 18 07 06 15 35 46"),
    ('.', "12"),
    (',', "12 01"),
    ('-', "05 35"),
    ('%', "02 48, 18 07 16 27 18, 34 23 32 43 34"),
    ('≥', "08 46 04, 02 42"),
    ('a', "46 42, 45 36 16 05 03 12 32 43"),
    ('b', "08 02, 05 16 36 45 43 32 12 03"),
    ('c', "45 36 16 05 03 12 32 43"),
    ('d', "48 42, 45 36 16 05 03 12 32 43"),
    ('e', "04 44 45 36 16 05 03 12 32 43"),
    ('f', "38 28 17 12, 06 26"),
    ('g', "46 41 30 10, 45 36 16 05 03 12 32 43"),
    ('h', "08 02, 05 16 36 45 42"),
    ('i', "16 12, 18"),
    ('l', "18 12"),
    ('m', "06 02, 05 16 25 22, 25 36 45 42"),
    ('n', "06 02, 05 16 36 45 42"),
    ('o', "12 32 43 45 36 16 05 03 12"),
    ('r', "06 02, 05 16 36"),
    ('s', "45 36 16 05 14 34 43 32 12 03"),
    ('t', "18 13 22 32, 06 26"),
    ('u', "06 03 12 32 43, 46 42"),
];

/// Draws a line of text whose first letter stands at `at` (pixels), with capitals `height` pixels high.
pub(super) fn write(picture: &mut Picture, text: &str, at: DVec2, height: f64, color: Rgb) {
    let unit = height / CAPITAL;
    let mut left = at.x;
    for letter in text.chars() {
        let place = |p: DVec2| DVec2::new(left + unit * p.x, at.y - unit * (p.y - LINE));
        for line in polylines(letter) {
            let points: Vec<_> = line.into_iter().map(place).collect();
            let last = points.len() - 1;
            for k in 0..last.max(1) {
                stroke(
                    picture,
                    [points[k], points[last.min(k + 1)]],
                    PEN * height,
                    color,
                );
            }
        }
        left += unit * advance(letter);
    }
}

/// The width of a line of text with capitals `height` pixels high.
pub(super) fn width(text: &str, height: f64) -> f64 {
    let letters: f64 = text.chars().map(advance).sum();
    (letters - GAP).max(0.0) * height / CAPITAL
}

/// A straight line with round ends over the picture, anti-aliased by its distance from the pixels' centres.
pub(super) fn stroke(picture: &mut Picture, [a, b]: [DVec2; 2], width: f64, color: Rgb) {
    let reach = 0.5 * width + 0.5;
    let (low, high) = (a.min(b) - reach, a.max(b) + reach);
    for y in low.y.floor() as i64..=high.y.ceil() as i64 {
        for x in low.x.floor() as i64..=high.x.ceil() as i64 {
            let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let along = b - a;
            let share = ((at - a).dot(along) / along.length_squared().max(1e-9)).clamp(0.0, 1.0);
            let cover = reach - at.distance(a + share * along);
            if cover > 0.0 {
                picture.blend(x, y, color, cover.min(1.0));
            }
        }
    }
}

fn strokes_of(letter: char) -> Option<&'static str> {
    let found = LETTERS.iter().find(|(known, _)| *known == letter);
    found.map(|(_, strokes)| *strokes)
}

fn polylines(letter: char) -> Vec<Vec<DVec2>> {
    let lines = strokes_of(letter).unwrap_or_default().split(", ");
    let point = |pair: &str| {
        let mut digits = pair.bytes().map(|digit| f64::from(digit - b'0'));
        Some(DVec2::new(digits.next()?, digits.next()?))
    };
    let line = |line: &str| line.split(' ').filter_map(point).collect::<Vec<_>>();
    lines.map(line).filter(|line| !line.is_empty()).collect()
}

/// From a letter to the next.
fn advance(letter: char) -> f64 {
    let points = polylines(letter);
    let right = points.iter().flatten().map(|p| p.x);
    right.reduce(f64::max).map_or(BLANK, |right| right + GAP)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_stay_on_their_grid_and_have_their_width() {
        for (letter, _) in LETTERS {
            let lines = polylines(*letter);
            assert!(!lines.is_empty() && advance(*letter) > GAP, "{letter}");
            assert!(lines.iter().flatten().all(|p| p.x <= 4.0 && p.y <= 8.0));
        }
        assert_eq!(width("", 10.0), 0.0);
        assert!(width("0.05", 12.0) > width("0.0", 12.0));
        assert!(
            width("≥ x", 12.0) > 0.0,
            "a letter that is missing is a blank"
        );
    }
}
