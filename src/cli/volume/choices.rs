//! The words that options of `vorofit volume` are given in.

use crate::cli::bad_usage;
use crate::cli::text::parse_number;
use clap::ValueEnum;
use std::path::Path;
use vorofit::geometry::distortion::Distortion;

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum BasisName {
    #[default]
    Legendre,
    Fourier,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum RuleName {
    #[default]
    Gauss,
    Trapezoid,
}

/// A scheme of subdivision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SchemeName {
    Mlca,
}

/// What `--template` says.
pub enum TemplateName<'a> {
    Auto,
    Grid([u32; 3]),
    Ball(u32),
    File(&'a Path),
}

impl<'a> TemplateName<'a> {
    /// The meaning of the text; ends the program where it has none.
    pub fn of(text: &'a str) -> Self {
        if text == "auto" {
            return Self::Auto;
        }
        if let Some(cells) = text.strip_prefix("grid:") {
            let counts: Option<Vec<u32>> = cells.split('x').map(parse_count).collect();
            return match counts.as_deref() {
                Some(&[a, b, c]) => Self::Grid([a, b, c]),
                _ => bad_usage("--template grid: give three counts from 1 to 1000, as grid:4x2x2"),
            };
        }
        match text.strip_prefix("ball") {
            Some("") => Self::Ball(2),
            Some(n) if n.starts_with(':') => match parse_count(&n[1..]) {
                Some(n) => Self::Ball(n),
                None => bad_usage("--template ball: give a count from 1 to 1000, as ball:2"),
            },
            _ => Self::File(Path::new(text)),
        }
    }
}

/// Counts of cells along an edge.
fn parse_count(text: &str) -> Option<u32> {
    text.parse().ok().filter(|n| (1..=1000).contains(n))
}

pub fn parse_percent(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0, "above 0")
}

pub fn parse_angle(text: &str) -> Result<f64, String> {
    parse_number(text, |x| (0.0..180.0).contains(&x), "from 0 to 180")
}

pub fn parse_distortion(text: &str) -> Result<Distortion, String> {
    Distortion::ALL
        .into_iter()
        .find(|distortion| distortion.name() == text)
        .ok_or_else(|| {
            let names = Distortion::ALL.map(Distortion::name);
            format!("give one of {}", names.join(", "))
        })
}

pub fn parse_smoothness(text: &str) -> Result<[f64; 2], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|word| parse_number(word.trim(), |x| x > 0.0, "above 0"))
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [far, close] if close <= far => Ok([far, close]),
        _ => Err("give two numbers, the second not above the first".into()),
    }
}
