//! Keeps elements valid everywhere: the barrier of [`crate::energy::BernsteinBarrier`] on those in danger, the way back for the others.
//!
//! Most elements never come near the limit, and to look at all of them in every evaluation would cost more than all the rest. So only those are
//! *watched*, by the barrier, that once left its domain in this fit. What leaves it unwatched is put back to where it was before the
//! minimization, its neighbours keep what they gained, and from then on it is watched.

use super::body::Body;
use super::interior::Interior;
use crate::energy::{BernsteinBarrier, FLOOR};
use crate::error::Result;
use crate::kernel::sparse::Csr;
use crate::optimize::vectors::add_to;
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// The elements of a body of fixed orders, some of them watched.
pub(super) struct Guard {
    /// The edge lengths of the ideal shapes. `[cells]`.
    sizes: Vec<f64>,
    /// All elements, and the least Bernstein coefficient of each where the last minimization left it.
    all: Watch,
    bounds: Vec<f64>,
    /// The watched ones, ascending, and their barrier.
    watched: Vec<u32>,
    watch: Watch,
}

impl Guard {
    /// On elements whose ideal shapes have edges of length `sizes`, `[cells]`, with an eye on those of `watched` that are in the barrier's domain.
    ///
    /// # Errors
    /// As [`BernsteinBarrier::new`].
    pub fn new(body: &Body, sizes: &[f64], watched: &[u32]) -> Result<Self> {
        let every: Vec<u32> = (0..sizes.len() as u32).collect();
        let all = Watch::new(body, sizes, &every)?;
        let mut guard = Self {
            bounds: all.bounds(body.unknowns()),
            all,
            sizes: sizes.to_vec(),
            watched: Vec::new(),
            watch: Watch::new(body, sizes, &[])?,
        };
        guard.watch_also(body, watched)?;
        Ok(guard)
    }

    /// The watched elements, ascending.
    pub fn watched(&self) -> &[u32] {
        &self.watched
    }

    /// The barrier.
    pub fn watch(&self) -> &Watch {
        &self.watch
    }

    /// After a minimization that started with the unknowns `before`: puts elements back there until none has left the barrier's domain or
    /// is inverted in the sense of `interior`, and watches them from now on. Whether there were any.
    ///
    /// It ends, for elements that are back are as good as they were.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn settle(
        &mut self,
        body: &mut Body,
        before: &[DVec3],
        interior: &Interior,
    ) -> Result<bool> {
        let mut lost: Vec<u32> = Vec::new();
        loop {
            let now = self.all.bounds(body.unknowns());
            let left = |&c: &usize| self.bounds[c] > FLOOR && now[c] <= FLOOR;
            let mut newly: Vec<u32> = (0..now.len()).filter(left).map(|c| c as u32).collect();
            // What minimized the distortion is not inverted, but what lies beside an element that was put back may be.
            if !lost.is_empty() {
                newly.extend(interior.inverted(body.unknowns())?);
            }
            if newly.is_empty() {
                self.bounds = now;
                break;
            }
            newly.sort_unstable();
            let mut unknowns = body.unknowns().to_vec();
            self.all.put_back(&newly, before, &mut unknowns);
            body.set_unknowns(unknowns);
            lost.extend(newly);
        }
        if lost.is_empty() {
            return Ok(false);
        }
        self.watch_also(body, &lost)?;
        Ok(true)
    }

    fn watch_also(&mut self, body: &Body, cells: &[u32]) -> Result<()> {
        let inside = cells.iter().filter(|&&c| self.bounds[c as usize] > FLOOR);
        self.watched.extend(inside);
        self.watched.sort_unstable();
        self.watched.dedup();
        self.watch = Watch::new(body, &self.sizes, &self.watched)?;
        Ok(())
    }
}

/// The barrier on some elements.
pub(super) struct Watch {
    parts: Vec<Part>,
    cell_count: usize,
}

/// The watched elements of one shape and order.
struct Part {
    cells: Vec<u32>,
    gather: Csr,
    scatter: Csr,
    barrier: BernsteinBarrier,
}

impl Watch {
    /// On `cells`, ascending, among elements whose ideal shapes have edges of length `sizes`, `[cells of the volume]`.
    ///
    /// # Errors
    /// As [`BernsteinBarrier::new`].
    pub fn new(body: &Body, sizes: &[f64], cells: &[u32]) -> Result<Self> {
        let volume = body.volume();
        let mut parts = Vec::new();
        for mut group in volume.groups() {
            group.cells.retain(|c| cells.binary_search(c).is_ok());
            if group.cells.is_empty() {
                continue;
            }
            let inverse =
                |&c: &u32| volume.reference_inverse(c as usize) * sizes[c as usize].recip();
            let inverses = group.cells.iter().map(inverse).collect();
            let gather = body.gather(&group.cells);
            parts.push(Part {
                scatter: gather.transpose(),
                gather,
                barrier: BernsteinBarrier::new(
                    group.shape,
                    volume.basis(),
                    group.order,
                    inverses,
                    sizes.len(),
                )?,
                cells: group.cells,
            });
        }
        Ok(Self {
            parts,
            cell_count: sizes.len(),
        })
    }

    /// The least Bernstein coefficient of every cell of the volume; infinite where it is not watched.
    pub fn bounds(&self, unknowns: &[DVec3]) -> Vec<f64> {
        let mut bounds = vec![f64::INFINITY; self.cell_count];
        for part in &self.parts {
            let least = part.barrier.bounds(&part.gather.apply(unknowns));
            for (&c, bound) in part.cells.iter().zip(least) {
                bounds[c as usize] = bound;
            }
        }
        bounds
    }

    /// The barrier, infinite where a coefficient is not positive; adds `weight` times its gradient, `[unknowns]`.
    pub fn evaluate(&self, unknowns: &[DVec3], weight: f64, gradient: &mut [DVec3]) -> f64 {
        let mut value = 0.0;
        for part in &self.parts {
            let (term, local) = part.barrier.evaluate(&part.gather.apply(unknowns));
            value += term;
            add_to(gradient, &part.scatter.apply(&local), weight);
        }
        value
    }

    /// What [`BernsteinBarrier::fold_slopes`] knows of the second derivatives, by each unknown alone. `[unknowns]`.
    pub fn diagonal(&self, unknowns: &[DVec3]) -> Vec<DMat3> {
        let mut diagonal = vec![DMat3::ZERO; unknowns.len()];
        let add = |sum: &mut BTreeMap<u32, DMat3>, slope: &[(u32, DVec3)]| {
            for &(i, s) in slope {
                *sum.entry(i).or_insert(DMat3::ZERO) += outer(s, s);
            }
        };
        for (i, block) in self.fold(unknowns, add).into_iter().flatten() {
            diagonal[i as usize] += block;
        }
        diagonal
    }

    /// The same by pairs of unknowns, `(first, second, block)` with first ≥ second, to be added up.
    pub fn blocks(&self, unknowns: &[DVec3]) -> Vec<(u32, u32, DMat3)> {
        let add = |sum: &mut BTreeMap<(u32, u32), DMat3>, slope: &[(u32, DVec3)]| {
            for (k, &(i, s)) in slope.iter().enumerate() {
                for &(j, t) in &slope[..=k] {
                    *sum.entry((i, j)).or_insert(DMat3::ZERO) += outer(s, t);
                }
            }
        };
        let sums = self.fold(unknowns, add).into_iter().flatten();
        sums.map(|((i, j), block)| (i, j, block)).collect()
    }

    /// Folds over the slopes of each watched element, as unknowns, ascending, and vectors.
    fn fold<T: Default + Send>(
        &self,
        unknowns: &[DVec3],
        add: impl Fn(&mut T, &[(u32, DVec3)]) + Sync,
    ) -> Vec<T> {
        let mut results = Vec::new();
        for part in &self.parts {
            let local = part.gather.apply(unknowns);
            let modes = local.len() / part.cells.len();
            results.extend(part.barrier.fold_slopes(
                &local,
                T::default,
                |element, result, slope| {
                    let mut sum = BTreeMap::new();
                    for (a, s) in slope.iter().enumerate() {
                        for (i, w) in part.gather.row(element * modes + a) {
                            *sum.entry(i).or_insert(DVec3::ZERO) += w * *s;
                        }
                    }
                    add(result, &sum.into_iter().collect::<Vec<_>>());
                },
            ));
        }
        results
    }

    /// Copies all unknowns of `cells`, ascending.
    fn put_back(&self, cells: &[u32], before: &[DVec3], after: &mut [DVec3]) {
        for part in &self.parts {
            let modes = part.gather.row_count() / part.cells.len();
            for (k, _) in part
                .cells
                .iter()
                .enumerate()
                .filter(|(_, c)| cells.binary_search(c).is_ok())
            {
                for row in k * modes..(k + 1) * modes {
                    for (i, _) in part.gather.row(row) {
                        after[i as usize] = before[i as usize];
                    }
                }
            }
        }
    }
}

/// a bᵀ.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
