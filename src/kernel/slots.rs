//! Candidate lists on the device: one **slot** a pair (triangle, candidate seed), the unit of work of both Voronoi kernels.
//!
//! A slot's thread leaves a record and the fraction of the triangle that its cell covers. `shaders/cell_check.wgsl` then
//! looks whether the fractions of each triangle add up to 1; triangles where they do not are taken out and listed, for the
//! host to do again in f64. Energies are summed a workgroup and added in f64 here.

use super::candidates::Candidates;
use super::sum::Lists;
use crate::device::{
    Batch, Buffer, Gpu, Readback, Results, Shader, WORKGROUP_SIZE, shared_struct, source,
};
use crate::error::Result;
use glam::DVec3;
use std::ops::Range;

/// Triangles handled together. The largest array of a chunk, three four-vectors a slot, stays within wgpu's default limit of 128 MiB a
/// binding up to ten candidates a triangle on average, and no dispatch is long.
pub const CHUNK: usize = 1 << 18;

/// Triangles with more candidates get no slots: their threads would loop too long (see [`MAX_ITERATIONS`](crate::device::MAX_ITERATIONS)).
/// The check finds them uncovered, and the host does them.
const MAX_CANDIDATES: usize = 1024;

/// Failed triangles that the list holds. More mean that something is wrong with all of them.
const MAX_FAILURES: usize = 4095;

shared_struct! {
    /// The parameters of a check.
    pub struct CheckParams {
        /// The number of triangles.
        triangles: u32,
        /// Four-vectors a record.
        width: u32,
        /// Failed triangles that the list holds.
        capacity: u32,
    }
}

/// `shaders/cell_check.wgsl`.
pub const SHADER: Shader = Shader {
    name: "cell_check",
    structs: &[CheckParams::LAYOUT],
    sources: &[source!("shared/grid.wgsl"), source!("cell_check.wgsl")],
    constants: &[],
};

/// The slots of some consecutive triangles.
#[derive(Debug)]
pub struct GpuSlots {
    gpu: Gpu,
    /// The triangles of the whole list that these are.
    pub(super) triangles: Range<usize>,
    /// Four-vectors a record.
    width: usize,
    /// `[triangles + 1]`, the slots of each.
    pub(super) offsets: Buffer<u32>,
    /// `[slots]`, the candidate of each.
    pub(super) candidates: Buffer<u32>,
    /// `[slots]`, slot and triangle of each thread: alike work side by side.
    pub(super) order: Buffer<[u32; 2]>,
    /// `[slots, width]`.
    pub(super) records: Buffer<[f32; 4]>,
    /// `[slots]`.
    pub(super) fractions: Buffer<f32>,
    energies: Buffer<f32>,
    failures: Buffer<u32>,
}

/// A claim on the outcome of a check.
#[derive(Debug)]
pub struct CheckReadback {
    first: usize,
    energies: Readback<f32>,
    failures: Readback<u32>,
}

/// The outcome of a check.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Checked {
    /// The energy of all triangles but those that failed.
    pub energy: f64,
    /// The triangles that failed, ascending; `None` where they are too many to list.
    pub failures: Option<Vec<u32>>,
}

impl GpuSlots {
    /// No slots yet, for records of `width` four-vectors, on a range of triangles.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn new(gpu: &Gpu, triangles: Range<usize>, width: usize) -> Result<Self> {
        let workgroups = triangles.len().div_ceil(WORKGROUP_SIZE as usize);
        Ok(Self {
            gpu: gpu.clone(),
            width,
            offsets: Buffer::zeroed(gpu, triangles.len() + 1)?,
            candidates: Buffer::zeroed(gpu, 0)?,
            order: Buffer::zeroed(gpu, 0)?,
            records: Buffer::zeroed(gpu, 0)?,
            fractions: Buffer::zeroed(gpu, 0)?,
            energies: Buffer::zeroed(gpu, workgroups)?,
            failures: Buffer::zeroed(gpu, 1 + MAX_FAILURES)?,
            triangles,
        })
    }

    /// Takes its triangles' part of the candidates of all. Returns the candidate of each slot.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn write(&mut self, candidates: &Candidates) -> Result<Vec<u32>> {
        let mut offsets = vec![0];
        let mut seeds = Vec::new();
        for t in self.triangles.clone() {
            let list = candidates.of(t);
            if list.len() <= MAX_CANDIDATES {
                seeds.extend(list);
            }
            offsets.push(seeds.len() as u32);
        }
        self.offsets.write(&offsets)?;
        self.candidates.write(&seeds)?;
        self.order.write(&order(&offsets))?;
        self.records.resize(seeds.len() * self.width)?;
        self.fractions.resize(seeds.len())?;
        Ok(seeds)
    }

    /// The number of slots.
    pub fn len(&self) -> usize {
        self.candidates.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The slots of each triangle.
    pub fn by_triangle(&self) -> Lists<'_> {
        Lists {
            offsets: &self.offsets,
            items: None,
        }
    }

    /// Adds the check to a batch, after the records are written, and claims its outcome.
    ///
    /// # Errors
    /// Where a buffer passes the adapter's limits.
    pub fn check(&self, batch: &mut Batch) -> Result<CheckReadback> {
        let params = CheckParams {
            triangles: self.triangles.len() as u32,
            width: self.width as u32,
            capacity: MAX_FAILURES as u32,
        };
        batch.clear(&self.failures);
        batch.dispatch(
            &self.gpu.pipeline(&SHADER, &[])?,
            self.triangles.len(),
            &params,
            &[
                &self.offsets.binding(),
                &self.fractions.binding(),
                &self.records.binding(),
                &self.energies.binding(),
                &self.failures.binding(),
            ],
        )?;
        Ok(CheckReadback {
            first: self.triangles.start,
            energies: batch.read(&self.energies),
            failures: batch.read(&self.failures),
        })
    }
}

impl CheckReadback {
    /// The outcome, once the batch has run.
    pub fn get(&self, results: &Results) -> Checked {
        let energies = results.get(&self.energies);
        let listed = results.get(&self.failures);
        let count = listed[0] as usize;
        let mut failures: Vec<u32> = listed[1..=count.min(MAX_FAILURES)]
            .iter()
            .map(|t| t + self.first as u32)
            .collect();
        failures.sort_unstable();
        Checked {
            energy: energies.into_iter().map(f64::from).sum(),
            failures: (count <= MAX_FAILURES).then_some(failures),
        }
    }
}

/// The outcomes of several chunks as one.
pub fn merge(parts: impl Iterator<Item = Checked>) -> Checked {
    let mut all = Checked {
        energy: 0.0,
        failures: Some(Vec::new()),
    };
    for part in parts {
        all.energy += part.energy;
        match (&mut all.failures, part.failures) {
            (Some(list), Some(more)) => list.extend(more),
            (list, _) => *list = None,
        }
    }
    all
}

/// The chunks of a number of triangles.
pub fn chunks(triangles: usize) -> impl Iterator<Item = Range<usize>> {
    (0..triangles)
        .step_by(CHUNK)
        .map(move |begin| begin..(begin + CHUNK).min(triangles))
}

/// The centre of the bounding box of some points; zero without points.
pub fn center(points: &[DVec3]) -> DVec3 {
    let bounds = points
        .iter()
        .map(|&p| (p, p))
        .reduce(|(lo, hi), (p, _)| (lo.min(p), hi.max(p)));
    bounds.map_or(DVec3::ZERO, |(lo, hi)| lo + 0.5 * (hi - lo))
}

/// How far f32 may move points about their centre.
pub fn rounding(points: &[DVec3]) -> f64 {
    let center = center(points);
    let reach = points.iter().map(|p| (*p - center).length());
    f64::from(f32::EPSILON / 2.0) * reach.fold(0.0, f64::max)
}

/// Points about an origin, in single precision as the device reads them.
pub fn local(points: &[DVec3], origin: DVec3) -> Vec<[f32; 4]> {
    points
        .iter()
        .map(|&p| (p - origin).as_vec3().extend(0.0).to_array())
        .collect()
}

/// (slot, triangle) of each thread: slots to be clipped first, then those that are alone on their triangle.
fn order(offsets: &[u32]) -> Vec<[u32; 2]> {
    let slots = |alone: bool| {
        (0..)
            .zip(offsets.windows(2))
            .flat_map(move |(triangle, w)| {
                let wanted = (w[1] - w[0] == 1) == alone;
                let range = if wanted { w[0]..w[1] } else { 0..0 };
                range.map(move |slot| [slot, triangle])
            })
    };
    slots(false).chain(slots(true)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lone_slots_come_last_and_none_is_lost() {
        assert_eq!(order(&[0, 1, 3, 3, 4]), [[1, 1], [2, 1], [0, 0], [3, 3]]);
        assert!(order(&[0]).is_empty());
    }

    #[test]
    fn chunks_cover_every_triangle_once() {
        assert_eq!(chunks(0).count(), 0);
        let parts: Vec<_> = chunks(CHUNK + 1).collect();
        assert_eq!(parts, [0..CHUNK, CHUNK..CHUNK + 1]);
    }
}
