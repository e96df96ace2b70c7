//! Sites where a network needs them: evenly in a metric that follows curvature, then where its surface is off.

use super::fire::Fire;
use super::ground::{Ground, manifold};
use crate::device::Device;
use crate::error::Result;
use crate::features::{Monge, Scale, monge_forms};
use crate::geometry::random::Random;
use crate::kernel::closest_point::ClosestPoints;
use crate::mesh::{ControlMesh, Scheme, TriangleMesh};
use crate::model::{Model, interpolating};
use glam::{DMat3, DVec3};

/// The share of the sites that is spread evenly before any error is known. In single runs on the bunny and the rocker arm, 0.6 gave larger maxima and 0.4 larger means.
const SPREAD: f64 = 0.75;

/// Rounds of insertion at errors, and those at most to meet the number where mending adds sites of its own.
const ROUNDS: usize = 12;
const MOST_ROUNDS: usize = 20;

/// New sites keep this share of √(area / number) from all others.
const SPACING: f64 = 0.4;

/// Subdivisions of the surface that errors are measured from.
const LEVELS: usize = 2;

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
/// vertex of each cell becomes one, worst cells first, in a dozen rounds.
///
/// # Errors
/// Where the target has no area, or the device fails.
pub fn adaptive(
    device: &Device,
    target: &TriangleMesh,
    control_points: usize,
    seed: u64,
) -> Result<ControlMesh> {
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
    let apart = SPACING * ground.spacing;
    let target = ClosestPoints::new(device, &ground.mesh())?;
    for round in 0..MOST_ROUNDS {
        let missing = control_points.saturating_sub(fire.sites.len());
        if missing == 0 {
            break;
        }
        let wanted = missing.div_ceil(ROUNDS.saturating_sub(round).max(1));
        let worst = worst_vertices(device, &ground, &target, &fire)?;
        fire = ground.grow(&fire, &worst, apart, wanted, control_points);
    }
    ground.network(&fire)
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

/// The vertex of each cell that is farthest from the surface through the sites, or nearest to where that is farthest from the target; the worst first.
fn worst_vertices(
    device: &Device,
    ground: &Ground,
    target: &ClosestPoints,
    fire: &Fire,
) -> Result<Vec<u32>> {
    let control = interpolating(&ground.network(fire)?, Scheme::Loop)?;
    let model = Model::new(&control, Scheme::Loop, LEVELS, true)?;
    let surface = TriangleMesh {
        positions: model.positions(&control.mesh.positions),
        triangles: model.triangles,
    };
    let mut worst = vec![(0.0, 0); fire.sites.len()];
    let mut see = |v: u32, error: f64| {
        let cell = &mut worst[fire.labels[v as usize] as usize];
        if error > cell.0 && fire.distances[v as usize] > 0.0 {
            *cell = (error, v);
        }
    };
    let forth = ClosestPoints::new(device, &surface)?.query(&ground.positions)?;
    for (v, found) in forth.iter().enumerate() {
        see(v as u32, found.distance_squared);
    }
    for found in target.query(&surface.positions)? {
        let [a, b, c] = found.barycentric;
        let nearest = if a >= b.max(c) {
            0
        } else if b >= c {
            1
        } else {
            2
        };
        let face = ground.surface.face(found.triangle as usize);
        see(face[nearest], found.distance_squared);
    }
    worst.retain(|&(error, _)| error > 0.0);
    worst.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    Ok(worst.into_iter().map(|(_, v)| v).collect())
}
