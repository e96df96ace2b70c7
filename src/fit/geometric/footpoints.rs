//! The footpoints of the data: the closest points of the limit surface, and of its boundary curve for points of the data's boundary.

use crate::device::Device;
use crate::error::Result;
use crate::geometry::Bvh;
use crate::kernel::limit_surface::{ClosestOnLimit, LimitQuery};
use crate::mesh::Connectivity;
use crate::model::limit_surface::{LimitSurface, Patches, SurfaceParameter};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// A footpoint that moved by less than this in the parameters of its face is settled: it is taken along with the surface once.
const SETTLED: f64 = 1e-4;

/// Distances under this, in diagonals, have no direction of their own.
const COINCIDENT: f64 = 1e-7;

/// How near to a footpoint tracking ends, in diagonals.
const TRACKED: f64 = 1e-6;

/// How much nearer than the footpoint found by a full search another point of the surface may be, in diagonals.
const SEARCHED: f64 = 1e-5;

/// Straight pieces to an edge of the boundary, for first guesses.
const PIECES: u32 = 8;

/// Newton steps on the boundary curve, and halvings of each, at most.
const STEPS: usize = 12;
const HALVINGS: usize = 4;

/// A point of the data, and its footpoint.
#[derive(Debug, Clone)]
pub(super) struct Sample {
    /// The point.
    pub goal: DVec3,
    /// Whether its footpoint is to lie on the boundary.
    pub on_boundary: bool,
    /// The footpoint's parameter.
    pub at: SurfaceParameter,
    /// Where it is.
    pub position: DVec3,
    /// Unit length: the direction in which the distance counts; on the boundary the tangent, in which it does not.
    pub direction: DVec3,
    /// The combination of control points that the position is.
    pub row: Vec<(u32, f64)>,
    /// Whether to begin from it the next time.
    pub is_known: bool,
    /// Whether it is near enough to where it will be to be left alone once.
    pub is_settled: bool,
}

impl Sample {
    /// A point whose footpoint is not known.
    pub fn new(goal: DVec3, on_boundary: bool) -> Self {
        Self {
            goal,
            on_boundary,
            at: UNKNOWN,
            position: goal,
            direction: DVec3::ZERO,
            row: Vec::new(),
            is_known: false,
            is_settled: false,
        }
    }

    /// Has the footpoint searched for the next time.
    pub fn forget(&mut self) {
        self.is_known = false;
        self.is_settled = false;
    }

    /// How far the point is from its footpoint.
    pub fn distance(&self) -> f64 {
        self.goal.distance(self.position)
    }

    /// Takes the footpoint along with the surface, once.
    fn follow(&mut self, control_points: &[DVec3]) {
        let weighted = self
            .row
            .iter()
            .map(|&(c, w)| w * control_points[c as usize]);
        self.position = weighted.sum();
        self.is_settled = false;
    }

    /// Gives it a footpoint on the surface.
    fn set(&mut self, at: SurfaceParameter, patches: &Patches<'_>) {
        let here = DVec2::new(at.u, at.v);
        let moved = here.distance(DVec2::new(self.at.u, self.at.v));
        self.is_settled = self.at.face == at.face && moved < SETTLED;
        self.at = at;
        self.is_known = true;
        patches.surface().weights(at, &mut self.row);
        let jet = patches.evaluate(at);
        self.position = jet.position;
        self.direction = match self.distance() > COINCIDENT {
            true => (self.goal - self.position).normalize(),
            false => jet.du.cross(jet.dv).normalize_or_zero(),
        };
    }
}

/// No face.
const UNKNOWN: SurfaceParameter = SurfaceParameter {
    face: u32::MAX,
    u: 0.0,
    v: 0.0,
};

/// Finds the footpoints from those of the last time; settled ones are taken along, unknown ones found from scratch.
///
/// # Errors
/// Where the device fails.
pub(super) fn update(
    device: &Device,
    surface: &LimitSurface,
    control_points: &[DVec3],
    samples: &mut [Sample],
) -> Result<()> {
    let patches = surface.patches(control_points);
    let closest = ClosestOnLimit::new(device, &patches)?.within(TRACKED);
    let inner = |s: &Sample| !s.on_boundary && !s.is_settled;
    let unknown: Vec<DVec3> = samples
        .iter()
        .filter(|s| inner(s) && !s.is_known)
        .map(|s| s.goal)
        .collect();
    let mut guesses = match unknown.is_empty() {
        true => Vec::new(),
        false => closest.first_guess(device, &unknown)?,
    }
    .into_iter();
    let queries: Vec<LimitQuery> = samples
        .iter()
        .filter(|s| inner(s))
        .map(|s| LimitQuery {
            point: s.goal,
            start: match s.is_known {
                true => s.at,
                false => guesses.next().unwrap_or(s.at),
            },
            is_settled: false,
        })
        .collect();
    let found = closest.track(&queries)?;
    let mut moving: Vec<&mut Sample> = Vec::with_capacity(found.len());
    let mut others: Vec<&mut Sample> = Vec::new();
    for sample in samples {
        match inner(sample) {
            true => moving.push(sample),
            false => others.push(sample),
        }
    }
    moving
        .par_iter_mut()
        .zip(&found)
        .for_each(|(sample, found)| sample.set(found.parameter, &patches));
    let curve = BoundaryCurve::new(&patches)?;
    others.par_iter_mut().for_each(|sample| match &curve {
        Some(curve) if !sample.is_settled => curve.project(sample),
        _ => sample.follow(control_points),
    });
    Ok(())
}

/// Finds all footpoints by a search of the whole surface.
///
/// # Errors
/// Where the device fails.
pub(super) fn search(
    device: &Device,
    surface: &LimitSurface,
    control_points: &[DVec3],
    samples: &mut [Sample],
) -> Result<()> {
    let patches = surface.patches(control_points);
    let goals: Vec<DVec3> = samples.iter().map(|s| s.goal).collect();
    let closest = ClosestOnLimit::new(device, &patches)?;
    let guesses = closest.first_guess(device, &goals)?;
    let query = |(&point, start)| LimitQuery {
        point,
        start,
        is_settled: false,
    };
    let queries: Vec<LimitQuery> = goals.iter().zip(guesses).map(query).collect();
    // The search begins with a point that is near already, and has little left to look at.
    let found = closest.search(&goals, &closest.track(&queries)?, SEARCHED)?;
    let curve = BoundaryCurve::new(&patches)?;
    samples
        .par_iter_mut()
        .zip(&found)
        .for_each(|(sample, found)| match (&curve, sample.on_boundary) {
            (Some(curve), true) => curve.project(sample),
            _ => sample.set(found.parameter, &patches),
        });
    Ok(())
}

/// The curve that the boundary of a limit surface is.
struct BoundaryCurve<'a> {
    patches: &'a Patches<'a>,
    /// Half-edges of the boundary.
    edges: Vec<u32>,
    pieces: Bvh,
}

/// A point of the curve with its derivatives along the edge.
struct CurveJet {
    at: SurfaceParameter,
    position: DVec3,
    first: DVec3,
    second: DVec3,
}

impl<'a> BoundaryCurve<'a> {
    /// `None` for a closed surface.
    fn new(patches: &'a Patches<'a>) -> Result<Option<Self>> {
        let mesh = patches.surface().connectivity();
        let edges: Vec<u32> = (0..mesh.half_edge_count() as u32)
            .filter(|&h| mesh.opposite(h).is_none())
            .collect();
        if edges.is_empty() {
            return Ok(None);
        }
        let mut positions = Vec::with_capacity(edges.len() * (PIECES as usize + 1));
        let mut segments = Vec::with_capacity(edges.len() * PIECES as usize);
        for &h in &edges {
            for k in 0..=PIECES {
                if k > 0 {
                    let end = positions.len() as u32;
                    segments.push([end - 1, end, end]);
                }
                positions.push(jet(patches, mesh, h, f64::from(k) / f64::from(PIECES)).position);
            }
        }
        Ok(Some(Self {
            patches,
            edges,
            pieces: Bvh::new(&positions, &segments)?,
        }))
    }

    /// Gives a sample its footpoint on the curve: that of the nearest straight piece, then Newton on its edge.
    fn project(&self, sample: &mut Sample) {
        let mesh = self.patches.surface().connectivity();
        let found = self.pieces.closest(sample.goal);
        let h = self.edges[(found.triangle / PIECES) as usize];
        let within = 1.0 - found.barycentric[0];
        let mut s = (f64::from(found.triangle % PIECES) + within) / f64::from(PIECES);
        let mut here = jet(self.patches, mesh, h, s);
        for _ in 0..STEPS {
            let error = sample.goal - here.position;
            let flat = here.first.length_squared();
            let curved = flat - error.dot(here.second);
            let slope = error.dot(here.first);
            let mut step = slope / if curved > 0.1 * flat { curved } else { flat };
            let distance = error.length_squared();
            let next = (0..HALVINGS).find_map(|_| {
                let t = (s + step).clamp(0.0, 1.0);
                let there = jet(self.patches, mesh, h, t);
                step *= 0.5;
                let nearer = there.position.distance_squared(sample.goal) < distance;
                nearer.then_some((t, there))
            });
            match next {
                Some(next) => (s, here) = next,
                None => break,
            }
        }
        sample.at = here.at;
        sample.position = here.position;
        sample.direction = here.first.normalize_or_zero();
        self.patches.surface().weights(here.at, &mut sample.row);
    }
}

/// The limit surface at `s`, from 0 at the start to 1 at the end of half-edge `h`.
fn jet(patches: &Patches<'_>, mesh: &Connectivity, h: u32, s: f64) -> CurveJet {
    const CORNERS: [DVec2; 4] = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ZERO];
    let face = mesh.face_of(h);
    let k = (h - mesh.half_edges(face as usize).start) as usize;
    let along = CORNERS[k + 1] - CORNERS[k];
    let p = CORNERS[k] + s * along;
    let at = SurfaceParameter {
        face,
        u: p.x,
        v: p.y,
    };
    let jet = patches.evaluate(at);
    CurveJet {
        at,
        position: jet.position,
        first: along.x * jet.du + along.y * jet.dv,
        second: along.x * along.x * jet.duu
            + 2.0 * along.x * along.y * jet.duv
            + along.y * along.y * jet.dvv,
    }
}
