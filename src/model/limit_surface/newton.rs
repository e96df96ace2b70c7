//! The nearest point of the surface by Newton's method from a start nearby.
//!
//! With r = S(u, v) − q the gradient of ½ |r|² is (r·S_u, r·S_v), and its Hessian the metric (S_u·S_u, …) plus (r·S_uu, …). A step takes the Hessian where it is
//! positive definite, else the metric alone (Gauss and Newton), which always descends. It runs on over edges into the next faces, unfolded flat, and ends where the
//! surface does; from there on it slides along the boundary. Steps that do not come nearer are halved. Settled is what would move by less than a tolerance *in space*,
//! so that a face's parameterization, which degenerates at irregular corners, has no say in it.

use super::{LimitJet, Patches, SurfaceParameter, domain};
use glam::{DMat2, DVec2, DVec3};

/// Steps; at an irregular corner of valence 50 a step brings the point nearer by a factor of 0.6 only.
const STEPS: usize = 60;
/// Halvings of a step before it is given up.
const HALVINGS: usize = 12;
/// Edges that one step may cross.
const CROSSINGS: usize = 12;
/// The longest step by either parameter: beyond it the quadratic model means nothing.
const LONGEST: f64 = 0.7;
/// How near to an edge, by the parameter, is on it.
const ON_EDGE: f64 = 1e-13;
/// Of the squared distance, and of the tolerance times the distance: how much further a step may seem to lead for rounding.
const ROUNDING: [f64; 2] = [1e-15, 1e-5];

/// How a search for the nearest point ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// At a point that no small move brings nearer.
    Converged,
    /// Not at all: the steps were used up, or none came nearer.
    NotConverged,
    /// On the boundary, and it would have gone on.
    LeftSurface,
}

/// A point of the surface found for a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Where it is on the surface.
    pub parameter: SurfaceParameter,
    /// Where it is in space.
    pub position: DVec3,
    /// Its distance from the query.
    pub distance: f64,
    /// How sure it is.
    pub status: Status,
}

/// Where the method may go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Range {
    /// Over the whole surface.
    Surface,
    /// Over the face that it starts on.
    Face,
}

/// Where the method has come to.
struct State {
    at: SurfaceParameter,
    jet: LimitJet,
    /// The squared distance from the query.
    squared: f64,
    status: Status,
    /// The step that is shorter than the tolerance, not taken; zero if it has not come so far.
    last_step: DVec2,
}

impl Patches<'_> {
    /// The point of the surface that Newton's method finds nearest to `query` from `start`: a local minimum of the distance if it converges. `tolerance`: how far from it
    /// the result may be, in space.
    pub fn descend(
        &self,
        query: DVec3,
        start: SurfaceParameter,
        range: Range,
        tolerance: f64,
    ) -> SurfacePoint {
        let walker = Walker {
            patches: self,
            range,
        };
        let end = walker.descend(query - self.origin, start, tolerance);
        SurfacePoint {
            parameter: end.at,
            position: end.jet.position + self.origin,
            distance: end.squared.sqrt(),
            status: end.status,
        }
    }

    /// About where [`descend`](Self::descend) ends over the whole surface, for about half the evaluations: of Newton's steps the first that is shorter than
    /// `near`, in space, is the last, and is taken on trust. That leaves an error that is smaller by as much again as `near` is smaller than the
    /// surface's radii of curvature.
    pub fn approach(&self, query: DVec3, start: SurfaceParameter, near: f64) -> SurfaceParameter {
        let walker = Walker {
            patches: self,
            range: Range::Surface,
        };
        let end = walker.descend(query - self.origin, start, near);
        walker.walk(end.at, end.last_step)
    }
}

struct Walker<'a> {
    patches: &'a Patches<'a>,
    range: Range,
}

impl Walker<'_> {
    /// `query`: relative to the origin of the patches.
    fn descend(&self, query: DVec3, start: SurfaceParameter, tolerance: f64) -> State {
        let jet = self.patches.local(start);
        let mut state = State {
            at: start,
            jet,
            squared: (jet.position - query).length_squared(),
            status: Status::NotConverged,
            last_step: DVec2::ZERO,
        };
        for _ in 0..STEPS {
            let State {
                at, jet, squared, ..
            } = state;
            let (step, is_held) = self.step(at, &jet, jet.position - query);
            if (step.x * jet.du + step.y * jet.dv).length() <= tolerance {
                state.last_step = step;
                state.status = match is_held && self.range == Range::Surface {
                    true => Status::LeftSurface,
                    false => Status::Converged,
                };
                break;
            }
            let most = squared * (1.0 + ROUNDING[0])
                + ROUNDING[1] * tolerance * (squared.sqrt() + tolerance);
            let nearer = (0..HALVINGS as i32).find_map(|halvings| {
                let at = self.walk(at, step * 0.5f64.powi(halvings));
                let jet = self.patches.local(at);
                let squared = (jet.position - query).length_squared();
                (squared <= most).then_some((at, jet, squared))
            });
            let Some(found) = nearer else { break };
            (state.at, state.jet, state.squared) = found;
        }
        state
    }

    /// The step from a parameter, with `r` from the query to the surface; and whether an edge that cannot be crossed keeps it back.
    fn step(&self, at: SurfaceParameter, jet: &LimitJet, r: DVec3) -> (DVec2, bool) {
        let gradient = DVec2::new(r.dot(jet.du), r.dot(jet.dv));
        let symmetric = |a, b, c| DMat2::from_cols_array(&[a, b, b, c]);
        let metric = symmetric(
            jet.du.length_squared(),
            jet.du.dot(jet.dv),
            jet.dv.length_squared(),
        );
        let hessian = metric + symmetric(r.dot(jet.duu), r.dot(jet.duv), r.dot(jet.dvv));
        let step = shortened(free_step(gradient, &metric, &hessian));
        let held: Vec<usize> = self.edges_that_hold(at, step).collect();
        if held.is_empty() {
            return (step, false);
        }
        for &edge in &held {
            let along = domain::from_corner(self.split(), edge).linear.x_axis;
            let (bend, length) = (along.dot(hessian * along), along.dot(metric * along));
            let curvature = if bend > 0.1 * length { bend } else { length };
            let slide =
                shortened(along * (-gradient.dot(along) / curvature.max(f64::MIN_POSITIVE)));
            if self.edges_that_hold(at, slide).next().is_none() {
                return (slide, true);
            }
        }
        (DVec2::ZERO, true)
    }

    /// Where a step leads, over edges, at most to one that cannot be crossed.
    fn walk(&self, mut at: SurfaceParameter, mut step: DVec2) -> SurfaceParameter {
        let split = self.split();
        for _ in 0..CROSSINGS {
            let here = DVec2::new(at.u, at.v);
            let mut reached = (1.0, None);
            for edge in 0..domain::corner_count(split) {
                let (distance, rate) = self.approach(here, step, edge);
                let time = distance.max(0.0) / -rate;
                if rate < 0.0 && time < reached.0 {
                    reached = (time, Some(edge));
                }
            }
            let (time, edge) = reached;
            let end = domain::clamp(split, here + time * step);
            (at.u, at.v) = (end.x, end.y);
            let Some(edge) = edge else { break };
            let Some((there, turned)) = self.beyond(at, (1.0 - time) * step, edge) else {
                break;
            };
            (at, step) = (there, turned);
            let start = domain::clamp(split, DVec2::new(at.u, at.v));
            (at.u, at.v) = (start.x, start.y);
        }
        at
    }

    /// The edges at a parameter that a step would cross but must not.
    fn edges_that_hold(&self, at: SurfaceParameter, step: DVec2) -> impl Iterator<Item = usize> {
        let here = DVec2::new(at.u, at.v);
        (0..domain::corner_count(self.split())).filter(move |&edge| {
            let (distance, rate) = self.approach(here, step, edge);
            // Along the edge but for rounding is not across it.
            distance <= ON_EDGE
                && rate < -ON_EDGE * step.abs().max_element()
                && self.beyond(at, step, edge).is_none()
        })
    }

    fn beyond(
        &self,
        at: SurfaceParameter,
        step: DVec2,
        edge: usize,
    ) -> Option<(SurfaceParameter, DVec2)> {
        match self.range {
            Range::Surface => self.patches.surface.cross(at, step, edge),
            Range::Face => None,
        }
    }

    /// How far an edge is, by the parameter that is 0 on it, and how that changes with a step.
    fn approach(&self, at: DVec2, step: DVec2, edge: usize) -> (f64, f64) {
        let frame = domain::to_corner(self.split(), edge);
        (frame.apply(at).y, (frame.linear * step).y)
    }

    fn split(&self) -> crate::model::refinement::Split {
        self.patches.surface.split
    }
}

/// Newton's step where the Hessian is safely positive definite, else Gauss and Newton's, else against the gradient.
fn free_step(gradient: DVec2, metric: &DMat2, hessian: &DMat2) -> DVec2 {
    let area = metric.determinant();
    let trace = metric.x_axis.x + metric.y_axis.y;
    if hessian.determinant() > 0.01 * area
        && hessian.x_axis.x + hessian.y_axis.y > 0.0
        && area > 0.0
    {
        -(hessian.inverse() * gradient)
    } else if area > 1e-12 * trace * trace {
        -(metric.inverse() * gradient)
    } else {
        -gradient / trace.max(f64::MIN_POSITIVE)
    }
}

fn shortened(step: DVec2) -> DVec2 {
    let longest = step.abs().max_element();
    if longest > LONGEST {
        step * (LONGEST / longest)
    } else {
        step
    }
}
