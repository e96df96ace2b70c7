//! The nearest point of the surface by a search that cannot miss.
//!
//! **Theory.** Basis functions are positive and sum to 1, so a piece of the surface lies in the convex hull of its control points. For any unit vector w no point of the piece is
//! nearer to a query q than min (cᵢ − q)·w. Two directions serve: towards the middle of the piece, and towards the best point so far, which is square to
//! the surface there and makes the bound as sharp as the piece is flat. Pieces that may hold something nearer than the best by more than a tolerance are
//! refined into four; the middle of a piece that is nearer than the best starts Newton's method. Pieces become flat as the square of their size, so this ends.
//!
//! **Practice.** The quarters of the control faces stand in a tree of boxes, which is left out where it is further than the best.

use super::irregular::{self, Irregular};
use super::newton::{Range, Status, SurfacePoint};
use super::{Patches, SurfaceParameter, domain};
use crate::error::Result;
use crate::geometry::triangle_tree::{Node, fit_boxes, spatial_order};
use glam::{DMat2, DVec2, DVec3};
use rayon::prelude::*;

/// Queries that one thread answers in a row.
const CHUNK: usize = 64;
/// Refinements of a quarter at most: below, a piece is smaller than rounding.
const DEPTH: u32 = 60;

/// The patches of a surface, ready to be searched.
#[derive(Debug)]
pub struct PatchSearch<'a> {
    patches: &'a Patches<'a>,
    /// The quarters in the order of the tree.
    order: Vec<u32>,
    /// By [`Node::index`].
    boxes: Vec<[DVec3; 2]>,
    /// From the control points of a regular patch to those of its four quarters.
    refinements: [Vec<f64>; 4],
    /// The nearest point may be nearer than the one found by this.
    tolerance: f64,
}

/// A piece of the surface.
struct Piece<'a> {
    face: u32,
    /// From the piece's own parameters to the face's.
    linear: DMat2,
    offset: DVec2,
    /// The tables of its irregular corner.
    table: Option<&'a Irregular>,
    points: Vec<DVec3>,
    depth: u32,
}

impl<'a> PatchSearch<'a> {
    /// Builds the tree. O(faces log faces).
    ///
    /// # Errors
    /// None for a surface that could be made.
    pub fn new(patches: &'a Patches<'a>, tolerance: f64) -> Result<Self> {
        let surface = patches.surface;
        let hull = |q: usize| {
            let (indices, _) = surface.quarter(q);
            let mut points = indices.iter().map(|&i| patches.points[i as usize]);
            let first = points.next().unwrap_or_default();
            points.fold([first; 2], |[lo, hi], p| [lo.min(p), hi.max(p)])
        };
        let hulls: Vec<_> = (0..surface.quarters.len())
            .into_par_iter()
            .map(hull)
            .collect();
        let middles: Vec<DVec3> = hulls.iter().map(|[lo, hi]| 0.5 * (*lo + *hi)).collect();
        let order = spatial_order(&middles);
        let union = |a: [DVec3; 2], b: [DVec3; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        let empty = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let mut boxes = Vec::new();
        let leaf = |range: std::ops::Range<usize>| {
            order[range]
                .iter()
                .fold(empty, |b, &q| union(b, hulls[q as usize]))
        };
        fit_boxes(order.len(), &mut boxes, empty, leaf, union);
        Ok(Self {
            patches,
            boxes,
            refinements: irregular::regular_refinements(surface.split)?,
            order,
            tolerance,
        })
    }

    /// The nearest point to each query: no point of the surface is nearer by more than the tolerance. `known`: a point of the surface for each query to begin
    /// with, the nearer the faster, or nothing at all. The same bits for any number of threads.
    pub fn nearest_all(&self, queries: &[DVec3], known: &[SurfacePoint]) -> Vec<SurfacePoint> {
        (queries.par_iter().enumerate())
            .with_min_len(CHUNK)
            .map(|(i, &query)| self.nearest(query, known.get(i).copied()))
            .collect()
    }

    /// The nearest point to a query.
    pub fn nearest(&self, query: DVec3, known: Option<SurfacePoint>) -> SurfacePoint {
        let anywhere = SurfaceParameter {
            face: 0,
            u: 0.0,
            v: 0.0,
        };
        let mut best = known.unwrap_or_else(|| self.start(query, anywhere));
        best.distance = (best.position - query).length();
        let query = query - self.patches.origin;
        best.position -= self.patches.origin;
        let mut stack = vec![(0.0, Node::root(self.order.len()))];
        while let Some((bound, node)) = stack.pop() {
            if !self.may_improve(bound, &best) {
                continue;
            }
            if node.is_leaf() {
                for &q in &self.order[node.range()] {
                    self.refine(&self.piece(q), query, &mut best);
                }
                continue;
            }
            let mut children = node.children().map(|child| {
                let [lo, hi] = self.boxes[child.index()];
                ((query.clamp(lo, hi) - query).length(), child)
            });
            if children[0].0 < children[1].0 {
                children.swap(0, 1);
            }
            stack.extend(children);
        }
        best.status = Status::Converged;
        best.position += self.patches.origin;
        best
    }

    /// A first point: the one that Newton's method finds.
    fn start(&self, query: DVec3, at: SurfaceParameter) -> SurfacePoint {
        let tolerance = 1e-3 * self.tolerance;
        self.patches.descend(query, at, Range::Face, tolerance)
    }

    fn may_improve(&self, bound: f64, best: &SurfacePoint) -> bool {
        bound < best.distance - self.tolerance
    }

    fn piece(&self, q: u32) -> Piece<'a> {
        let surface = self.patches.surface;
        let (indices, table) = surface.quarter(q as usize);
        let (linear, offset) = domain::quarter_to_face(surface.split, q as usize % 4);
        Piece {
            face: q / 4,
            linear,
            offset,
            table,
            points: indices
                .iter()
                .map(|&i| self.patches.points[i as usize])
                .collect(),
            depth: 0,
        }
    }

    /// Makes `best` the nearest point of a piece if that is nearer.
    fn refine(&self, piece: &Piece<'a>, query: DVec3, best: &mut SurfacePoint) {
        if piece.depth > DEPTH || !self.may_improve(piece.bound(query, best.position), best) {
            return;
        }
        // The middle of the points is near the surface, and cheaper.
        if (piece.middle() - query).length() < best.distance && self.improve(piece, query, best) {
            return self.refine(piece, query, best);
        }
        let mut parts = [0, 1, 2, 3].map(|k| self.quarter(piece, k));
        let order = |p: &Piece| (p.middle() - query).length_squared();
        parts.sort_by(|a, b| order(a).total_cmp(&order(b)));
        for part in &parts {
            self.refine(part, query, best);
        }
    }

    /// Starts Newton's method in the middle of a piece if that is nearer than the best.
    fn improve(&self, piece: &Piece<'a>, query: DVec3, best: &mut SurfacePoint) -> bool {
        let middle = piece.linear * domain::center(self.patches.surface.split) + piece.offset;
        let at = SurfaceParameter {
            face: piece.face,
            u: middle.x,
            v: middle.y,
        };
        let is_nearer = (self.patches.local(at).position - query).length() < best.distance;
        if is_nearer {
            *best = self.start(query + self.patches.origin, at);
            best.position -= self.patches.origin;
        }
        is_nearer
    }

    /// Quarter `k` of a piece.
    fn quarter(&self, piece: &Piece<'a>, k: usize) -> Piece<'a> {
        let split = self.patches.surface.split;
        let (linear, offset) = domain::quarter_to_face(split, k);
        let (points, table) = match piece.table {
            Some(table) => (
                table.quarter(&piece.points, k),
                piece.table.filter(|_| k == 0),
            ),
            None => (irregular::apply(&self.refinements[k], &piece.points), None),
        };
        Piece {
            face: piece.face,
            linear: piece.linear * linear,
            offset: piece.linear * offset + piece.offset,
            table,
            points,
            depth: piece.depth + 1,
        }
    }
}

impl Piece<'_> {
    fn middle(&self) -> DVec3 {
        self.points.iter().sum::<DVec3>() / self.points.len() as f64
    }

    /// No point of the piece is nearer to the query than this.
    fn bound(&self, query: DVec3, best: DVec3) -> f64 {
        let towards = |target: DVec3| {
            let w = (target - query).normalize_or_zero();
            let along = self.points.iter().map(|&p| (p - query).dot(w));
            along.fold(f64::INFINITY, f64::min)
        };
        towards(self.middle()).max(towards(best))
    }
}

impl Irregular {
    /// The control points of quarter `k` of a face with this corner.
    fn quarter(&self, points: &[DVec3], k: usize) -> Vec<DVec3> {
        match k {
            0 => irregular::apply(&self.step, points),
            _ => self.pick(points, k),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::refinement::Split;

    #[test]
    fn quarters_lie_where_the_parameters_say() {
        for split in [Split::Triangles, Split::Quads] {
            for k in 0..4 {
                let (linear, offset) = domain::quarter_to_face(split, k);
                let (found, to_local) =
                    domain::quarter(split, linear * domain::center(split) + offset);
                assert_eq!(found, k);
                let back = to_local.apply(linear * DVec2::new(0.2, 0.3) + offset);
                assert!((back - DVec2::new(0.2, 0.3)).length() < 1e-15);
            }
        }
    }
}
