//! A tree of bounding boxes over triangles that finds the closest point of a surface.
//!
//! **Theory.** Each node has up to four children and their boxes; the distance from a point to a box bounds the distance to
//! everything inside from below. The search descends into the nearest box first and leaves out boxes that are further than the
//! best triangle so far. Boxes come from a binned surface-area heuristic.
//!
//! **Practice.** Boxes are f32 in a frame where the mesh is centred and about 1 in size, rounded outwards, so that one cache line and a half
//! holds four of them and one vector instruction compares four. They only ever decide what is left out, and always on the safe side:
//! triangles and answers are f64 in the mesh's own coordinates, and agree with a search through all triangles to the bit. Of triangles at
//! exactly the same distance, the one with the lowest index is the answer; it then depends neither on the tree nor on the threads.

mod build;

use super::morton;
use super::triangle::Triangle;
use crate::error::{Error, Result};
use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3A, Vec4};
use rayon::prelude::*;

/// Levels down to which the heuristic decides; from there on nodes are halved by count, which bounds the depth.
const HEURISTIC_LEVELS: usize = 16;
/// Entries of the search stack: each level leaves at most three behind, and 2²⁸ triangles halved twice a level add 14 levels.
const STACK_SIZE: usize = 3 * (HEURISTIC_LEVELS + 14) + 4;
/// Queries that one thread answers in a row, each starting from the answer before it.
const QUERY_CHUNK: usize = 256;
/// Covers the rounding of a squared distance between a point and a box in f32: five operations, 2⁻²⁴ each.
const ROUNDING: f32 = 1.0 + 1.0 / (1 << 20) as f32;
/// Marks a child that is a leaf.
const LEAF: u32 = 1 << 31;
/// Bits of a leaf's reference that hold its count.
const COUNT_BITS: u32 = 3;
/// Where the box of an absent child is: out of reach, with a square that is still finite in f32.
const NOWHERE: f32 = 1e18;

/// The closest point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// The triangle it is on.
    pub triangle: u32,
    /// Weights of that triangle's corners: non-negative, sum 1 to rounding, exactly 0 on the opposite edge.
    pub barycentric: [f64; 3],
    /// The point itself.
    pub point: DVec3,
    /// Its squared distance from the query.
    pub distance_squared: f64,
}

/// A bounding volume hierarchy over the triangles of a mesh; see the module.
#[derive(Debug, Clone)]
pub struct Bvh {
    /// The root first.
    pub(crate) nodes: Vec<Node>,
    /// `[triangles]`, in the order of the leaves.
    pub(crate) leaves: Vec<Leaf>,
    /// From the mesh's coordinates to those of the boxes: subtract, then multiply.
    pub(crate) center: DVec3,
    pub(crate) scale: f64,
}

/// Four children: their boxes coordinate by coordinate, and where they are.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Node {
    pub lo: [Vec4; 3],
    pub hi: [Vec4; 3],
    /// The index of a node, or [`LEAF`] | first << [`COUNT_BITS`] | count for a run of leaves. Absent children are leaves of count 0.
    pub children: [u32; 4],
}

/// A triangle and its index in the mesh.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Leaf {
    pub triangle: Triangle,
    pub index: u32,
}

/// The best triangle that a search has found so far.
#[derive(Clone, Copy)]
struct Best {
    distance_squared: f64,
    /// Its index in the mesh; `u32::MAX` for none.
    index: u32,
    /// Its place among the leaves.
    slot: u32,
    barycentric: [f64; 3],
}

impl Bvh {
    /// The tree of a mesh: about 25 ms of one thread for 70,000 triangles. To follow a moving surface, build it again.
    ///
    /// `positions` must be finite and `triangles` (`[triangles, 3]`, at most 2²⁸) index into them; degenerate and duplicate triangles are welcome.
    ///
    /// # Errors
    /// Where there is no triangle: nothing is then closest.
    pub fn new(positions: &[DVec3], triangles: &[[u32; 3]]) -> Result<Self> {
        if triangles.is_empty() || triangles.len() >> (31 - COUNT_BITS) != 0 {
            return Err(Error::input(
                format!("a search tree over {} triangles", triangles.len()),
                "give a surface with at least one triangle and fewer than 2^28",
            ));
        }
        let corners = |t: &[u32; 3]| t.map(|v| positions[v as usize]);
        let (lo, hi) = triangles.par_iter().map(|t| bounds_of(corners(t))).reduce(
            || (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |a, b| (a.0.min(b.0), a.1.max(b.1)),
        );
        let center = lo + 0.5 * (hi - lo);
        let extent = (hi - lo).max_element();
        let scale = if extent > 0.0 { extent.recip() } else { 1.0 };
        let mut items: Vec<build::Item> = triangles
            .par_iter()
            .enumerate()
            .map(|(index, t)| build::Item {
                bounds: Bounds::of(corners(t), center, scale),
                index: index as u32,
            })
            .collect();
        let nodes = build::tree(&mut items);
        let leaves = items
            .par_iter()
            .map(|item| Leaf {
                triangle: Triangle::new(corners(&triangles[item.index as usize])),
                index: item.index,
            })
            .collect();
        Ok(Self {
            nodes,
            leaves,
            center,
            scale,
        })
    }

    /// Follows the mesh when its vertices have moved, in a tenth of the time of a new tree. Answers stay exact; they take longer the further
    /// neighbours have moved apart.
    ///
    /// `triangles` must be those that the tree was built over.
    pub fn refit(&mut self, positions: &[DVec3], triangles: &[[u32; 3]]) {
        let (center, scale) = (self.center, self.scale);
        let moved = self.leaves.par_iter_mut().with_min_len(1024).map(|leaf| {
            let corners = triangles[leaf.index as usize].map(|v| positions[v as usize]);
            leaf.triangle = Triangle::new(corners);
            Bounds::of(corners, center, scale)
        });
        let bounds: Vec<Bounds> = moved.collect();
        // Children come after their parents.
        for at in (0..self.nodes.len()).rev() {
            for k in 0..4 {
                let child = self.nodes[at].children[k];
                let bounds = if child & LEAF == 0 {
                    self.nodes[child as usize].bounds()
                } else {
                    let (first, count) = leaf_range(child);
                    let leaves = &bounds[first as usize..(first + count) as usize];
                    match leaves.iter().copied().reduce(Bounds::union) {
                        Some(bounds) => bounds,
                        None => continue,
                    }
                };
                self.nodes[at].set_bounds(k, bounds);
            }
        }
    }

    /// The point of the surface closest to `p`.
    pub fn closest(&self, p: DVec3) -> ClosestPoint {
        self.answer(&self.search(p, self.candidate(p, 0), 0.0, |_| true))
    }

    /// The point of the surface closest to `p`, if it is no further away than `distance`.
    pub fn closest_within(&self, p: DVec3, distance: f64) -> Option<ClosestPoint> {
        self.closest_of(p, distance, |_| true)
    }

    /// The same of those triangles, by their index, that are `wanted`.
    pub fn closest_of(
        &self,
        p: DVec3,
        distance: f64,
        wanted: impl Fn(u32) -> bool,
    ) -> Option<ClosestPoint> {
        let nothing = Best {
            distance_squared: distance * distance,
            index: u32::MAX,
            slot: 0,
            barycentric: [0.0; 3],
        };
        let best = self.search(p, nothing, 0.0, wanted);
        (best.index != u32::MAX).then(|| self.answer(&best))
    }

    /// [`Self::closest`] of many points, in parallel and in their order; the same answers to the bit.
    pub fn closest_all(&self, points: &[DVec3]) -> Vec<ClosestPoint> {
        self.closest_beyond(points, 0.0)
    }

    /// The same of those points that are further than `enough` from the surface; for the others any point of the surface that is no further.
    /// Where most points are near that takes a fraction of the time. Answers repeat, but for points so near they depend on what else is asked.
    pub fn closest_beyond(&self, points: &[DVec3], enough: f64) -> Vec<ClosestPoint> {
        let order = morton::order(points);
        let sorted: Vec<ClosestPoint> = order
            .par_chunks(QUERY_CHUNK)
            .flat_map_iter(|chunk| {
                chunk.iter().scan(0, |slot, &i| {
                    let p = points[i as usize];
                    let first = self.candidate(p, *slot);
                    let best = self.search(p, first, enough * enough, |_| true);
                    *slot = best.slot;
                    Some(self.answer(&best))
                })
            })
            .collect();
        let mut place = vec![0; order.len()];
        for (k, &i) in order.iter().enumerate() {
            place[i as usize] = k;
        }
        place.into_par_iter().map(|k| sorted[k]).collect()
    }

    /// The triangle in a slot as a first answer; a good one lets the search leave out most of the tree.
    fn candidate(&self, p: DVec3, slot: u32) -> Best {
        let leaf = &self.leaves[slot as usize];
        let nearest = leaf.triangle.nearest(p);
        Best {
            distance_squared: nearest.distance_squared,
            index: leaf.index,
            slot,
            barycentric: nearest.barycentric,
        }
    }

    fn answer(&self, best: &Best) -> ClosestPoint {
        ClosestPoint {
            triangle: best.index,
            barycentric: best.barycentric,
            point: self.leaves[best.slot as usize]
                .triangle
                .point(best.barycentric),
            distance_squared: best.distance_squared,
        }
    }

    /// The better of `best` and every triangle of the tree that is wanted, or the first that is found whose squared distance is less than `enough`.
    fn search(&self, p: DVec3, mut best: Best, enough: f64, wanted: impl Fn(u32) -> bool) -> Best {
        if best.distance_squared < enough {
            return best;
        }
        let local = (p - self.center) * self.scale;
        let (lo, hi) = (round_down(local).to_array(), round_up(local).to_array());
        let mut limit = self.limit(best.distance_squared);
        // Entries are a box's squared distance (its bits sort like the number) over the child's reference.
        let mut stack = [0u64; STACK_SIZE];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let entry = stack[height];
            if distance_of(entry) > limit {
                continue;
            }
            let child = entry as u32;
            if child & LEAF != 0 {
                let (first, count) = leaf_range(child);
                for slot in first..first + count {
                    let candidate = self.candidate(p, slot);
                    if candidate.beats(&best) && wanted(candidate.index) {
                        best = candidate;
                        if best.distance_squared < enough {
                            return best;
                        }
                        limit = self.limit(best.distance_squared);
                    }
                }
            } else {
                for entry in self.nodes[child as usize].far_to_near(lo, hi) {
                    // Written whether it counts or not: a branch here would be mispredicted.
                    stack[height] = entry;
                    height += usize::from(distance_of(entry) <= limit);
                }
            }
        }
        best
    }

    /// The largest squared distance of a box, as computed in f32, that may hold something within the given squared distance.
    fn limit(&self, distance_squared: f64) -> f32 {
        ((distance_squared * self.scale * self.scale) as f32 * ROUNDING).next_up()
    }
}

impl Best {
    #[inline]
    fn beats(&self, other: &Self) -> bool {
        self.distance_squared < other.distance_squared
            || (self.distance_squared == other.distance_squared && self.index < other.index)
    }
}

impl Node {
    const EMPTY: Self = Self {
        lo: [Vec4::splat(NOWHERE); 3],
        hi: [Vec4::splat(NOWHERE); 3],
        children: [LEAF; 4],
    };

    fn set_bounds(&mut self, k: usize, bounds: Bounds) {
        for axis in 0..3 {
            self.lo[axis][k] = bounds.lo[axis];
            self.hi[axis][k] = bounds.hi[axis];
        }
    }

    /// Around all children that are not absent.
    fn bounds(&self) -> Bounds {
        let present = (0..4).filter(|&k| self.children[k] != LEAF);
        present.fold(Bounds::EMPTY, |sum, k| {
            let of = |axes: &[Vec4; 3]| Vec3A::new(axes[0][k], axes[1][k], axes[2][k]);
            sum.union(Bounds {
                lo: of(&self.lo),
                hi: of(&self.hi),
            })
        })
    }

    /// The children as stack entries, the furthest first, for a point between `lo` and `hi`.
    #[inline]
    fn far_to_near(&self, lo: [f32; 3], hi: [f32; 3]) -> [u64; 4] {
        let mut squared = Vec4::ZERO;
        for axis in 0..3 {
            let gap = (self.lo[axis] - Vec4::splat(hi[axis]))
                .max(Vec4::splat(lo[axis]) - self.hi[axis])
                .max(Vec4::ZERO);
            squared += gap * gap;
        }
        let squared = squared.to_array();
        let entry = |k: usize| u64::from(squared[k].to_bits()) << 32 | u64::from(self.children[k]);
        let sort = |a: u64, b: u64| (a.max(b), a.min(b));
        let (a, b) = sort(entry(0), entry(1));
        let (c, d) = sort(entry(2), entry(3));
        let (a, c) = sort(a, c);
        let (b, d) = sort(b, d);
        let (b, c) = sort(b, c);
        [a, b, c, d]
    }
}

/// The squared distance in a stack entry.
#[inline]
fn distance_of(entry: u64) -> f32 {
    f32::from_bits((entry >> 32) as u32)
}

/// The first slot of a leaf and how many it has.
#[inline]
fn leaf_range(child: u32) -> (u32, u32) {
    (
        (child & !LEAF) >> COUNT_BITS,
        child & ((1 << COUNT_BITS) - 1),
    )
}

/// Lowest and highest coordinates of three points.
fn bounds_of([a, b, c]: [DVec3; 3]) -> (DVec3, DVec3) {
    (a.min(b).min(c), a.max(b).max(c))
}

/// Strictly below `p`, by more than the rounding of `p` itself.
fn round_down(p: DVec3) -> Vec3A {
    p.as_vec3a().map(f32::next_down)
}

/// Strictly above `p`, by more than the rounding of `p` itself.
fn round_up(p: DVec3) -> Vec3A {
    p.as_vec3a().map(f32::next_up)
}

/// A box in the coordinates of the tree.
#[derive(Clone, Copy)]
struct Bounds {
    lo: Vec3A,
    hi: Vec3A,
}

impl Bounds {
    const EMPTY: Self = Self {
        lo: Vec3A::splat(NOWHERE),
        hi: Vec3A::splat(-NOWHERE),
    };

    /// Those of a triangle, whose corners `center` and `scale` bring to the coordinates of the tree.
    fn of(corners: [DVec3; 3], center: DVec3, scale: f64) -> Self {
        let (lo, hi) = bounds_of(corners.map(|p| (p - center) * scale));
        Self {
            lo: round_down(lo),
            hi: round_up(hi),
        }
    }

    fn union(self, other: Self) -> Self {
        Self {
            lo: self.lo.min(other.lo),
            hi: self.hi.max(other.hi),
        }
    }

    /// Half the surface area.
    fn half_area(&self) -> f32 {
        let d = self.hi - self.lo;
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    /// Twice the centre.
    fn center(&self) -> Vec3A {
        self.lo + self.hi
    }
}

#[cfg(test)]
mod tests;
