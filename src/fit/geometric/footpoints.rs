//! The footpoints of the data: the closest points of the limit surface, and of its boundary for points of the data's rims.

use super::rims::{BoundaryCurves, CurvePoint, Rims};
use crate::device::Device;
use crate::error::Result;
use crate::kernel::limit_surface::{ClosestOnLimit, LimitQuery};
use crate::model::limit_surface::{LimitSurface, Patches, Status, SurfaceParameter, SurfacePoint};
use glam::DVec3;
use rayon::prelude::*;

/// Distances under this, in diagonals, have no direction of their own.
const COINCIDENT: f64 = 1e-7;

/// How near to footpoints a full search ends, in diagonals.
const TRACKED: f64 = 1e-6;

/// How much nearer than the footpoint found by a full search another point of the surface may be, in diagonals.
const SEARCHED: f64 = 1e-5;

/// A point of the data, and its footpoint.
#[derive(Debug, Clone)]
pub(super) struct Sample {
    /// The point.
    pub goal: DVec3,
    /// The loop of the data's boundary that it lies on; then its footpoint is to lie on the loop of the surface that became of it.
    pub rim: Option<u32>,
    /// How much it counts: 1 unless it is a peak.
    pub weight: f64,
    /// The footpoint's parameter.
    pub at: SurfaceParameter,
    /// Where it is.
    pub position: DVec3,
    /// Where it was when it was found.
    found_at: DVec3,
    /// Unit length: the direction in which the distance counts; on the boundary the tangent, in which it does not.
    pub direction: DVec3,
    /// The combination of control points that the position is.
    pub row: Vec<(u32, f64)>,
    /// Whether to begin from it the next time.
    pub is_known: bool,
}

impl Sample {
    /// A point whose footpoint is not known.
    pub fn new(goal: DVec3, rim: Option<u32>) -> Self {
        Self {
            goal,
            rim,
            weight: 1.0,
            at: UNKNOWN,
            position: goal,
            found_at: goal,
            direction: DVec3::ZERO,
            row: Vec::new(),
            is_known: false,
        }
    }

    /// A point whose footpoint is near that of a neighbour.
    pub fn beside(goal: DVec3, rim: Option<u32>, neighbour: &Self) -> Self {
        Self {
            at: neighbour.at,
            is_known: neighbour.is_known,
            ..Self::new(goal, rim)
        }
    }

    /// Has the footpoint searched for the next time.
    pub fn forget(&mut self) {
        self.is_known = false;
    }

    /// How far the point is from its footpoint.
    pub fn distance(&self) -> f64 {
        self.goal.distance(self.position)
    }

    /// The footpoint as what a search begins with.
    fn found(&self) -> SurfacePoint {
        SurfacePoint {
            parameter: self.at,
            position: self.position,
            distance: self.distance(),
            status: Status::Converged,
        }
    }

    /// Takes a footpoint along with the surface; whether that is enough because the surface has moved by no more than `still` there since it was found.
    fn rests(&mut self, control_points: &[DVec3], still: f64) -> bool {
        if !self.is_known {
            return false;
        }
        self.follow(control_points);
        self.position.distance(self.found_at) <= still
    }

    /// Takes the footpoint along with the surface.
    fn follow(&mut self, control_points: &[DVec3]) {
        let weighted = self
            .row
            .iter()
            .map(|&(c, w)| w * control_points[c as usize]);
        self.position = weighted.sum();
    }

    /// Gives it a footpoint on the surface.
    fn set(&mut self, at: SurfaceParameter, patches: &Patches<'_>, control_points: &[DVec3]) {
        self.at = at;
        self.is_known = true;
        patches.surface().weights(at, &mut self.row);
        self.follow(control_points);
        self.found_at = self.position;
        self.direction = match self.distance() > COINCIDENT {
            true => (self.goal - self.position).normalize(),
            false => {
                let jet = patches.evaluate(at);
                jet.du.cross(jet.dv).normalize_or_zero()
            }
        };
    }

    /// Gives it a footpoint on the boundary.
    fn set_on_boundary(&mut self, point: CurvePoint, patches: &Patches<'_>) {
        self.at = point.at;
        self.position = point.position;
        self.direction = point.tangent;
        patches.surface().weights(point.at, &mut self.row);
    }
}

/// No face.
const UNKNOWN: SurfaceParameter = SurfaceParameter {
    face: u32::MAX,
    u: 0.0,
    v: 0.0,
};

/// Finds the footpoints from those of the last time, unknown ones from scratch. Returns points of the surface's own boundary as footpoints of the nearest points
/// of rims.
///
/// `rims`: of the mesh of `surface`. `near`: where the surface has not moved by more, in diagonals, footpoints are only taken along; and Newton's
/// method is not asked for shorter steps.
///
/// # Errors
/// Where the device fails.
pub(super) fn update(
    device: &Device,
    surface: &LimitSurface,
    control_points: &[DVec3],
    rims: &Rims,
    samples: &mut [Sample],
    near: f64,
) -> Result<Vec<Sample>> {
    let patches = surface.patches(control_points);
    let closest = ClosestOnLimit::new(device, &patches)?;
    let resting: Vec<bool> = (samples.par_iter_mut())
        .map(|s| s.rests(control_points, near))
        .collect();
    let awake = samples.iter_mut().zip(resting);
    let awake = awake.filter(|(_, rests)| !rests).map(|(s, _)| s);
    let (mut outer, mut inner): (Vec<_>, Vec<_>) = awake.partition(|s| s.rim.is_some());
    let unknown: Vec<DVec3> = (inner.iter())
        .filter(|s| !s.is_known)
        .map(|s| s.goal)
        .collect();
    let mut guesses = match unknown.is_empty() {
        true => Vec::new(),
        false => closest.first_guess(device, &unknown)?,
    }
    .into_iter();
    let queries: Vec<LimitQuery> = (inner.iter())
        .map(|s| LimitQuery {
            point: s.goal,
            start: match s.is_known {
                true => s.at,
                false => guesses.next().unwrap_or(s.at),
            },
            is_settled: false,
        })
        .collect();
    let found = closest.approach(&queries, near)?;
    (inner.par_iter_mut().zip(found)).for_each(|(s, at)| s.set(at, &patches, control_points));
    if outer.is_empty() {
        return Ok(Vec::new());
    }
    let curves = BoundaryCurves::new(&patches, rims)?;
    outer.par_iter_mut().for_each(|s| {
        if let Some(point) = curves.closest(s.goal, s.rim) {
            s.set_on_boundary(point, &patches);
        }
    });
    let spread = curves.spread().into_par_iter().map(|(point, rim, goal)| {
        let mut sample = Sample::new(goal, Some(rim));
        sample.set_on_boundary(point, &patches);
        sample
    });
    Ok(spread.collect())
}

/// Keeps the parameters of footpoints, taken over to another surface by [`super::remesh`].
pub(super) fn carry_over(surface: &LimitSurface, control_points: &[DVec3], samples: &mut [Sample]) {
    samples.par_iter_mut().for_each(|sample| {
        surface.weights(sample.at, &mut sample.row);
        sample.follow(control_points);
    });
}

/// Looks whether other places of the surface are nearer than footpoints that are known: from first guesses in other faces, and for those further than
/// `exact_beyond` by a search that cannot miss. Distances never grow, so that none is reported too small, and none beyond too large.
///
/// # Errors
/// Where the device fails.
pub(super) fn search(
    device: &Device,
    surface: &LimitSurface,
    control_points: &[DVec3],
    samples: &mut [Sample],
    exact_beyond: f64,
) -> Result<()> {
    let patches = surface.patches(control_points);
    let closest = ClosestOnLimit::new(device, &patches)?.within(TRACKED);
    // Points of a rim have been looked for on all of its loop.
    let mut inner: Vec<&mut Sample> = samples.iter_mut().filter(|s| s.rim.is_none()).collect();
    let goals: Vec<DVec3> = inner.iter().map(|s| s.goal).collect();
    let guesses = closest.first_guess(device, &goals)?;
    let (mut elsewhere, queries): (Vec<&mut Sample>, Vec<LimitQuery>) = (inner.iter_mut())
        .zip(guesses)
        .filter(|(s, guess)| guess.face != s.at.face)
        .map(|(s, start)| {
            let query = LimitQuery {
                point: s.goal,
                start,
                is_settled: false,
            };
            (&mut **s, query)
        })
        .unzip();
    let found = closest.descend(&queries)?;
    take_nearer(&mut elsewhere, &found, &patches, control_points);
    let mut far: Vec<&mut Sample> = inner
        .into_iter()
        .filter(|s| s.distance() > exact_beyond)
        .collect();
    let goals: Vec<DVec3> = far.iter().map(|s| s.goal).collect();
    let known: Vec<SurfacePoint> = far.iter().map(|s| s.found()).collect();
    take_nearer(
        &mut far,
        &closest.search(&goals, &known, SEARCHED)?,
        &patches,
        control_points,
    );
    Ok(())
}

/// Gives samples the points found where they are nearer.
fn take_nearer(
    samples: &mut [&mut Sample],
    found: &[SurfacePoint],
    patches: &Patches<'_>,
    control_points: &[DVec3],
) {
    let pairs = samples.par_iter_mut().zip(found);
    pairs
        .filter(|(sample, found)| found.distance < sample.distance())
        .for_each(|(sample, found)| sample.set(found.parameter, patches, control_points));
}
