//! Candidate seeds: for every triangle, the seeds whose Voronoi cells may meet it.
//!
//! One search (`candidate_search.rs`) ends with lists for groups of a few neighbouring triangles. Of such a list a
//! triangle keeps what another seed does not beat: seed j can be nearest somewhere on it only if f(y) = |y − x_j|² −
//! |y − x_i|² is negative at a corner, f being affine. First i is the seed nearest to the corners together, then every
//! survivor.
//!
//! The search only ever drops a seed that is certainly too far, so it runs in f32, four seeds at once, with a margin for
//! rounding; the clip in f64 decides exactly. Lists stay as short: margins matter only where two seeds tie.
//!
//! **Skin.** Lists stay complete while no seed and triangle corner together have moved further than `slack`: j is
//! dropped only where |y − x_j| > |y − x_i| + 2 slack, that is f(y) > 4 slack |y − x_i| + 4 slack². The difference of the
//! two sides is concave, so corners decide for the triangle.
//!
//! **On a GPU** the host searches the groups' lists, and the device prunes each for every triangle of its group, in the same
//! arithmetic. It answers with one bit a seed of the list.

use super::candidate_search::{Collect, List, ROUNDING, Search};
use super::seed_tree::Four;
use super::{Kernel, slots};
use crate::device::{Buffer, Device, Gpu, Shader, shared_struct, source};
use crate::error::Result;
use crate::geometry::triangle_tree::TriangleTree;
use glam::{DVec3, Vec3A, Vec4};
use std::ops::Range;

/// The candidates of each triangle, in compressed sparse rows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Candidates {
    /// `[triangles + 1]`.
    pub offsets: Vec<u32>,
    /// `[slots]`, seed indices, ascending within a triangle.
    pub seeds: Vec<u32>,
    /// How far seeds and triangles together may move before the lists can be incomplete.
    pub slack: f64,
}

impl Candidates {
    /// The candidates of triangle `t`.
    pub fn of(&self, t: usize) -> &[u32] {
        &self.seeds[self.offsets[t] as usize..self.offsets[t + 1] as usize]
    }

    /// The lists of some of the triangles, in the order named.
    pub fn select(&self, triangles: &[u32]) -> Self {
        let mut selected = Self {
            offsets: vec![0],
            seeds: Vec::new(),
            slack: self.slack,
        };
        for &t in triangles {
            selected.seeds.extend(self.of(t as usize));
            selected.offsets.push(selected.seeds.len() as u32);
        }
        selected
    }

    /// [`find`](Self::find) with the pruning on a device.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn find_on(
        device: &Device,
        tree: &TriangleTree,
        triangles: &[[DVec3; 3]],
        seeds: &[DVec3],
        slack: f64,
    ) -> Result<Self> {
        let Device::Gpu(gpu) = device else {
            return Ok(Self::find(tree, triangles, seeds, slack));
        };
        let Some(search) = Search::new(tree, triangles, seeds, slack) else {
            return Ok(Self::empty(triangles.len(), slack));
        };
        let groups = Groups::join(&search.run());
        if groups.lists.iter().any(|l| l[1] - l[0] > MAX_LIST) {
            return Ok(Self::find(tree, triangles, seeds, slack));
        }
        groups.prune(gpu, &search, triangles, seeds, slack)
    }

    /// Finds them for triangles in the tree's order. Empty lists where there are no seeds.
    pub fn find(
        tree: &TriangleTree,
        triangles: &[[DVec3; 3]],
        seeds: &[DVec3],
        slack: f64,
    ) -> Self {
        let Some(search) = Search::new(tree, triangles, seeds, slack) else {
            return Self::empty(triangles.len(), slack);
        };
        let parts: Vec<Part> = search.run();
        let slots = parts.iter().map(|part| part.seeds.len()).sum();
        let mut found = Self {
            offsets: Vec::with_capacity(triangles.len() + 1),
            seeds: Vec::with_capacity(slots),
            slack,
        };
        found.offsets.push(0);
        for part in parts {
            let base = found.seeds.len() as u32;
            found.offsets.extend(part.ends.iter().map(|e| base + e));
            found.seeds.extend(part.seeds);
        }
        found
    }

    fn empty(triangles: usize, slack: f64) -> Self {
        Self {
            offsets: vec![0; triangles + 1],
            seeds: Vec::new(),
            slack,
        }
    }
}

/// The lists of consecutive triangles, with what their search works on.
#[derive(Default)]
struct Part {
    ends: Vec<u32>,
    seeds: Vec<u32>,
    /// The list of a group, with the seeds' indices.
    list: Vec<(Four, [u32; 4])>,
    /// Its squared distances to a triangle's three corners.
    squared: Vec<[Vec4; 3]>,
    survivors: Vec<Survivor>,
}

/// A seed that the nearest one does not beat on a triangle.
#[derive(Clone, Copy)]
struct Survivor {
    index: u32,
    /// Its squared distances to the corners.
    squared: Vec4,
    /// What it beats.
    beaten: Vec4,
}

impl Collect for Part {
    fn group(&mut self, search: &Search<'_>, triangles: Range<usize>, list: List<'_>) {
        if list.len == 1 {
            for _ in triangles {
                self.seeds.push(list.fours[0][0].index());
                self.ends.push(self.seeds.len() as u32);
            }
            return;
        }
        self.list.clear();
        let fours = list.fours.iter();
        self.list
            .extend(fours.map(|four| (Four::of(four), four.map(|seed| seed.index()))));
        for corners in search.corners(triangles) {
            self.triangle(corners, search.slack);
        }
    }
}

impl Part {
    /// Appends the candidates of a triangle, ascending.
    fn triangle(&mut self, corners: [Vec3A; 3], slack: f32) {
        let nearest = self.measure(corners);
        let beaten = beaten_from(nearest, slack);
        let [b0, b1, b2, _] = beaten.to_array().map(Vec4::splat);
        self.survivors.clear();
        for ((_, indices), [d0, d1, d2]) in self.list.iter().zip(&self.squared) {
            let drops = d0.cmpgt(b0) & d1.cmpgt(b1) & d2.cmpgt(b2);
            let mut keeps = !drops.bitmask() & 0b1111;
            while keeps != 0 {
                let k = keeps.trailing_zeros() as usize;
                keeps &= keeps - 1;
                let squared = Vec4::new(d0[k], d1[k], d2[k], d2[k]);
                self.survivors.push(Survivor {
                    index: indices[k],
                    squared,
                    beaten: beaten_from(squared, slack),
                });
            }
        }
        let begin = self.seeds.len();
        // Nothing beats itself, and what is beaten may still beat others, so the order does not matter.
        let stays = |s: &&Survivor| {
            !self
                .survivors
                .iter()
                .any(|t| s.squared.cmpgt(t.beaten).all())
        };
        self.seeds
            .extend(self.survivors.iter().filter(stays).map(|s| s.index));
        self.seeds[begin..].sort_unstable();
        self.ends.push(self.seeds.len() as u32);
    }

    /// Fills `squared`; those of the seed of least sum.
    fn measure(&mut self, corners: [Vec3A; 3]) -> Vec4 {
        let mut best = f32::INFINITY;
        let mut nearest = Vec4::INFINITY;
        self.squared.clear();
        for (four, _) in &self.list {
            let squared = corners.map(|p| four.squared_distances(p));
            let [d0, d1, d2] = squared;
            let sum = d0 + d1 + d2;
            if sum.cmplt(Vec4::splat(best)).any() {
                for k in 0..4 {
                    if sum[k] < best {
                        best = sum[k];
                        nearest = Vec4::new(d0[k], d1[k], d2[k], d2[k]);
                    }
                }
            }
            self.squared.push(squared);
        }
        nearest
    }
}

/// The squared corner distances beyond which a seed is nowhere on the triangle nearer than one at these, now and after
/// motions within the slack.
fn beaten_from(squared: Vec4, slack: f32) -> Vec4 {
    let distance = Vec4::from_array(squared.to_array().map(f32::sqrt));
    let reach = distance + 2.0 * slack;
    squared + 4.0 * slack * (distance + slack) + ROUNDING * (reach + reach * reach)
}

shared_struct! {
    /// The parameters of a dispatch.
    pub struct CandidateParams {
        /// The number of triangles.
        triangles: u32,
        /// The slack in the local frame.
        slack: f32,
    }
}

/// `shaders/candidates.wgsl`.
pub const SHADER: Shader = Shader {
    name: "candidates",
    structs: &[CandidateParams::LAYOUT],
    sources: &[source!("shared/grid.wgsl"), source!("candidates.wgsl")],
    constants: &[],
};

/// The longest list that a thread prunes: it runs twice through it, and then through its survivors (see
/// [`MAX_ITERATIONS`](crate::device::MAX_ITERATIONS)).
const MAX_LIST: u32 = 16_384;

/// The lists of the groups, for the device to prune.
#[derive(Default)]
struct Groups {
    /// `[triangles]`: where the list of its group begins and ends, and the first word of its bits.
    lists: Vec<[u32; 4]>,
    /// The seeds of the lists, group after group, ascending in each.
    seeds: Vec<u32>,
    /// The number of words of bits.
    words: u32,
}

impl Collect for Groups {
    fn group(&mut self, _: &Search<'_>, triangles: Range<usize>, list: List<'_>) {
        let begin = self.seeds.len();
        let seeds = list.fours.as_flattened()[..list.len].iter();
        self.seeds.extend(seeds.map(|seed| seed.index()));
        self.seeds[begin..].sort_unstable();
        let (begin, end) = (begin as u32, self.seeds.len() as u32);
        for _ in triangles {
            self.lists.push([begin, end, self.words, 0]);
            self.words += (end - begin).div_ceil(u32::BITS);
        }
    }
}

impl Groups {
    fn join(parts: &[Self]) -> Self {
        let mut all = Self::default();
        for part in parts {
            let base = all.seeds.len() as u32;
            let lists = part.lists.iter();
            all.lists
                .extend(lists.map(|&[b, e, w, _]| [base + b, base + e, all.words + w, 0]));
            all.seeds.extend(&part.seeds);
            all.words += part.words;
        }
        all
    }

    /// Has the device prune the lists.
    fn prune(
        &self,
        gpu: &Gpu,
        search: &Search<'_>,
        triangles: &[[DVec3; 3]],
        seeds: &[DVec3],
        slack: f64,
    ) -> Result<Candidates> {
        let local = |&p: &DVec3| search.local(p).extend(0.0).to_array();
        let seeds = Buffer::from_slice(gpu, &seeds.iter().map(local).collect::<Vec<_>>())?;
        let mut found = Candidates {
            offsets: vec![0],
            seeds: Vec::new(),
            slack,
        };
        for range in slots::chunks(self.lists.len()) {
            let corners = triangles[range.clone()].as_flattened();
            let corners: Vec<_> = corners.iter().map(local).collect();
            self.prune_chunk(
                gpu,
                &self.lists[range],
                &corners,
                &seeds,
                search.slack,
                &mut found,
            )?;
        }
        Ok(found)
    }

    fn prune_chunk(
        &self,
        gpu: &Gpu,
        lists: &[[u32; 4]],
        corners: &[[f32; 4]],
        seeds: &Buffer<[f32; 4]>,
        slack: f32,
        found: &mut Candidates,
    ) -> Result<()> {
        let (first, last) = (lists[0], lists[lists.len() - 1]);
        let items = &self.seeds[first[0] as usize..last[1] as usize];
        let words = last[2] - first[2] + (last[1] - last[0]).div_ceil(u32::BITS);
        let lists: Vec<_> = lists
            .iter()
            .map(|&[b, e, w, _]| [b - first[0], e - first[0], w - first[2], 0])
            .collect();
        let kept = Buffer::<u32>::zeroed(gpu, words as usize)?;
        let mut batch = gpu.batch();
        batch.dispatch(
            &gpu.pipeline(&SHADER, &[])?,
            lists.len(),
            &CandidateParams {
                triangles: lists.len() as u32,
                slack,
            },
            &[
                &Buffer::from_slice(gpu, corners)?.binding(),
                &seeds.binding(),
                &Buffer::from_slice(gpu, &lists)?.binding(),
                &Buffer::from_slice(gpu, items)?.binding(),
                &kept.binding(),
            ],
        )?;
        let read = batch.read(&kept);
        let bits = batch.submit()?.get(&read);
        for [begin, end, word, _] in lists {
            let list = &items[begin as usize..end as usize];
            found
                .seeds
                .extend(list.iter().enumerate().filter_map(|(k, &seed)| {
                    let bit = bits[word as usize + k / 32] >> (k % 32) & 1;
                    (bit == 1).then_some(seed)
                }));
            found.offsets.push(found.seeds.len() as u32);
        }
        Ok(())
    }
}

/// The twins of the candidate search.
#[derive(Debug)]
pub struct CandidateSeeds;

/// Triangles in a spatial order, seeds, and how far they may move.
#[derive(Debug, Clone)]
pub struct CandidateInput {
    /// T or S.
    pub triangles: Vec<[DVec3; 3]>,
    /// x or y.
    pub seeds: Vec<DVec3>,
    /// For [`Candidates::slack`].
    pub slack: f64,
}

impl Kernel for CandidateSeeds {
    const NAME: &'static str = SHADER.name;
    /// Entries too many, as a share of all. Both twins prune in f32 with the same margin, and differ where a seed is within
    /// rounding of it. Measured: 0 on all scenes of the tests.
    const TOLERANCE: f64 = 1e-3;
    type Input = CandidateInput;
    type Output = Candidates;
    type Resident = CandidateInput;

    fn items(input: &CandidateInput) -> usize {
        input.triangles.len()
    }

    fn cpu(input: &CandidateInput) -> Candidates {
        let tree = TriangleTree::new(&input.triangles);
        Candidates::find(&tree, &input.triangles, &input.seeds, input.slack)
    }

    fn upload(_: &Gpu, input: &CandidateInput) -> Result<CandidateInput> {
        Ok(input.clone())
    }

    fn gpu(gpu: &Gpu, input: &mut CandidateInput) -> Result<Candidates> {
        let tree = TriangleTree::new(&input.triangles);
        let device = Device::Gpu(gpu.clone());
        Candidates::find_on(&device, &tree, &input.triangles, &input.seeds, input.slack)
    }

    /// Infinite where a seed is missing to which a sampled point of a triangle is nearest; else the share of entries that the
    /// CPU does not have.
    fn compare(input: &CandidateInput, cpu: &Candidates, gpu: &Candidates) -> f64 {
        if gpu.offsets.len() != cpu.offsets.len() {
            return f64::INFINITY;
        }
        let nearest = |list: &[u32], p: DVec3| {
            let squared = |&s: &u32| (input.seeds[s as usize] - p).length_squared();
            list.iter().map(squared).fold(f64::INFINITY, f64::min)
        };
        let mut extra = 0;
        for (t, &[a, b, c]) in input.triangles.iter().enumerate() {
            let (ours, theirs) = (cpu.of(t), gpu.of(t));
            let mut samples =
                [a, b, c, (a + b) / 2.0, (b + c) / 2.0, (a + b + c) / 3.0].into_iter();
            if samples.any(|p| nearest(theirs, p) > nearest(ours, p)) {
                return f64::INFINITY;
            }
            extra += theirs.iter().filter(|s| !ours.contains(s)).count();
        }
        extra as f64 / cpu.seeds.len().max(1) as f64
    }
}
