//! Normals of a cloud of points: from the plane through each point's neighbours, turned to one side along a spanning tree.
//!
//! Source: H. Hoppe, T. DeRose, T. Duchamp, J. McDonald, W. Stuetzle, *Surface reconstruction from unorganized points*, SIGGRAPH 1992,
//! section 3.2 and 3.3: the tree spans the graph of neighbours and is the least one in 1 − |nᵢ · nⱼ|, so that orientation goes over flat parts
//! first and over edges last. Where a component starts the sign is free; it is the one with which the component's flux Σ aᵢ nᵢ · (pᵢ − c), three times
//! the volume of what it bounds, is positive. (The paper takes the highest point, which a single outlier can be.)

use super::neighbours::Neighbours;
use crate::geometry::eigen;
use crate::mesh::PointCloud;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Given normals count if their mean cosine to the planes' is at least this; 0.5 if they have nothing to do with them.
const PLAUSIBLE: f64 = 0.75;

/// The unit normals of the points, out of what they bound: those of the cloud, as they are or all turned round; estimated if it has none, or if they do not fit the points.
pub(super) fn oriented(cloud: &PointCloud, neighbours: &Neighbours) -> Vec<DVec3> {
    let positions = &cloud.positions;
    let mut normals: Vec<DVec3> = (0..positions.len())
        .into_par_iter()
        .map(|i| plane_normal(i, positions, neighbours))
        .collect();
    let given = || cloud.normals.iter().map(|n| n.normalize_or_zero());
    let likeness: f64 = given().zip(&normals).map(|(a, b)| a.dot(*b).abs()).sum();
    if !cloud.normals.is_empty() && likeness >= PLAUSIBLE * positions.len() as f64 {
        normals = given().collect();
        let all: Vec<u32> = (0..positions.len() as u32).collect();
        turn_outwards(&all, positions, neighbours, &mut normals);
        return normals;
    }
    if !cloud.normals.is_empty() {
        log::warn!("the normals of the points do not fit their positions, and are estimated");
    }
    for component in turn_along_tree(&mut normals, neighbours) {
        turn_outwards(&component, positions, neighbours, &mut normals);
    }
    normals
}

/// The direction in which a point and its neighbours spread least.
fn plane_normal(i: usize, positions: &[DVec3], neighbours: &Neighbours) -> DVec3 {
    let near = || std::iter::once(i as u32).chain(neighbours.of(i).iter().copied());
    let count = near().count() as f64;
    let center = near().map(|j| positions[j as usize]).sum::<DVec3>() / count;
    let mut covariance = DMat3::ZERO;
    for j in near() {
        let d = positions[j as usize] - center;
        covariance += DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    eigen::symmetric(covariance).1.x_axis
}

/// An edge of the graph of neighbours, the flattest first in a heap; ties in the order of indices, so that results repeat.
#[derive(PartialEq)]
struct Edge {
    bend: f64,
    from: u32,
    to: u32,
}

impl Eq for Edge {}

impl Ord for Edge {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_bend = other.bend.total_cmp(&self.bend);
        by_bend.then_with(|| (other.from, other.to).cmp(&(self.from, self.to)))
    }
}

impl PartialOrd for Edge {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Turns the normals of every component alike, and returns the components.
fn turn_along_tree(normals: &mut [DVec3], neighbours: &Neighbours) -> Vec<Vec<u32>> {
    let graph = neighbours.symmetric();
    let mut reached = vec![false; normals.len()];
    let mut components = Vec::new();
    for start in 0..normals.len() as u32 {
        if reached[start as usize] {
            continue;
        }
        let mut component = Vec::new();
        let mut pending = BinaryHeap::from([Edge {
            bend: 0.0,
            from: start,
            to: start,
        }]);
        while let Some(Edge { from, to, .. }) = pending.pop() {
            if std::mem::replace(&mut reached[to as usize], true) {
                continue;
            }
            if normals[from as usize].dot(normals[to as usize]) < 0.0 {
                normals[to as usize] = -normals[to as usize];
            }
            component.push(to);
            for &next in graph.of(to as usize) {
                if !reached[next as usize] {
                    let bend = 1.0 - normals[to as usize].dot(normals[next as usize]).abs();
                    pending.push(Edge {
                        bend,
                        from: to,
                        to: next,
                    });
                }
            }
        }
        components.push(component);
    }
    components
}

/// Turns the normals of a component round if its flux says that they point inwards.
fn turn_outwards(
    component: &[u32],
    positions: &[DVec3],
    neighbours: &Neighbours,
    normals: &mut [DVec3],
) {
    let points = || component.iter().map(|&i| i as usize);
    let area = |i: usize| neighbours.area(i);
    let weight: f64 = points().map(area).sum();
    let center = points().map(|i| area(i) * positions[i]).sum::<DVec3>() / weight;
    let flux: f64 = points()
        .map(|i| area(i) * normals[i].dot(positions[i] - center))
        .sum();
    if flux < 0.0 {
        points().for_each(|i| normals[i] = -normals[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    fn normals_of(positions: Vec<DVec3>, normals: Vec<DVec3>) -> Vec<DVec3> {
        let neighbours = Neighbours::of_points(&positions);
        oriented(
            &PointCloud {
                positions,
                normals,
                ..PointCloud::default()
            },
            &neighbours,
        )
    }

    /// Random points of a sphere about `center`.
    fn sphere(count: usize, radius: f64, center: DVec3) -> Vec<DVec3> {
        let mut random = Random::new(3);
        let mut normal = || random.normal();
        let direction = |()| DVec3::new(normal(), normal(), normal()).normalize();
        std::iter::repeat_n((), count)
            .map(direction)
            .map(|d| center + radius * d)
            .collect()
    }

    #[test]
    fn few_points_and_points_on_a_line_end() {
        assert!(normals_of(vec![], vec![]).is_empty());
        assert_eq!(normals_of(vec![DVec3::ONE], vec![]).len(), 1);
        let line: Vec<DVec3> = (0..50).map(|k| DVec3::X * f64::from(k)).collect();
        assert!(
            normals_of(line, vec![])
                .iter()
                .all(|n| (n.length() - 1.0).abs() < 1e-12)
        );
        assert_eq!(normals_of(vec![DVec3::ONE; 40], vec![]).len(), 40);
    }

    #[test]
    fn normals_point_out_of_each_of_two_balls() {
        let far = DVec3::new(5.0, 0.0, 0.0);
        let mut positions = sphere(2_000, 1.0, DVec3::ZERO);
        positions.extend(sphere(1_000, 0.5, far));
        let normals = normals_of(positions.clone(), vec![]);
        for (k, (p, n)) in positions.iter().zip(&normals).enumerate() {
            let outwards = if k < 2_000 { *p } else { (*p - far) / 0.5 };
            assert!(n.dot(outwards) > 0.95, "{p} {n}");
        }
    }

    #[test]
    fn given_normals_are_kept_but_turned_outwards_together() {
        let positions = sphere(500, 1.0, DVec3::ZERO);
        let inwards = positions.iter().map(|p| -*p).collect();
        let normals = normals_of(positions.clone(), inwards);
        assert!(
            positions
                .iter()
                .zip(&normals)
                .all(|(p, n)| (*p - *n).length() < 1e-12)
        );
        let wrong = normals_of(positions.clone(), vec![DVec3::Z; positions.len()]);
        assert!(positions.iter().zip(&wrong).all(|(p, n)| p.dot(*n) > 0.9));
    }
}
