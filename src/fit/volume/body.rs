//! What a volume fit deforms: the coefficients of elements, or the control points that these are made of by subdivision.

use crate::kernel::sparse::Csr;
use crate::model::volume::{BoundaryPoint, BoundarySurface, CurvedVolume};
use glam::DVec3;

/// Elements as a linear function of *unknowns*.
#[derive(Debug, Clone)]
pub(super) struct Body {
    /// Up to date.
    volume: CurvedVolume,
    control: Option<Control>,
}

/// Coefficients of elements are M P.
#[derive(Debug, Clone)]
struct Control {
    /// `[coefficients, control points]`.
    matrix: Csr,
    points: Vec<DVec3>,
}

impl From<CurvedVolume> for Body {
    /// The unknowns are the coefficients themselves.
    fn from(volume: CurvedVolume) -> Self {
        Self {
            volume,
            control: None,
        }
    }
}

impl Body {
    /// Elements whose coefficients are `matrix` × `points`.
    pub fn subdivided(volume: CurvedVolume, matrix: Csr, points: Vec<DVec3>) -> Self {
        let control = Control {
            matrix,
            points: points.clone(),
        };
        let mut body = Self {
            volume,
            control: Some(control),
        };
        body.set_unknowns(points);
        body
    }

    /// The elements.
    pub fn volume(&self) -> &CurvedVolume {
        &self.volume
    }

    /// The elements.
    pub fn into_volume(self) -> CurvedVolume {
        self.volume
    }

    pub fn unknowns(&self) -> &[DVec3] {
        match &self.control {
            None => &self.volume.coefficients,
            Some(control) => &control.points,
        }
    }

    pub fn set_unknowns(&mut self, unknowns: Vec<DVec3>) {
        match &mut self.control {
            None => self.volume.coefficients = unknowns,
            Some(control) => {
                self.volume.coefficients = control.matrix.apply(&unknowns);
                control.points = unknowns;
            }
        }
    }

    /// From unknowns to the local modes of some cells.
    pub fn gather(&self, cells: &[u32]) -> Csr {
        self.of_unknowns(self.volume.gather(cells))
    }

    /// [`CurvedVolume::boundary_surface`] as a function of the unknowns.
    pub fn boundary_surface(&self, intervals: usize) -> BoundarySurface {
        let mut surface = self.volume.boundary_surface(intervals);
        surface.matrix = self.of_unknowns(surface.matrix);
        surface
    }

    /// [`CurvedVolume::boundary_rows`] as a function of the unknowns.
    pub fn boundary_rows(&self, surface: &BoundarySurface, points: &[BoundaryPoint]) -> Csr {
        self.of_unknowns(self.volume.boundary_rows(surface, points))
    }

    /// What a matrix on coefficients is on the unknowns.
    fn of_unknowns(&self, matrix: Csr) -> Csr {
        match &self.control {
            None => matrix,
            Some(control) => matrix.multiply(&control.matrix),
        }
    }
}
