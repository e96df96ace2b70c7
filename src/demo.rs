//! The built-in input: a scan that never was, of a creature that never was.
//!
//! The creature is a star-shaped surface, r(d) = ellipsoid(d) + Σ aᵢ exp(κᵢ (d·dᵢ − 1)), smooth everywhere. [`scan`] looks at it as a structured-light
//! scanner would: from several sides, one grid of depths each, triangulated except across depth jumps; with noise along the line of
//! sight, a small misalignment of each view, spots that no view sees, and some degenerate, duplicate and spiked triangles.
//! [`truth`] is the surface itself.

use crate::geometry::random::Random;
use crate::mesh::{TriangleMesh, shapes};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// The creature's unit in the scan's unit, millimetres.
const SIZE: f64 = 40.0;
/// No part of the creature is further from its centre.
const REACH: f64 = 1.9;
/// The half axes of its body.
const BODY: DVec3 = DVec3::new(1.15, 0.85, 0.8);
/// Its features: direction, height, and sharpness κ.
const FEATURES: [(DVec3, f64, f64); 10] = [
    (DVec3::new(1.0, 0.0, 0.55), 0.55, 9.0),   // head
    (DVec3::new(0.62, 0.38, 1.0), 0.55, 60.0), // ears
    (DVec3::new(0.62, -0.38, 1.0), 0.55, 60.0),
    (DVec3::new(1.0, 0.0, 0.42), 0.14, 120.0), // snout
    (DVec3::new(-1.0, 0.0, 0.35), 0.35, 70.0), // tail
    (DVec3::new(0.62, 0.5, -0.95), 0.4, 45.0), // feet
    (DVec3::new(0.62, -0.5, -0.95), 0.4, 45.0),
    (DVec3::new(-0.72, 0.5, -0.9), 0.42, 40.0),
    (DVec3::new(-0.72, -0.5, -0.9), 0.42, 40.0),
    (DVec3::new(-0.3, 0.0, 1.0), 0.12, 25.0), // hump
];

/// From where it is seen: towards the scanner.
const VIEWS: [DVec3; 8] = [
    DVec3::new(1.0, 0.1, 0.35),
    DVec3::new(0.5, 0.9, 0.25),
    DVec3::new(-0.55, 0.85, 0.1),
    DVec3::new(-1.0, -0.05, 0.3),
    DVec3::new(-0.45, -0.9, 0.2),
    DVec3::new(0.55, -0.85, 0.05),
    DVec3::new(0.1, 0.05, 1.0),
    DVec3::new(0.05, -0.1, -1.0),
];
/// Rays along each side of a view's grid.
const RAYS: usize = 140;
/// The distance between rays.
const SPACING: f64 = 2.0 * REACH / RAYS as f64;
/// An edge this many times the spacing is a jump in depth.
const LONGEST_EDGE: f64 = 3.0;

/// Spots that no view sees (dark, or shiny): direction and angular radius.
const BLIND_SPOTS: [(DVec3, f64); 4] = [
    (DVec3::new(0.1, 1.0, 0.3), 0.09),
    (DVec3::new(-0.5, -0.8, 0.5), 0.07),
    (DVec3::new(-0.1, 0.1, -1.0), 0.12),
    (DVec3::new(-0.8, 0.25, 0.6), 0.05),
];

/// Standard deviation of depths: 0.07 % of the bounding box's diagonal of about 4 units.
const NOISE: f64 = 0.0028;
/// Standard deviation of each view's misalignment, in position and (radians) turn.
const MISALIGNMENT: f64 = 0.0015;
/// Triangles each that are added as copies, or as slivers of no area.
const BAD_TRIANGLES: usize = 60;
/// Vertices that stick out, and how far.
const SPIKES: usize = 20;
const SPIKE_HEIGHT: f64 = 0.03;

/// A scan of some 70,000 triangles in eight overlapping range images: the same for the same seed, on every machine of the same arithmetic.
pub fn scan(seed: u64) -> TriangleMesh {
    let mut scan = TriangleMesh::default();
    let mut random = Random::new(seed);
    for towards in VIEWS {
        let view = View::new(towards.normalize(), Random::new(random.bits()));
        view.append_to(&mut scan);
    }
    spoil(&mut scan, &mut random);
    for p in &mut scan.positions {
        *p *= SIZE;
    }
    scan
}

/// The scanned surface without any fault: a sphere of 20 · 4^levels triangles moved onto it.
pub fn truth(levels: usize) -> TriangleMesh {
    let mut mesh = shapes::sphere(1.0, levels);
    mesh.positions
        .par_iter_mut()
        .for_each(|p| *p *= SIZE * radius(*p));
    mesh
}

/// The distance of the surface from the centre in a unit direction.
fn radius(d: DVec3) -> f64 {
    let body = (d / BODY).length().recip();
    FEATURES.iter().fold(body, |sum, &(at, height, sharpness)| {
        sum + height * (sharpness * (d.dot(at.normalize()) - 1.0)).exp()
    })
}

/// Positive outside, negative inside, about the distance where the surface is not steep.
fn outside(p: DVec3) -> f64 {
    let length = p.length();
    match length > 0.0 {
        true => length - radius(p / length),
        false => -BODY.min_element(),
    }
}

/// A scanner that looks at the creature along parallel rays.
struct View {
    /// The directions of the grid's axes and towards the scanner, as columns.
    frame: DMat3,
    /// Where the scanner is believed to be, against where it is.
    turn: DMat3,
    shift: DVec3,
    seed: u64,
}

impl View {
    fn new(towards: DVec3, mut random: Random) -> Self {
        let (u, v) = towards.any_orthonormal_pair();
        let mut error =
            || DVec3::new(random.normal(), random.normal(), random.normal()) * MISALIGNMENT;
        let (turn, shift) = (error(), error());
        Self {
            frame: DMat3::from_cols(u, v, towards),
            turn: DMat3::from_rotation_x(turn.x)
                * DMat3::from_rotation_y(turn.y)
                * DMat3::from_rotation_z(turn.z),
            shift,
            seed: random.bits(),
        }
    }

    /// Adds what this view sees.
    fn append_to(&self, scan: &mut TriangleMesh) {
        let rows: Vec<Vec<Option<DVec3>>> =
            (0..RAYS).into_par_iter().map(|j| self.row(j)).collect();
        let mut index = vec![None; RAYS * RAYS];
        for (ray, point) in rows.into_iter().flatten().enumerate() {
            if let Some(p) = point {
                index[ray] = Some(scan.positions.len() as u32);
                scan.positions.push(p);
            }
        }
        for ray in (0..RAYS * (RAYS - 1)).filter(|ray| ray % RAYS + 1 < RAYS) {
            let corners = [ray, ray + 1, ray + RAYS + 1, ray + RAYS].map(|k| index[k]);
            triangulate_cell(scan, corners);
        }
    }

    /// The measured points of one row of rays.
    fn row(&self, j: usize) -> Vec<Option<DVec3>> {
        // A sequence of its own for each row, so that rows can be measured in any order.
        let mut random = Random::new(self.seed.wrapping_add(j as u64));
        (0..RAYS)
            .map(|i| {
                let noise = NOISE * random.normal();
                let at = |k: usize| (k as f64 + 0.5) * SPACING - REACH;
                let p = self.first_hit(at(i), at(j))?;
                let measured = p + noise * self.frame.z_axis;
                Some(self.turn * measured + self.shift)
            })
            .collect()
    }

    /// Where the ray at (x, y) of the grid first meets the surface, unless that is a blind spot.
    fn first_hit(&self, x: f64, y: f64) -> Option<DVec3> {
        let point = |depth: f64| self.frame * DVec3::new(x, y, depth);
        let mut above = REACH;
        let mut below = loop {
            // `outside` overestimates the distance at steep places: go a part of it.
            let next = above - (0.3 * outside(point(above))).max(0.004);
            if next < -REACH {
                return None;
            }
            if outside(point(next)) < 0.0 {
                break next;
            }
            above = next;
        };
        for _ in 0..40 {
            let middle = 0.5 * (above + below);
            match outside(point(middle)) < 0.0 {
                true => below = middle,
                false => above = middle,
            }
        }
        let hit = point(above);
        let direction = hit.normalize();
        let blind = |&(at, angle): &(DVec3, f64)| direction.angle_between(at) < angle;
        (!BLIND_SPOTS.iter().any(blind)).then_some(hit)
    }
}

/// Adds the triangles of a grid cell (counter-clockwise corners, some unseen) that span no jump in depth.
fn triangulate_cell(scan: &mut TriangleMesh, corners: [Option<u32>; 4]) {
    let seen: Vec<u32> = corners.into_iter().flatten().collect();
    let distance = |a: u32, b: u32| scan.positions[a as usize].distance(scan.positions[b as usize]);
    let candidates = match seen[..] {
        [a, b, c, d] if distance(a, c) <= distance(b, d) => vec![[a, b, c], [a, c, d]],
        [a, b, c, d] => vec![[a, b, d], [b, c, d]],
        [a, b, c] => vec![[a, b, c]],
        _ => return,
    };
    let is_whole = |&[a, b, c]: &[u32; 3]| {
        let longest = distance(a, b).max(distance(b, c)).max(distance(c, a));
        longest < LONGEST_EDGE * SPACING
    };
    let whole: Vec<_> = candidates.into_iter().filter(is_whole).collect();
    scan.triangles.extend(whole);
}

/// Adds what real scans bring along: triangles twice, triangles without area, vertices that stick out.
fn spoil(scan: &mut TriangleMesh, random: &mut Random) {
    let sound = scan.triangles.len();
    for _ in 0..BAD_TRIANGLES {
        scan.triangles.push(scan.triangles[random.below(sound)]);
        let [a, b, _] = scan.triangles[random.below(sound)];
        scan.triangles.push([a, b, a]);
    }
    for _ in 0..SPIKES {
        let v = scan.triangles[random.below(sound)][0] as usize;
        let p = scan.positions[v];
        scan.positions[v] = p + SPIKE_HEIGHT * random.uniform() * p.normalize();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Connectivity;

    #[test]
    fn the_truth_is_closed_and_as_described() {
        let truth = truth(5);
        let connectivity = Connectivity::of(&truth.clone().into()).unwrap();
        assert_eq!(connectivity.euler_characteristic(), 2);
        let reach = truth
            .positions
            .iter()
            .map(|p| p.length())
            .fold(0.0, f64::max);
        assert!(reach < REACH * SIZE, "{reach}");
    }

    #[test]
    fn the_scan_is_near_the_truth_and_faulty_as_scans_are() {
        let scan = scan(0);
        let (lo, hi) = scan.bounding_box().unwrap();
        let diagonal = (hi - lo).length();
        assert!(
            (60_000..100_000).contains(&scan.triangles.len()),
            "{}",
            scan.triangles.len()
        );
        // The steepness of the surface makes `outside` larger than the distance, by up to three here.
        let errors: Vec<f64> = scan
            .positions
            .iter()
            .map(|&p| outside(p / SIZE) * SIZE)
            .collect();
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!(
            rms > 0.0005 * diagonal && rms < 0.002 * diagonal,
            "{rms} of {diagonal}"
        );
        let flat = (0..scan.triangles.len()).filter(|&t| scan.area_vector(t).length() == 0.0);
        assert_eq!(flat.count(), BAD_TRIANGLES);
        let mut sorted = scan.triangles.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert!(scan.triangles.len() - sorted.len() >= BAD_TRIANGLES);
        // Triangles face the scanner, hence outwards.
        let outwards = |t: usize| scan.area_vector(t).dot(scan.corners(t)[0]) >= 0.0;
        let turned = (0..scan.triangles.len()).filter(|&t| !outwards(t)).count();
        assert!(turned * 50 < scan.triangles.len(), "{turned} turned");
    }

    #[test]
    fn a_seed_fixes_every_bit_for_any_number_of_threads() {
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap().install(|| scan(5))
        };
        let one = with(1);
        assert_eq!(one, with(3));
        assert_ne!(one, scan(6));
    }
}
