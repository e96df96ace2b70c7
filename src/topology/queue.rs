//! A priority queue for costs that seldom fall below the least one.
//!
//! Tickets wait unordered in buckets, by the leading bits of the cost; only the bucket that is being served is a heap. That heap fits a processor's first
//! cache, where one heap of all the edges of a scan does not. The order served is exactly that of one heap.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Edges by cost, least first, equal costs by edge number.
pub(super) struct Queue {
    /// By the bits of the cost above [`SHIFT`].
    buckets: Vec<Vec<u64>>,
    /// The tickets of the buckets up to `current`.
    serving: BinaryHeap<Reverse<u64>>,
    current: usize,
}

/// Keeps the sign, the exponent and five bits of the mantissa of a cost in f32 as the bucket, with the edge below it.
const SHIFT: u32 = 32 + 18;

impl Queue {
    /// A queue without edges.
    pub fn new() -> Self {
        Self {
            buckets: vec![Vec::new(); 1 << (64 - SHIFT)],
            serving: BinaryHeap::new(),
            current: 0,
        }
    }

    /// Adds an edge at a cost that is not negative.
    pub fn push(&mut self, cost: f64, edge: u32) {
        // The bits of floats that are not negative sort as they do.
        let ticket = u64::from((cost as f32).to_bits()) << 32 | u64::from(edge);
        let bucket = (ticket >> SHIFT) as usize;
        if bucket <= self.current {
            self.serving.push(Reverse(ticket));
        } else {
            self.buckets[bucket].push(ticket);
        }
    }

    /// Takes the edge that costs least.
    pub fn pop(&mut self) -> Option<u32> {
        while self.serving.is_empty() {
            if self.current + 1 == self.buckets.len() {
                return None;
            }
            self.current += 1;
            let bucket = std::mem::take(&mut self.buckets[self.current]);
            self.serving = bucket.into_iter().map(Reverse).collect();
        }
        self.serving.pop().map(|Reverse(ticket)| ticket as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn serves_by_cost_whatever_the_order_of_arrival() {
        let mut queue = Queue::new();
        let costs = [3.0, 0.0, 1e-40, 1e30, 2.5, 1e-12, f64::MAX, 3.0];
        for (edge, &cost) in costs.iter().enumerate() {
            queue.push(cost, edge as u32);
        }
        let first: Vec<_> = (0..5).filter_map(|_| queue.pop()).collect();
        assert_eq!(first, [1, 2, 5, 4, 0]);
        queue.push(1.0, 9);
        let rest: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(rest, [9, 7, 3, 6]);
        queue.push(0.5, 8);
        assert_eq!((queue.pop(), queue.pop()), (Some(8), None));
    }
}
