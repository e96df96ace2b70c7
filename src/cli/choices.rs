//! The words that options of the command line are given in.

use clap::ValueEnum;
use vorofit::template::Align;

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    #[default]
    On,
    Off,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    #[default]
    Vsdm,
    Geometric,
    Interpolate,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GenusName {
    Keep,
    Simplify,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StepName {
    Displacement,
    LeastSquares,
}

/// [`Align`] on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Alignment {
    None,
    Box,
    Rigid,
    Similarity,
}

impl From<Alignment> for Align {
    fn from(alignment: Alignment) -> Self {
        match alignment {
            Alignment::None => Self::None,
            Alignment::Box => Self::Box,
            Alignment::Rigid => Self::Rigid,
            Alignment::Similarity => Self::Similarity,
        }
    }
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum SchemeName {
    #[default]
    CatmullClark,
    Loop,
    Polygon,
}
