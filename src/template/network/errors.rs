//! How far the surface through a network is from the target, cell by cell.

use super::fire::Fire;
use super::ground::Ground;
use crate::device::Device;
use crate::error::Result;
use crate::kernel::closest_point::ClosestPoints;
use crate::mesh::Scheme;
use crate::model::{interpolating, limit_mesh};

/// Subdivisions of the surface that errors are measured from.
const LEVELS: usize = 2;

/// How many mean errors count as much as the largest one.
const MEANS: f64 = 8.0;

/// The errors of the Loop surface through the sites, vertices to faces both ways.
pub(super) struct Errors {
    /// `[sites]`: the largest error in each cell, squared, and the vertex where it is, or which is nearest to where it is; 0 where the site itself is the only vertex.
    cells: Vec<(f64, u32)>,
    /// The largest of all and some times the mean: what shall fall.
    pub score: f64,
}

impl Errors {
    /// Of cells that have been mended. `target`: the ground's own mesh.
    pub fn of(
        device: &Device,
        ground: &Ground,
        target: &ClosestPoints,
        fire: &Fire,
    ) -> Result<Self> {
        let control = interpolating(&ground.network(fire)?, Scheme::Loop)?;
        let surface = limit_mesh(&control, Scheme::Loop, LEVELS)?.triangulate();
        let mut errors = Self {
            cells: vec![(0.0, 0); fire.sites.len()],
            score: 0.0,
        };
        let forth = ClosestPoints::new(device, &surface)?.query(&ground.positions)?;
        let forth = (0..).zip(forth.iter().map(|found| found.distance_squared));
        let forth = errors.see(fire, forth);
        let back = target.query(&surface.positions)?;
        let back = errors.see(
            fire,
            back.iter().map(|found| {
                let face = ground.surface.face(found.triangle as usize);
                (face[nearest(found.barycentric)], found.distance_squared)
            }),
        );
        errors.score = forth[0].max(back[0]) + 0.5 * MEANS * (forth[1] + back[1]);
        Ok(errors)
    }

    /// Takes squared errors at vertices into account: the largest of them and the mean, not squared.
    fn see(&mut self, fire: &Fire, errors: impl Iterator<Item = (u32, f64)>) -> [f64; 2] {
        let (mut largest, mut sum, mut count) = (0.0f64, 0.0, 0);
        for (v, error) in errors {
            let cell = &mut self.cells[fire.labels[v as usize] as usize];
            if error > cell.0 && fire.distances[v as usize] > 0.0 {
                *cell = (error, v);
            }
            largest = largest.max(error);
            sum += error.sqrt();
            count += 1;
        }
        [largest.sqrt(), sum / f64::from(count.max(1))]
    }

    /// The vertex with the largest error of each cell, the worst first.
    pub fn worst(&self) -> Vec<u32> {
        let mut worst: Vec<_> = self.cells.iter().filter(|cell| cell.0 > 0.0).collect();
        worst.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        worst.into_iter().map(|cell| cell.1).collect()
    }

    /// The labels of `count` sites that will be missed least, no two of them neighbours: near to others by lengths that grow with the square root of errors, and where
    /// errors are small.
    pub fn idle(&self, ground: &Ground, fire: &Fire, count: usize) -> Vec<u32> {
        let mut around = vec![Vec::new(); self.cells.len()];
        let mut gaps = vec![f64::INFINITY; self.cells.len()];
        let mut errors: Vec<f64> = self.cells.iter().map(|cell| cell.0).collect();
        for e in 0..ground.surface.edge_count() as u32 {
            let ends = ground.surface.ends(e).map(|v| v as usize);
            let [a, b] = ends.map(|v| fire.labels[v]);
            if a == b {
                continue;
            }
            let gap = fire.distances[ends[0]] + fire.distances[ends[1]];
            for (a, b) in [(a as usize, b), (b as usize, a)] {
                gaps[a] = gap.min(gaps[a]);
                errors[a] = errors[a].max(self.cells[b as usize].0);
                around[a].push(b);
            }
        }
        let loss = |s: u32| errors[s as usize].sqrt() * gaps[s as usize].powi(2);
        let mut order: Vec<u32> = (0..self.cells.len() as u32).collect();
        order.sort_by(|&a, &b| loss(a).total_cmp(&loss(b)).then(a.cmp(&b)));
        let mut is_needed = vec![false; self.cells.len()];
        let mut idle = Vec::new();
        for s in order {
            if idle.len() < count && !is_needed[s as usize] {
                idle.push(s);
                around[s as usize]
                    .iter()
                    .for_each(|&t| is_needed[t as usize] = true);
            }
        }
        idle
    }
}

/// The corner with the largest weight, the first of equal ones.
fn nearest([a, b, c]: [f64; 3]) -> usize {
    if a >= b.max(c) {
        0
    } else if b >= c {
        1
    } else {
        2
    }
}
