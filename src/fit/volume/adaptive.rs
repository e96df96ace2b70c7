//! Orders where they are needed: of the boundary's faces and their edges, one round of raises after the other.
//!
//! A face is judged by its *indicator*, what it adds to the objective: the squared distance between it and the target, and λ times the
//! energy of its highest modes (they are normalized so that their squares are energies). Each round raises the worst faces, solves, and takes
//! back the raises that gained too little; those faces stay as they are from then on. Edges have the highest order of the faces
//! around them, and what is inside the volume keeps a low order: only the boundary has something to follow.
//!
//! **Departures from the paper**, which does not say how it chooses. Orders go up by two: modes of one parity may have nothing to do on a
//! symmetric face. What is inside stays at order 4.

use super::run::Run;
use super::surface::Gap;
use crate::error::Result;
use crate::fit::StopReason;

/// The order from which raises start.
const LOWEST: usize = 2;

/// The order of what is not on the boundary.
const INSIDE: usize = 4;

/// By how much an order is raised, and how far apart those of neighbours may be.
const STEP: usize = 2;

/// The share of the faces that a round raises.
const SHARE: f64 = 0.3;

/// A raise is taken back if it lowers the indicator by less than this share.
const GAIN: f64 = 0.1;

impl Run<'_> {
    /// Raises the orders of the boundary up to `options.order` until no face gains by it, or no distance is above `max_error`, in
    /// diagonals.
    pub(super) fn adapt(&mut self, max_error: Option<f64>) -> Result<()> {
        let highest = self.options.order;
        let lowest = LOWEST.min(highest);
        self.close_in(lowest)?;
        let volume = self.body.volume();
        let mut grading = Grading::new(
            volume.boundary().len(),
            volume.boundary_neighbours(),
            [lowest, highest],
        );
        let mut is_met = false;
        while self.ended.is_none() {
            let gap = self.gap()?;
            is_met = max_error.is_some_and(|most| gap.largest <= most);
            if is_met {
                break;
            }
            let indicators = self.indicators(&gap);
            let taken_back = grading.take_back(&indicators);
            let raised = grading.raise(&indicators);
            if !(taken_back || raised) {
                break;
            }
            self.regrade(&mut grading)?;
            self.settle_between()?;
        }
        self.settle()?;
        if is_met {
            self.ended = self.ended.or(Some(StopReason::Tolerance));
        }
        Ok(())
    }

    /// `[boundary faces]`.
    fn indicators(&self, gap: &Gap) -> Vec<f64> {
        let volume = self.body.volume();
        let weight = self.options.close / volume.cell_count() as f64;
        let tops = volume.boundary_top_modes();
        let faces = volume.boundary().into_iter().zip(tops).zip(&gap.by_face);
        faces
            .map(|(((cell, _), top), distance)| {
                let squares: f64 = top
                    .iter()
                    .map(|&k| volume.coefficients[k as usize].length_squared())
                    .sum();
                distance + weight * squares / self.sizes[cell as usize].powi(2)
            })
            .collect()
    }

    /// Gives the body the orders of a grading; where lower ones would invert elements none is lowered.
    fn regrade(&mut self, grading: &mut Grading) -> Result<()> {
        let inside = INSIDE.min(self.options.order);
        let before = self.body.volume().clone();
        self.body = before.graded(&grading.orders, inside)?.into();
        if self.interior().is_err() {
            for (order, had) in grading.orders.iter_mut().zip(before.boundary_orders()) {
                *order = had.max(*order);
            }
            self.body = before.graded(&grading.orders, inside)?.into();
        }
        Ok(())
    }
}

/// The orders of the faces of a boundary, and what their last raises have brought.
#[derive(Debug, Clone)]
struct Grading {
    /// Pairs of faces with a common edge.
    neighbours: Vec<[u32; 2]>,
    highest: usize,
    /// `[faces]` all.
    orders: Vec<usize>,
    /// The order and the indicator before the last raise, if that was in the last round.
    before: Vec<Option<(usize, f64)>>,
    /// Whether it is not to be raised any more.
    settled: Vec<bool>,
}

impl Grading {
    fn new(faces: usize, neighbours: Vec<[u32; 2]>, [lowest, highest]: [usize; 2]) -> Self {
        Self {
            neighbours,
            highest,
            orders: vec![lowest; faces],
            before: vec![None; faces],
            settled: vec![false; faces],
        }
    }

    /// Takes back the raises of the last round that gained too little. Whether there were any.
    fn take_back(&mut self, indicators: &[f64]) -> bool {
        let orders = self.orders.clone();
        for (f, now) in indicators.iter().enumerate() {
            if let Some((order, before)) = self.before[f]
                && *now > (1.0 - GAIN) * before
            {
                self.orders[f] = order;
                self.settled[f] = true;
            }
        }
        self.even_out();
        self.orders != orders
    }

    /// Raises the worst faces. Whether there were any to raise.
    fn raise(&mut self, indicators: &[f64]) -> bool {
        let most = (SHARE * self.orders.len() as f64).ceil() as usize;
        let mut worst: Vec<usize> = (0..self.orders.len())
            .filter(|&f| !self.settled[f] && self.orders[f] < self.highest)
            .collect();
        worst.sort_by(|&a, &b| indicators[b].total_cmp(&indicators[a]).then(a.cmp(&b)));
        worst.truncate(most);
        self.before.fill(None);
        let orders = self.orders.clone();
        for &f in &worst {
            self.orders[f] = (self.orders[f] + STEP).min(self.highest);
        }
        self.even_out();
        for (f, &order) in orders.iter().enumerate() {
            if self.orders[f] > order && !self.settled[f] {
                self.before[f] = Some((order, indicators[f]));
            }
        }
        !worst.is_empty()
    }

    /// Raises faces until no neighbours are further apart than a step.
    fn even_out(&mut self) {
        let mut any = true;
        while any {
            any = false;
            for &[a, b] in &self.neighbours {
                for [a, b] in [[a, b], [b, a]].map(|pair| pair.map(|f| f as usize)) {
                    if self.orders[a] + STEP < self.orders[b] {
                        self.orders[a] = self.orders[b] - STEP;
                        any = true;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring of faces, each beside the next.
    fn ring(faces: u32) -> Grading {
        let neighbours = (0..faces).map(|f| [f, (f + 1) % faces]).collect();
        Grading::new(faces as usize, neighbours, [2, 9])
    }

    #[test]
    fn the_worst_faces_are_raised_and_neighbours_stay_a_step_apart() {
        let mut grading = ring(10);
        let mut indicators = vec![1.0; 10];
        (indicators[3], indicators[4]) = (7.0, 5.0);
        assert!(grading.raise(&indicators));
        assert_eq!(grading.orders, [4, 2, 2, 4, 4, 2, 2, 2, 2, 2]);
        // The next round goes on from there, and takes nothing back where the indicators have fallen.
        let fallen: Vec<f64> = indicators.iter().map(|i| 0.5 * i).collect();
        assert!(!grading.take_back(&fallen));
        assert!(grading.raise(&fallen));
        assert_eq!(grading.orders, [6, 4, 4, 6, 6, 4, 2, 2, 2, 4]);
        for _ in 0..20 {
            grading.raise(&indicators);
        }
        assert_eq!(grading.orders, [9; 10]);
        assert!(!grading.raise(&indicators));
    }

    #[test]
    fn raises_that_gain_little_are_taken_back_and_not_tried_again() {
        let mut grading = ring(8);
        let mut indicators = vec![1.0; 8];
        (indicators[1], indicators[5]) = (9.0, 8.0);
        grading.raise(&indicators);
        assert_eq!(grading.orders, [4, 4, 2, 2, 2, 4, 2, 2]);
        let after = [0.5, 8.5, 1.0, 1.0, 1.0, 4.0, 1.0, 1.0];
        assert!(grading.take_back(&after));
        assert_eq!(grading.orders, [4, 2, 2, 2, 2, 4, 2, 2]);
        let next = [9.0, 8.5, 1.0, 1.0, 1.0, 4.0, 1.0, 1.0];
        grading.raise(&next);
        // Its neighbours pull face 1 up.
        assert_eq!(grading.orders, [6, 4, 4, 2, 4, 6, 4, 4]);
        // That was no raise of its own.
        assert!(grading.before[1].is_none() && grading.settled[1]);
    }
}
