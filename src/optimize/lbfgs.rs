//! Limited-memory BFGS (Liu & Nocedal 1989), the two-loop recursion with the last `memory` pairs, around an approximation of
//! the inverse Hessian where the caller has one.

use super::line_search::{self, Sample};
use super::vectors::{add, add_to, dot, scale_by};
use glam::DVec3;
use std::collections::VecDeque;

/// The settings of a minimization.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lbfgs {
    /// Pairs kept.
    pub memory: usize,
    /// Iterations at most.
    pub iterations: usize,
    /// Stagnation: stop where the mean relative decrease over the last five iterations is under this.
    pub decrease: f64,
    /// The length of the very first step, as the largest motion of a point.
    pub first_step: f64,
}

/// What the caller knows of the curvature of a function.
#[derive(Clone, Copy)]
pub struct Curvature<'a> {
    /// g ↦ H₀ g with H₀ symmetric, positive definite and near the inverse of the Hessian; only its scale is corrected.
    pub inverse: &'a dyn Fn(&[DVec3]) -> Vec<DVec3>,
    /// Stationary: stop where gᵀ H₀ g, twice the decrease to be hoped for, is under this share of the value.
    pub tolerance: f64,
}

/// An accepted iterate.
#[derive(Debug)]
pub struct Iterate<'a> {
    /// Counted from 1.
    pub iteration: usize,
    /// `[points]`.
    pub x: &'a [DVec3],
    /// The value there.
    pub value: f64,
    /// The Euclidean norm of the gradient.
    pub gradient_norm: f64,
}

/// Why a minimization ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The value hardly decreases any more.
    Stagnation,
    /// The iterations are used up.
    Count,
    /// No step along the search direction lowers the value to working precision.
    LineSearch,
    /// The gradient vanishes.
    Stationary,
    /// The observer asked for it.
    Observer,
}

/// The end of a minimization.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// `[points]`, the best found.
    pub x: Vec<DVec3>,
    /// The value there.
    pub value: f64,
    /// Iterations done.
    pub iterations: usize,
    /// Calls of the function.
    pub evaluations: usize,
    /// Why it ended.
    pub stop: Stop,
}

/// A step and the change of the gradient over it.
struct Pair {
    s: Vec<DVec3>,
    y: Vec<DVec3>,
    rho: f64,
}

impl Lbfgs {
    /// Minimizes `function` from `x`. `function` returns value and gradient, an infinite value outside its domain;
    /// `observe` sees every accepted iterate and returns whether to go on.
    ///
    /// # Errors
    /// Those of `function`.
    pub fn minimize<E>(
        &self,
        x: Vec<DVec3>,
        function: impl FnMut(&[DVec3]) -> Result<(f64, Vec<DVec3>), E>,
        observe: impl FnMut(&Iterate) -> bool,
    ) -> Result<Minimum, E> {
        self.run(x, function, observe, None)
    }

    /// Like [`minimize`](Self::minimize), helped by `curvature`. The first step tried is then the one that H₀ proposes.
    ///
    /// # Errors
    /// Those of `function`.
    pub fn minimize_preconditioned<E>(
        &self,
        x: Vec<DVec3>,
        function: impl FnMut(&[DVec3]) -> Result<(f64, Vec<DVec3>), E>,
        observe: impl FnMut(&Iterate) -> bool,
        curvature: Curvature,
    ) -> Result<Minimum, E> {
        self.run(x, function, observe, Some(curvature))
    }

    fn run<E>(
        &self,
        mut x: Vec<DVec3>,
        mut function: impl FnMut(&[DVec3]) -> Result<(f64, Vec<DVec3>), E>,
        mut observe: impl FnMut(&Iterate) -> bool,
        curvature: Option<Curvature>,
    ) -> Result<Minimum, E> {
        let (mut value, mut gradient) = function(&x)?;
        let mut pairs: VecDeque<Pair> = VecDeque::new();
        let mut values = VecDeque::from([value]);
        let mut evaluations = 1;
        let mut iterations = 0;
        let stop = loop {
            if iterations == self.iterations {
                break Stop::Count;
            }
            if gradient.iter().all(|g| *g == DVec3::ZERO) {
                break Stop::Stationary;
            }
            let mut direction = descent(&gradient, &pairs, curvature);
            if dot(&direction, &gradient) >= 0.0 {
                pairs.clear();
                direction = descent(&gradient, &pairs, curvature);
            }
            if let Some(c) = curvature
                && -dot(&direction, &gradient) <= c.tolerance * value.abs()
            {
                break Stop::Stationary;
            }
            let first_step = if pairs.is_empty() && curvature.is_none() {
                self.first_step / gradient.iter().map(|g| g.length()).fold(0.0, f64::max)
            } else {
                1.0
            };
            let start = Sample {
                step: 0.0,
                value,
                slope: dot(&direction, &gradient),
            };
            let mut best: Option<(f64, Trial)> = None;
            let mut failure = None;
            let found = line_search::search(start, first_step, |step| {
                let at: Vec<DVec3> = add(&x, &direction, step);
                evaluations += 1;
                match function(&at) {
                    Ok((value, gradient)) => {
                        let slope = dot(&direction, &gradient);
                        // The step returned is always the lowest tried.
                        if best.as_ref().is_none_or(|(_, t)| value <= t.value) {
                            best = Some((
                                step,
                                Trial {
                                    x: at,
                                    value,
                                    gradient,
                                },
                            ));
                        }
                        Sample { step, value, slope }
                    }
                    Err(e) => {
                        failure = Some(e);
                        Sample {
                            step,
                            value: f64::INFINITY,
                            slope: 0.0,
                        }
                    }
                }
            });
            if let Some(e) = failure {
                return Err(e);
            }
            let (Some(_), Some((_, trial))) = (found, best) else {
                if pairs.is_empty() {
                    break Stop::LineSearch;
                }
                // Once more along the gradient.
                pairs.clear();
                continue;
            };
            push_pair(&mut pairs, self.memory, &x, &gradient, &trial);
            Trial { x, value, gradient } = trial;
            iterations += 1;
            values.push_back(value);
            let go_on = observe(&Iterate {
                iteration: iterations,
                x: &x,
                value,
                gradient_norm: dot(&gradient, &gradient).sqrt(),
            });
            if !go_on {
                break Stop::Observer;
            }
            if values.len() > 5 {
                let before = values.pop_front().unwrap_or(value);
                if before - value < 5.0 * self.decrease * before.abs() {
                    break Stop::Stagnation;
                }
            }
        };
        Ok(Minimum {
            x,
            value,
            iterations,
            evaluations,
            stop,
        })
    }
}

struct Trial {
    x: Vec<DVec3>,
    value: f64,
    gradient: Vec<DVec3>,
}

fn push_pair(
    pairs: &mut VecDeque<Pair>,
    memory: usize,
    x: &[DVec3],
    gradient: &[DVec3],
    trial: &Trial,
) {
    let s = add(&trial.x, x, -1.0);
    let y = add(&trial.gradient, gradient, -1.0);
    let sy = dot(&s, &y);
    // Without curvature along the step the update would lose positive definiteness.
    if sy > 1e-14 * (dot(&s, &s) * dot(&y, &y)).sqrt() {
        if pairs.len() == memory {
            pairs.pop_front();
        }
        pairs.push_back(Pair {
            s,
            y,
            rho: 1.0 / sy,
        });
    }
}

/// −H g by the two-loop recursion.
fn descent(gradient: &[DVec3], pairs: &VecDeque<Pair>, curvature: Option<Curvature>) -> Vec<DVec3> {
    let mut q = gradient.to_vec();
    scale_by(&mut q, -1.0);
    let mut alphas = Vec::with_capacity(pairs.len());
    for p in pairs.iter().rev() {
        let alpha = p.rho * dot(&p.s, &q);
        add_to(&mut q, &p.y, -alpha);
        alphas.push(alpha);
    }
    if let Some(c) = curvature {
        q = (c.inverse)(&q);
    }
    if let Some(p) = pairs.back() {
        let seen = match curvature {
            Some(c) => dot(&p.y, &(c.inverse)(&p.y)),
            None => dot(&p.y, &p.y),
        };
        let scale = 1.0 / (p.rho * seen);
        scale_by(&mut q, scale);
    }
    for (p, alpha) in pairs.iter().zip(alphas.into_iter().rev()) {
        let beta = p.rho * dot(&p.y, &q);
        add_to(&mut q, &p.s, alpha - beta);
    }
    q
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: Lbfgs = Lbfgs {
        memory: 10,
        iterations: 400,
        decrease: 0.0,
        first_step: 0.1,
    };

    fn rosenbrock(x: &[DVec3]) -> Result<(f64, Vec<DVec3>), ()> {
        let (a, b) = (x[0].x, x[0].y);
        let (p, q) = (1.0 - a, b - a * a);
        let gradient = DVec3::new(-2.0 * p - 400.0 * a * q, 200.0 * q, 2.0 * x[0].z);
        Ok((p * p + 100.0 * q * q + x[0].z * x[0].z, vec![gradient]))
    }

    #[test]
    fn finds_the_minimum_of_a_curved_valley() {
        let end = SETTINGS
            .minimize(vec![DVec3::new(-1.2, 1.0, 3.0)], rosenbrock, |_| true)
            .unwrap();
        assert!(
            (end.x[0] - DVec3::new(1.0, 1.0, 0.0)).length() < 1e-6,
            "{end:?}"
        );
        assert!(end.evaluations < 100, "{end:?}");
    }

    #[test]
    fn stays_inside_a_barrier() {
        // −ln x + x with an infinite value for x ≤ 0, from far right where the first steps overshoot.
        let f = |x: &[DVec3]| {
            let t = x[0].x;
            if t <= 0.0 {
                return Ok::<_, ()>((f64::INFINITY, vec![DVec3::ZERO]));
            }
            Ok((t - t.ln(), vec![DVec3::new(1.0 - 1.0 / t, 0.0, 0.0)]))
        };
        let settings = Lbfgs {
            first_step: 50.0,
            ..SETTINGS
        };
        let end = settings
            .minimize(vec![DVec3::new(20.0, 0.0, 0.0)], f, |it| it.x[0].x > 0.0)
            .unwrap();
        assert!((end.x[0].x - 1.0).abs() < 1e-6, "{end:?}");
    }

    #[test]
    fn knowledge_of_the_curvature_is_used() {
        // A quadratic with curvatures from 1 to 10⁶, mixed between neighbours.
        let stiffness = |i: usize| 10f64.powf(6.0 * i as f64 / 99.0);
        let f = |x: &[DVec3]| {
            let n = x.len();
            let next = |v: &[DVec3], i: usize| v.get(i).copied().unwrap_or(DVec3::ZERO);
            let residual: Vec<DVec3> = (0..n).map(|i| x[i] + 0.1 * next(x, i + 1)).collect();
            let scaled: Vec<DVec3> = (0..n).map(|i| stiffness(i) * residual[i]).collect();
            let gradient = (0..n)
                .map(|i| scaled[i] + 0.1 * next(&scaled, i.wrapping_sub(1)))
                .collect();
            Ok::<_, ()>((0.5 * dot(&residual, &scaled) + 1.0, gradient))
        };
        let inverse = |g: &[DVec3]| {
            g.iter()
                .enumerate()
                .map(|(i, g)| *g / stiffness(i))
                .collect()
        };
        let curvature = Curvature {
            inverse: &inverse,
            tolerance: 1e-10,
        };
        let start = vec![DVec3::ONE; 100];
        let end = SETTINGS
            .minimize_preconditioned(start.clone(), f, |_| true, curvature)
            .unwrap();
        assert_eq!(end.stop, Stop::Stationary);
        assert!(end.iterations < 20 && end.value < 1.0 + 1e-8, "{end:?}");
        let settings = Lbfgs {
            iterations: end.iterations,
            ..SETTINGS
        };
        let without = settings.minimize(start, f, |_| true).unwrap();
        assert!(without.value > 2.0, "{without:?}");
    }

    #[test]
    fn stops_when_asked_and_when_stationary() {
        let end = SETTINGS
            .minimize(vec![DVec3::splat(2.0)], rosenbrock, |it| it.iteration < 3)
            .unwrap();
        assert_eq!((end.stop, end.iterations), (Stop::Observer, 3));
        let end = SETTINGS
            .minimize(vec![DVec3::new(1.0, 1.0, 0.0)], rosenbrock, |_| true)
            .unwrap();
        assert_eq!((end.stop, end.iterations), (Stop::Stationary, 0));
    }
}
