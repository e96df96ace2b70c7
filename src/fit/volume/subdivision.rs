//! Fits a subdivision volume, level after level (\[PPL13\], section 4.3).
//!
//! At each level the control points of a mesh are what is optimized, and the mesh after one step of subdivision, X = M P, is the finite element
//! mesh whose straight-edged hexahedra make E_Ω and E_S; gradients come back by G_c = Mᵀ G_s. That mesh is the control mesh of
//! the next level.

use super::body::Body;
use super::run::Run;
use super::start::VolumeStart;
use super::target::VolumeTarget;
use super::{VolumeFit, VolumeOptions};
use crate::device::Device;
use crate::error::Result;
use crate::fit::StopReason;
use crate::mesh::Frame;
use crate::model::volume::{ControlVolume, CurvedVolume, Subdivided};
use crate::progress::Progress;

/// The result of a fit, in the unit frame.
#[derive(Debug, Clone)]
pub struct SubdivisionFit {
    /// The control mesh of the last level.
    pub control: ControlVolume,
    /// That mesh after a step of subdivision, and how it came to be.
    pub refined: VolumeFit,
    /// Each level.
    pub levels: Vec<SubdivisionLevel>,
}

/// What a level has reached.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct SubdivisionLevel {
    /// Control points.
    pub control_points: usize,
    /// Hexahedra of the refined mesh.
    pub elements: usize,
    /// The largest distance from the target, as sampled in the fit, in percent of the diagonal.
    pub max_percent: f64,
    /// The root mean square distance.
    pub rms_percent: f64,
}

impl SubdivisionFit {
    /// The control mesh in the input's own coordinates.
    pub fn control_in_input_frame(&self, frame: &Frame) -> ControlVolume {
        let mut control = self.control.clone();
        for p in &mut control.mesh.positions {
            *p = frame.to_input(*p);
        }
        control
    }
}

/// Fits a subdivision volume of `levels` ≥ 1 levels to a closed target, from a control mesh in the unit frame with its creases and corners;
/// `nearby` says that it lies on the target already. Order and basis of the options do not matter.
///
/// ```
/// use vorofit::device::Device;
/// use vorofit::fit::{Target, VolumeOptions, VolumeStart, VolumeTemplate, fit_subdivision};
/// use vorofit::{mesh::shapes, progress::Silent};
///
/// # fn main() -> vorofit::Result<()> {
/// let target = Target::new(&Device::Cpu, &shapes::lobed_ball(3))?;
/// let start = VolumeStart::new(&target, &VolumeTemplate::Ball(1))?;
/// let options = VolumeOptions::default();
/// let fit = fit_subdivision(&Device::Cpu, &target, start.mesh.into(), false, 2, &options, &Silent)?;
/// assert_eq!(fit.levels.len(), 2);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// As [`super::fit_volume`] and [`ControlVolume::subdivided`].
pub fn fit_subdivision<'a>(
    device: &Device,
    target: impl Into<VolumeTarget<'a>>,
    control: ControlVolume,
    nearby: bool,
    levels: usize,
    options: &VolumeOptions,
    progress: &dyn Progress,
) -> Result<SubdivisionFit> {
    let target = target.into();
    let enclosed = target.enclosure()?.volume;
    let step = |control: &ControlVolume| -> Result<(Body, Vec<f64>, ControlVolume)> {
        let Subdivided {
            control: fine,
            matrix,
        } = control.subdivided()?;
        let start = VolumeStart {
            mesh: fine.mesh.clone(),
            nearby,
        };
        let sizes = start.ideal_sizes(enclosed);
        let volume = CurvedVolume::new(&fine.mesh, options.basis)?;
        let points = control.mesh.positions.clone();
        Ok((Body::subdivided(volume, matrix, points), sizes, fine))
    };
    let mut control = control;
    let (body, sizes, mut fine) = step(&control)?;
    let mut run = Run::new(device, target, options, progress, body, sizes)?;
    if !nearby {
        run.approach()?;
    }
    let mut reached = Vec::new();
    loop {
        run.close_in(1)?;
        control.mesh.positions = run.body.unknowns().to_vec();
        fine.mesh.positions = run.body.volume().coefficients.clone();
        let gap = run.gap()?;
        reached.push(SubdivisionLevel {
            control_points: control.mesh.positions.len(),
            elements: fine.mesh.cell_count(),
            max_percent: 100.0 * gap.largest,
            rms_percent: 100.0 * gap.rms,
        });
        if reached.len() >= levels || run.ended.is_some() {
            break;
        }
        control = fine;
        let (body, sizes, next) = step(&control)?;
        fine = next;
        run.replace(body, sizes);
    }
    Ok(SubdivisionFit {
        control,
        refined: VolumeFit {
            volume: run.body.into_volume(),
            iterations: run.iterations,
            stages: run.stages,
            stop_reason: run.ended.unwrap_or(StopReason::Schedule),
        },
        levels: reached,
    })
}
