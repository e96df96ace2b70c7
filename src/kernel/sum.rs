//! Segmented sums: records gathered and added, each segment in the order of its list.
//!
//! This is how contributions per piece become values per seed or per vertex without atomics: a list says which records belong
//! to each output. On the GPU one thread adds one four-vector of a segment in blocks of 16, so that the rounding error grows
//! with n/16, not with n.

use super::{Kernel, worst_ratio};
use crate::device::{Batch, Buffer, Gpu, Shader, shared_struct, source};
use crate::error::Result;
use rayon::prelude::*;

/// Which records belong to each of some segments, in the order in which they are added.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Segments {
    /// `[segments + 1]`.
    pub offsets: Vec<u32>,
    /// `[offsets.last()]`, numbers of records.
    pub items: Vec<u32>,
}

impl Segments {
    /// For each of `count` keys the places in `keys` where it occurs, ascending.
    ///
    /// # Panics
    /// Where a key is not below `count`.
    pub fn by_key(keys: impl Iterator<Item = u32> + Clone, count: usize) -> Self {
        let mut offsets = vec![0; count + 1];
        for key in keys.clone() {
            offsets[key as usize + 1] += 1;
        }
        for k in 0..count {
            offsets[k + 1] += offsets[k];
        }
        let mut next = offsets.clone();
        let mut items = vec![0; offsets[count] as usize];
        for (place, key) in (0..).zip(keys) {
            let slot = &mut next[key as usize];
            items[*slot as usize] = place;
            *slot += 1;
        }
        Self { offsets, items }
    }

    /// The number of segments.
    pub fn len(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The records of a segment.
    pub fn items(&self, segment: usize) -> &[u32] {
        &self.items[self.offsets[segment] as usize..self.offsets[segment + 1] as usize]
    }
}

shared_struct! {
    /// The parameters of a dispatch.
    pub struct SumParams {
        /// The number of segments.
        segments: u32,
        /// Four-vectors a record.
        stride: u32,
        /// The first four-vector of a record that is summed.
        first: u32,
        /// How many of them are.
        width: u32,
        /// Whether the records of a segment are those between its offsets, without a list.
        consecutive: u32,
        /// Whether the sums are added to what is there.
        accumulate: u32,
    }
}

/// `shaders/sum.wgsl`.
pub const SHADER: Shader = Shader {
    name: "sum",
    structs: &[SumParams::LAYOUT],
    sources: &[source!("shared/grid.wgsl"), source!("sum.wgsl")],
    constants: &[],
};

/// The most records that one thread adds. Longer segments are summed in parts first: a thread may not loop for ever (see
/// [`MAX_ITERATIONS`](crate::device::MAX_ITERATIONS)), and a few long ones would leave a GPU idle.
const PART: u32 = 4096;

/// [`Segments`] on the device.
#[derive(Debug)]
pub struct GpuSegments {
    /// The parts of the segments: the segments themselves where none is long.
    offsets: Buffer<u32>,
    items: Buffer<u32>,
    /// `[segments + 1]`, the parts of each segment. Empty where none is long.
    parts: Buffer<u32>,
    /// The sums of the parts.
    partial: Buffer<[f32; 4]>,
}

impl GpuSegments {
    /// Uploads.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn new(gpu: &Gpu, segments: &Segments) -> Result<Self> {
        let mut uploaded = Self {
            offsets: Buffer::zeroed(gpu, 0)?,
            items: Buffer::zeroed(gpu, 0)?,
            parts: Buffer::zeroed(gpu, 0)?,
            partial: Buffer::zeroed(gpu, 0)?,
        };
        uploaded.write(segments)?;
        Ok(uploaded)
    }

    /// Replaces the lists, in the room that is there where they fit.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn write(&mut self, segments: &Segments) -> Result<()> {
        self.items.write(&segments.items)?;
        if segments.offsets.windows(2).all(|w| w[1] - w[0] <= PART) {
            self.parts.resize(0)?;
            return self.offsets.write(&segments.offsets);
        }
        let (offsets, parts) = split(&segments.offsets);
        self.partial.resize(MAX_WIDTH * offsets.len())?;
        self.offsets.write(&offsets)?;
        self.parts.write(&parts)
    }

    /// Adds to a batch: `sums[s] = Σ records of s` (`+=` where `accumulate`), `[segments, width]`.
    ///
    /// # Errors
    /// Where a buffer passes the adapter's limits.
    pub fn sum(
        &self,
        gpu: &Gpu,
        batch: &mut Batch,
        records: Records<'_>,
        accumulate: bool,
        sums: &Buffer<[f32; 4]>,
    ) -> Result<()> {
        let lists = Lists {
            offsets: &self.offsets,
            items: Some(&self.items),
        };
        if self.parts.is_empty() {
            return lists.sum(gpu, batch, records, accumulate, sums);
        }
        lists.sum(gpu, batch, records, false, &self.partial)?;
        let wholes = Lists {
            offsets: &self.parts,
            items: None,
        };
        let partial = Records::whole(&self.partial, records.width);
        wholes.sum(gpu, batch, partial, accumulate, sums)
    }
}

/// The most four-vectors that are summed of a record.
const MAX_WIDTH: usize = 3;

/// Cuts segments into parts of at most [`PART`] records: the offsets of the parts, and those of the segments among the parts.
fn split(offsets: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let (mut parts, mut wholes) = (vec![0], vec![0]);
    for w in offsets.windows(2) {
        let mut at = w[0];
        while at < w[1] {
            at = w[1].min(at + PART);
            parts.push(at);
        }
        wholes.push(parts.len() as u32 - 1);
    }
    (parts, wholes)
}

/// Which records belong to each segment, on the device.
#[derive(Debug, Clone, Copy)]
pub struct Lists<'a> {
    /// `[segments + 1]`.
    pub offsets: &'a Buffer<u32>,
    /// `[offsets.last()]`; without it the offsets count records.
    pub items: Option<&'a Buffer<u32>>,
}

/// Records on the device, and the part of each that is summed.
#[derive(Debug, Clone, Copy)]
pub struct Records<'a> {
    /// `[records, stride]`.
    pub values: &'a Buffer<[f32; 4]>,
    /// Four-vectors a record.
    pub stride: u32,
    /// The first four-vector that is summed.
    pub first: u32,
    /// How many are.
    pub width: u32,
}

impl<'a> Records<'a> {
    /// Records that are summed whole.
    pub fn whole(values: &'a Buffer<[f32; 4]>, width: u32) -> Self {
        Self {
            values,
            stride: width,
            first: 0,
            width,
        }
    }
}

impl Lists<'_> {
    /// Adds to a batch: `sums[s] = Σ records of s` (`+=` where `accumulate`), `[segments, width]`.
    ///
    /// # Errors
    /// Where a buffer passes the adapter's limits.
    pub fn sum(
        self,
        gpu: &Gpu,
        batch: &mut Batch,
        records: Records<'_>,
        accumulate: bool,
        sums: &Buffer<[f32; 4]>,
    ) -> Result<()> {
        let segments = self.offsets.len() - 1;
        let params = SumParams {
            segments: segments as u32,
            stride: records.stride,
            first: records.first,
            width: records.width,
            consecutive: self.items.is_none().into(),
            accumulate: accumulate.into(),
        };
        batch.dispatch(
            &gpu.pipeline(&SHADER, &[])?,
            segments * records.width as usize,
            &params,
            &[
                &self.offsets.binding(),
                &self.items.unwrap_or(self.offsets).binding(),
                &records.values.binding(),
                &sums.binding(),
            ],
        )
    }
}

/// The twins of the segmented sum.
#[derive(Debug)]
pub struct Sum;

/// What is summed.
#[derive(Debug, Clone)]
pub struct SumInput {
    /// `[records * width]` four-vectors.
    pub values: Vec<[f64; 4]>,
    /// Four-vectors a record.
    pub width: usize,
    /// The records of each sum.
    pub segments: Segments,
}

impl SumInput {
    /// `[segments * width]`, with `term` applied to each component first.
    fn sums(&self, term: impl Fn(f64) -> f64 + Sync) -> Vec<[f64; 4]> {
        (0..self.segments.len() * self.width)
            .into_par_iter()
            .map(|k| {
                let (segment, lane) = (k / self.width, k % self.width);
                self.segments
                    .items(segment)
                    .iter()
                    .fold([0.0; 4], |sum, &item| {
                        let value = self.values[item as usize * self.width + lane];
                        std::array::from_fn(|c| sum[c] + term(value[c]))
                    })
            })
            .collect()
    }
}

/// A [`SumInput`] on the device.
#[derive(Debug)]
pub struct ResidentSum {
    values: Buffer<[f32; 4]>,
    width: u32,
    segments: GpuSegments,
    sums: Buffer<[f32; 4]>,
}

impl Kernel for Sum {
    const NAME: &'static str = SHADER.name;
    /// Of Σ|terms|. Rounding a term to f32 costs 6e-8; adding n of them in blocks of 16 at most (16 + n/16) times as much, which for
    /// the segments here (n up to some thousands) random signs keep near its root. Measured: 2e-7.
    const TOLERANCE: f64 = 1e-6;
    type Input = SumInput;
    /// `[segments * width]`.
    type Output = Vec<[f64; 4]>;
    type Resident = ResidentSum;

    fn items(input: &SumInput) -> usize {
        input.segments.items.len() * input.width
    }

    fn cpu(input: &SumInput) -> Self::Output {
        input.sums(|x| x)
    }

    fn upload(gpu: &Gpu, input: &SumInput) -> Result<ResidentSum> {
        let values: Vec<_> = input.values.iter().map(|v| v.map(|c| c as f32)).collect();
        Ok(ResidentSum {
            values: Buffer::from_slice(gpu, &values)?,
            width: input.width as u32,
            segments: GpuSegments::new(gpu, &input.segments)?,
            sums: Buffer::zeroed(gpu, input.segments.len() * input.width)?,
        })
    }

    fn gpu(gpu: &Gpu, input: &mut ResidentSum) -> Result<Self::Output> {
        let mut batch = gpu.batch();
        let records = Records::whole(&input.values, input.width);
        input
            .segments
            .sum(gpu, &mut batch, records, false, &input.sums)?;
        let read = batch.read(&input.sums);
        let results = batch.submit()?;
        Ok(results
            .get(&read)
            .into_iter()
            .map(|v| v.map(f64::from))
            .collect())
    }

    fn compare(input: &SumInput, cpu: &Self::Output, gpu: &Self::Output) -> f64 {
        let scales = input.sums(f64::abs);
        let parts = |v: &Vec<[f64; 4]>| v.clone().into_iter().flatten();
        worst_ratio(
            parts(cpu)
                .zip(parts(gpu))
                .zip(parts(&scales))
                .map(|((a, b), scale)| ((a - b).abs(), scale)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_segments_are_cut_and_empty_ones_stay() {
        let (parts, wholes) = split(&[0, 3, 3, 3 + 2 * PART + 1]);
        assert_eq!(parts, [0, 3, 3 + PART, 3 + 2 * PART, 4 + 2 * PART]);
        assert_eq!(wholes, [0, 1, 1, 4]);
    }

    #[test]
    fn segments_list_the_places_of_each_key_in_order() {
        let keys = [2u32, 0, 2, 2, 0];
        let segments = Segments::by_key(keys.iter().copied(), 4);
        let lists: Vec<_> = (0..4).map(|s| segments.items(s).to_vec()).collect();
        assert_eq!(lists, [vec![1, 4], vec![], vec![0, 2, 3], vec![]]);
        assert!(Segments::by_key([].into_iter(), 0).is_empty());
    }
}
