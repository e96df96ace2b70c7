/// Tops of scales, against a power of ten, with the equal parts that they are cut into: steps are one digit then.
const TOPS: [(f64, usize); 9] = [
    (1.0, 5),
    (1.5, 3),
    (2.0, 4),
    (2.5, 5),
    (3.0, 3),
    (4.0, 4),
    (5.0, 5),
    (6.0, 3),
    (8.0, 4),
];

/// A scale from 0 to a round number, with ticks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Where it ends.
    pub top: f64,
    parts: usize,
}

impl Scale {
    /// The shortest scale that holds a value; up to 1 where that is not positive and finite.
    pub fn up_to(value: f64) -> Self {
        if !(value > 0.0 && value.is_finite()) {
            return Self { top: 1.0, parts: 5 };
        }
        let power = 10f64.powi(value.log10().floor() as i32);
        let holds = |&(top, _): &(f64, usize)| top * power >= value * (1.0 - 1e-9);
        let (top, parts) = TOPS.into_iter().find(|t| holds(t)).unwrap_or((10.0, 5));
        Self {
            top: top * power,
            parts,
        }
    }

    /// The ticks with their labels, from 0 up.
    pub fn ticks(&self) -> impl Iterator<Item = (f64, String)> + use<> {
        let Self { top, parts } = *self;
        let step = top / parts as f64;
        let digits = (-(step.log10() + 1e-9).floor()).max(0.0) as usize;
        (0..=parts).map(move |k| {
            let tick = k as f64 * step;
            let text = match digits {
                _ if k == 0 => "0".into(),
                0..=6 if tick < 1e7 => format!("{tick:.digits$}"),
                _ => format!("{tick:.1e}"),
            };
            (tick, text)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_end_at_round_numbers_and_their_labels_are_exact() {
        let labels = |x: f64| {
            Scale::up_to(x)
                .ticks()
                .map(|t| t.1)
                .collect::<Vec<_>>()
                .join(" ")
        };
        assert_eq!(labels(0.0), "0 0.2 0.4 0.6 0.8 1.0");
        assert_eq!(labels(0.13), "0 0.05 0.10 0.15");
        assert_eq!(labels(0.21), "0 0.05 0.10 0.15 0.20 0.25");
        assert_eq!(labels(9.5), "0 2 4 6 8 10");
        assert_eq!(labels(3000.0), "0 1000 2000 3000");
        assert_eq!(labels(2e-9), "0 5.0e-10 1.0e-9 1.5e-9 2.0e-9");
        for k in 1..2000 {
            let value = 1e-3 * f64::from(k);
            let top = Scale::up_to(value).top;
            assert!(
                top >= value * (1.0 - 1e-8) && top < 1.7 * value,
                "{value}: {top}"
            );
        }
        assert_eq!(Scale::up_to(f64::NAN).top, 1.0);
    }
}
