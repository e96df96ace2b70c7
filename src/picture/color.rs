//! Colours: sRGB and linear light, and the map from values to colours.
//!
//! The map is a curve through the Oklab space [B. Ottosson, *A perceptual color space for image processing*, 2020]: lightness falls evenly from almost
//! white to dark while the hue goes from sand through orange and red to purple. On a shaded surface a small value then looks like plain
//! material, and a large one stands out, for colour-blind readers and in print too.

use std::sync::LazyLock;

/// Red, green and blue in sRGB.
pub type Rgb = [u8; 3];

/// What is not known.
pub const UNKNOWN: Rgb = [150, 156, 163];
/// A scan.
pub const TARGET: Rgb = [170, 184, 201];
/// The faces of a control mesh, and any surface without values.
pub const CAGE: Rgb = [232, 226, 214];
/// The edges of a control mesh, and letters.
pub const INK: Rgb = [27, 38, 59];

/// Steps of the map.
pub const STEPS: usize = 256;

/// Lightness of no error and of the largest.
const LIGHTNESS: [f32; 2] = [0.955, 0.32];
/// Places along the map with their chroma and hue in degrees.
const COURSE: [[f32; 3]; 6] = [
    [0.0, 0.025, 95.0],
    [0.2, 0.085, 85.0],
    [0.45, 0.145, 58.0],
    [0.7, 0.175, 28.0],
    [0.87, 0.15, 8.0],
    [1.0, 0.11, -20.0],
];

/// The colour of a value from 0 to 1; beyond, that of the nearer end.
pub fn map(share: f64) -> Rgb {
    encoded(LINEAR_MAP[step(share)])
}

/// The same in linear light.
pub(super) fn linear_map(share: f64) -> [f32; 3] {
    LINEAR_MAP[step(share)]
}

fn step(share: f64) -> usize {
    (share.clamp(0.0, 1.0) * (STEPS - 1) as f64).round() as usize
}

static LINEAR_MAP: LazyLock<[[f32; 3]; STEPS]> = LazyLock::new(|| {
    std::array::from_fn(|k| course(k as f32 / (STEPS - 1) as f32).map(|x| x.clamp(0.0, 1.0)))
});

/// The map in linear light, not yet cut to what sRGB can show.
fn course(share: f32) -> [f32; 3] {
    let k = COURSE
        .windows(2)
        .position(|w| share <= w[1][0])
        .unwrap_or(COURSE.len() - 2);
    let [from, to] = [COURSE[k], COURSE[k + 1]];
    let part = (share - from[0]) / (to[0] - from[0]);
    let [chroma, hue] = [1, 2].map(|i| from[i] + part * (to[i] - from[i]));
    let (sine, cosine) = hue.to_radians().sin_cos();
    let lightness = LIGHTNESS[0] + share * (LIGHTNESS[1] - LIGHTNESS[0]);
    from_oklab([lightness, chroma * cosine, chroma * sine])
}

/// From Oklab to linear sRGB, by the matrices of its author.
fn from_oklab([lightness, a, b]: [f32; 3]) -> [f32; 3] {
    let [l, m, s] = [
        lightness + 0.396_337_78 * a + 0.215_803_76 * b,
        lightness - 0.105_561_346 * a - 0.063_854_17 * b,
        lightness - 0.089_484_18 * a - 1.291_485_5 * b,
    ]
    .map(|x| x * x * x);
    [
        4.076_741_7 * l - 3.307_711_6 * m + 0.230_969_94 * s,
        -1.268_438 * l + 2.609_757_4 * m - 0.341_319_4 * s,
        -0.004_196_086_3 * l - 0.703_418_6 * m + 1.707_614_7 * s,
    ]
}

/// To linear light.
pub(super) fn linear(rgb: Rgb) -> [f32; 3] {
    rgb.map(|byte| {
        let x = f32::from(byte) / 255.0;
        match x <= 0.04045 {
            true => x / 12.92,
            false => ((x + 0.055) / 1.055).powf(2.4),
        }
    })
}

/// From linear light.
pub(super) fn encoded(light: [f32; 3]) -> Rgb {
    light.map(|x| {
        let x = x.clamp(0.0, 1.0);
        let y = match x <= 0.003_130_8 {
            true => 12.92 * x,
            false => 1.055 * x.powf(1.0 / 2.4) - 0.055,
        };
        (255.0 * y).round() as u8
    })
}

/// A colour under a share of another.
pub(super) fn mixed(under: Rgb, over: Rgb, share: f64) -> Rgb {
    let (under, over) = (linear(under), linear(over));
    let share = share.clamp(0.0, 1.0) as f32;
    encoded(std::array::from_fn(|k| {
        under[k] + share * (over[k] - under[k])
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_survive_linear_light() {
        for byte in 0..=255 {
            assert_eq!(encoded(linear([byte; 3])), [byte; 3]);
        }
        assert_eq!(mixed([0; 3], [255; 3], 1.0), [255; 3]);
        assert_eq!(mixed([10, 20, 30], [255; 3], 0.0), [10, 20, 30]);
    }

    #[test]
    fn the_map_is_within_srgb_and_darkens_evenly() {
        let luminance = |share: f32| {
            let rgb = course(share);
            assert!(
                rgb.iter().all(|x| (-1e-3..=1.0).contains(x)),
                "{share}: {rgb:?}"
            );
            0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
        };
        // CIE lightness is not Oklab's, but must fall at about the same rate throughout.
        let lightness = |share: f32| 116.0 * luminance(share).cbrt() - 16.0;
        let steps: Vec<f32> = (0..20)
            .map(|k| lightness(k as f32 / 20.0) - lightness((k + 1) as f32 / 20.0))
            .collect();
        assert!(steps.iter().all(|&d| d > 2.0 && d < 5.5), "{steps:?}");
        assert_eq!(map(-3.0), map(0.0));
        assert_eq!(map(7.0), map(1.0));
    }
}
