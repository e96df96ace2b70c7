//! Sites where a network needs them: evenly in a metric that follows curvature, then where its surface is off.

use super::errors::Errors;
use super::fire::Fire;
use super::ground::{Ground, NETWORK, manifold};
use crate::device::Device;
use crate::error::Result;
use crate::features::{Monge, Scale, monge_forms};
use crate::geometry::random::Random;
use crate::kernel::closest_point::ClosestPoints;
use crate::mesh::{ControlMesh, TriangleMesh};
use crate::progress::{Event, Progress};
use glam::{DMat3, DVec3};

/// The share of the sites that is spread evenly before any error is known. With 0.7 the rocker arm is nearer and Igea's mean error larger.
const SPREAD: f64 = 0.75;

/// Rounds of insertion at errors, and those at most to meet the number where mending adds sites of its own.
const ROUNDS: usize = 12;
const MOST_ROUNDS: usize = 20;

/// New sites keep this share of √(area / number) from all others.
const SPACING: f64 = 0.4;

/// Rounds of exchange; the share of the sites that the first exchanges, and what becomes of it where that did not help.
const EXCHANGES: usize = 8;
const EXCHANGED: f64 = 0.05;
const FEWER: f64 = 0.7;

/// Sites that others are exchanged for may be nearer together: the largest errors of the rocker arm are at its rims, where none was allowed before. Nearer from the start, the mean
/// error grows.
const CLOSEST: f64 = 0.2;

/// Curvatures above this quantile count like it: beyond are the fit's outliers.
const SHARPEST: f64 = 0.99;
/// What is flatter than this quantile counts like it.
const FLATTEST: f64 = 0.1;
/// What is flatter than this, by diagonals, counts like it: a cube is flat nearly everywhere.
const LEAST: f64 = 1.0;

/// A network of about `control_points` sites (never fewer than the target's topology needs), each on the target.
///
/// Lengths are measured in the metric w² = (|k₁| + κ) (e · d₁)² + (|k₂| + κ) (e · d₂)² + κ (e · n)² for an edge e, with the principal curvatures k,
/// their directions d and a least curvature κ. Farthest points in it are the first sites; where the surface that interpolates them is off, the worst
/// vertex of each cell becomes one, worst cells first, in a dozen rounds. Then the sites that tell least are exchanged for such vertices, as long as the surface comes nearer.
/// Interrupted, the network is one of the sites chosen so far.
///
/// # Errors
/// Where the target has no area, or the device fails.
pub fn adaptive(
    device: &Device,
    target: &TriangleMesh,
    control_points: usize,
    seed: u64,
    progress: &dyn Progress,
) -> Result<ControlMesh> {
    progress.event(Event::Stage {
        name: NETWORK,
        steps: control_points,
    });
    let mesh = manifold(target)?;
    let forms = monge_forms(device, &mesh, Scale::default())?;
    let mut bending = bending(&mesh, &forms);
    let ground = Ground::new(mesh, control_points, |a, b| {
        bending.push(0.5 * (bending[a as usize] + bending[b as usize]));
    })?;
    let mut fire = Fire::new(&ground.surface, |a, b| {
        let e = ground.positions[b as usize] - ground.positions[a as usize];
        let metric = bending[a as usize] + bending[b as usize];
        (0.5 * e.dot(metric * e)).sqrt()
    });
    let first = Random::new(seed).below(ground.positions.len());
    fire.light(first as u32);
    fire.spread((SPREAD * control_points as f64) as usize);
    ground.mend(&mut fire);
    let search = Search {
        device,
        target: ClosestPoints::new(device, &ground.mesh())?,
        ground,
        progress,
    };
    let (fire, errors) = search.insert(fire, control_points)?;
    let fire = search.exchange(fire, errors)?;
    search.ground.network(&fire)
}

/// The search for sites by the errors of the surface through them.
struct Search<'a> {
    device: &'a Device,
    ground: Ground,
    /// The ground's own mesh.
    target: ClosestPoints,
    progress: &'a dyn Progress,
}

impl Search<'_> {
    fn errors(&self, fire: &Fire) -> Result<Errors> {
        self.progress.event(Event::Step {
            done: fire.sites.len(),
            value: None,
        });
        Errors::of(self.device, &self.ground, &self.target, fire)
    }

    /// Adds sites at the largest errors until there are `wanted`.
    fn insert(&self, mut fire: Fire, wanted: usize) -> Result<(Fire, Errors)> {
        let apart = SPACING * self.ground.spacing;
        let mut errors = self.errors(&fire)?;
        for round in 0..MOST_ROUNDS {
            let missing = wanted.saturating_sub(fire.sites.len());
            if missing == 0 || self.progress.interrupted() {
                break;
            }
            let now = missing.div_ceil(ROUNDS.saturating_sub(round).max(1));
            fire = (self.ground).grow(&fire, &errors.worst(), apart, now, wanted);
            errors = self.errors(&fire)?;
        }
        Ok((fire, errors))
    }

    /// Exchanges idle sites for such at the largest errors, fewer and fewer of them, wherever that brings the surface nearer.
    fn exchange(&self, mut fire: Fire, mut errors: Errors) -> Result<Fire> {
        let apart = CLOSEST * self.ground.spacing;
        let wanted = fire.sites.len();
        let mut share = EXCHANGED;
        for _ in 0..EXCHANGES {
            let count = (share * wanted as f64) as usize;
            if count == 0 || self.progress.interrupted() {
                break;
            }
            let mut next = fire.clone();
            next.put_out(&errors.idle(&self.ground, &fire, count));
            self.ground.mend(&mut next);
            let missing = wanted.saturating_sub(next.sites.len());
            next = (self.ground).grow(&next, &errors.worst(), apart, missing, wanted);
            let found = self.errors(&next)?;
            if next.sites.len() == wanted && found.score < errors.score {
                (fire, errors) = (next, found);
            } else {
                share *= FEWER;
            }
        }
        Ok(fire)
    }
}

/// `[vertices]`: the metric.
fn bending(mesh: &TriangleMesh, forms: &[Monge]) -> Vec<DMat3> {
    let (lo, hi) = mesh.bounding_box().unwrap_or_default();
    let total = forms.iter().map(|f| f.curvatures[0].hypot(f.curvatures[1]));
    let least = quantile(total.collect(), FLATTEST).max(LEAST / (hi - lo).length());
    let all = forms.iter().flat_map(|f| f.curvatures.map(f64::abs));
    let most = quantile(all.collect(), SHARPEST);
    let outer = |d: DVec3| DMat3::from_cols(d.x * d, d.y * d, d.z * d);
    let tensor = |form: &Monge| {
        let [k1, k2] = form.curvatures.map(|k| k.abs().min(most) + least);
        let [d1, d2] = form.directions;
        k1 * outer(d1) + k2 * outer(d2) + least * outer(form.normal)
    };
    forms.iter().map(tensor).collect()
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.retain(|x| x.is_finite());
    values.sort_unstable_by(f64::total_cmp);
    let place = share * values.len().saturating_sub(1) as f64;
    values.get(place as usize).copied().unwrap_or(0.0)
}
