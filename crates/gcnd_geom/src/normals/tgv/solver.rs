//! The augmented Lagrangian at work: two linear systems, two shrinkages and two multipliers by turns.

use super::TgvParams;
use super::operator::Operators;
use crate::cholesky::{Cholesky, entry_key};
use crate::error::Result;
use crate::normals::kernel::{CHUNK, unit_or_zero};
use crate::watch::Run;
use glam::DVec3;
use rayon::prelude::*;

/// Penalties r_p and r_q over α₁ and α₀.
const PENALTY: f64 = 3.0;
/// σ_w: jumps far above it cost nothing. A right angle jumps by √2, an inverted face by 2.
const WEIGHT_SIGMA: f64 = 1.5;
/// Data terms, over β and the square of the mean edge length, are taken as at least this, for faces without area.
const LEAST_AREA: f64 = 1e-6;

/// What is unknown of one edge: V, P = D N − V, and Q = S V, with scaled multipliers u_p and u_q.
#[derive(Debug, Clone, Copy, Default)]
struct EdgeState {
    p: DVec3,
    u_p: DVec3,
    q: [DVec3; 2],
    u_q: [DVec3; 2],
}

/// The iterations on one mesh.
pub(super) struct Solver<'a> {
    operators: &'a Operators,
    params: &'a TgvParams,
    given: &'a [DVec3],
    normals: Vec<DVec3>,
    /// V.
    slopes: Vec<DVec3>,
    states: Vec<EdgeState>,
    normal_system: Cholesky,
    slope_system: Cholesky,
    right: Vec<f64>,
}

impl<'a> Solver<'a> {
    /// Factorises both systems, in two steps of the run each; diverged if rounding has made one singular, or nearly, and
    /// out of memory if a factor is larger than the run may take.
    pub fn new(
        operators: &'a Operators,
        params: &'a TgvParams,
        given: &'a [DVec3],
        run: &mut Run<'_, '_>,
    ) -> Result<Self> {
        let [r_p, r_q] = [PENALTY * params.alpha1, PENALTY * params.alpha0];
        let edges = &operators.edges;
        let diagonal = operators.areas.iter().map(|a| params.beta * a.max(LEAST_AREA)).collect();
        let normal_system = factorized(run, diagonal, |entries| {
            for edge in edges {
                let [first, second] = edge.faces;
                let weight = r_p * edge.length;
                entries.push((entry_key(first, first), weight));
                entries.push((entry_key(second, second), weight));
                entries.push((entry_key(first, second), -edge.turn * weight));
            }
        })?;
        let diagonal = edges.iter().map(|edge| r_p * edge.length).collect();
        let slope_system = factorized(run, diagonal, |entries| {
            for (e, edge) in edges.iter().enumerate() {
                for (i, weight) in operators.slope_jumps.row(e) {
                    for (j, other) in operators.slope_jumps.row(e).filter(|(j, _)| *j <= i) {
                        let value = r_q * edge.length * weight.dot(other);
                        entries.push((entry_key(i as u32, j as u32), value));
                    }
                }
            }
        })?;
        Ok(Self {
            operators,
            params,
            given,
            normals: given.to_vec(),
            slopes: vec![DVec3::ZERO; edges.len()],
            states: vec![EdgeState::default(); edges.len()],
            normal_system,
            slope_system,
            right: Vec::new(),
        })
    }

    /// One iteration; false if a normal is no longer a number.
    pub fn step(&mut self) -> bool {
        self.solve_normals();
        self.solve_slopes();
        self.shrink();
        self.normals.par_iter().with_min_len(CHUNK).all(|n| n.is_finite())
    }

    /// N.
    pub fn into_normals(self) -> Vec<DVec3> {
        self.normals
    }

    /// What is minimised, at the N and V of now.
    #[cfg(test)]
    pub fn energy(&self) -> f64 {
        let (operators, params) = (self.operators, self.params);
        let mut energy = 0.0;
        for (e, edge) in operators.edges.iter().enumerate() {
            let jump = operators.jump(edge, &self.normals);
            let weight = crease_weight(jump);
            let [along, across] = operators.slope_jump(e, &self.slopes);
            let bend = (along.length_squared() + across.length_squared()).sqrt();
            energy += edge.length * params.alpha1 * weight * (jump - self.slopes[e]).length();
            energy += edge.length * params.alpha0 * bend;
        }
        for ((normal, given), area) in self.normals.iter().zip(self.given).zip(&operators.areas) {
            energy += 0.5 * params.beta * area * normal.distance_squared(*given);
        }
        energy
    }

    /// (β A + r_p Dᵀ L D) N = β A N⁰ + r_p Dᵀ L (V + P − u_p), and back to the unit sphere.
    fn solve_normals(&mut self) {
        let Self { operators, params, given, slopes, states, .. } = self;
        let r_p = PENALTY * params.alpha1;
        let right_of = |face: usize| {
            let pull = operators.jump_adjoint(face, |e| {
                let state = &states[e];
                operators.edges[e].length * (slopes[e] + state.p - state.u_p)
            });
            params.beta * operators.areas[face] * given[face] + r_p * pull
        };
        solve(&self.normal_system, given.len(), right_of, &mut self.right);
        let (right, n) = (&self.right, self.normals.len());
        self.normals.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, normal)| {
            let solved = DVec3::new(right[i], right[n + i], right[2 * n + i]);
            *normal = match unit_or_zero(solved) {
                // The caller finds what is not a number.
                _ if !solved.is_finite() => solved,
                DVec3::ZERO => *normal,
                unit => unit,
            };
        });
    }

    /// (r_p L + r_q Sᵀ L S) V = r_p L (D N − P + u_p) + r_q Sᵀ L (Q − u_q).
    fn solve_slopes(&mut self) {
        let Self { operators, params, normals, states, .. } = self;
        let [r_p, r_q] = [PENALTY * params.alpha1, PENALTY * params.alpha0];
        let right_of = |e: usize| {
            let (edge, state) = (&operators.edges[e], &states[e]);
            if !edge.has_slope {
                return DVec3::ZERO;
            }
            let second_order = operators.slope_jump_adjoint(e, |row| {
                let EdgeState { q, u_q, .. } = &states[row];
                let length = operators.edges[row].length;
                [length * (q[0] - u_q[0]), length * (q[1] - u_q[1])]
            });
            let first_order = edge.length * (operators.jump(edge, normals) - state.p + state.u_p);
            r_p * first_order + r_q * second_order
        };
        solve(&self.slope_system, states.len(), right_of, &mut self.right);
        let (right, n) = (&self.right, self.slopes.len());
        self.slopes.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, slope)| {
            *slope = DVec3::new(right[i], right[n + i], right[2 * n + i]);
        });
    }

    /// P and Q by shrinkage, then the multipliers.
    fn shrink(&mut self) {
        let Self { operators, normals, slopes, .. } = self;
        self.states.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(e, state)| {
            let jump = operators.jump(&operators.edges[e], normals);
            let first = jump - slopes[e] + state.u_p;
            let weight = crease_weight(jump);
            state.p = first * kept(first.length(), weight / PENALTY);
            state.u_p = first - state.p;
            let [along, across] = operators.slope_jump(e, slopes);
            let second = [along + state.u_q[0], across + state.u_q[1]];
            let size = (second[0].length_squared() + second[1].length_squared()).sqrt();
            state.q = second.map(|x| x * kept(size, 1.0 / PENALTY));
            state.u_q = [second[0] - state.q[0], second[1] - state.q[1]];
        });
    }
}

/// w_e = exp(−(|D N| / σ_w)⁴).
fn crease_weight(jump: DVec3) -> f64 {
    (-(jump.length_squared() / WEIGHT_SIGMA.powi(2)).powi(2)).exp()
}

/// The fraction that shrinkage by `by` leaves of a vector of length `size`.
fn kept(size: f64, by: f64) -> f64 {
    if size > by { 1.0 - by / size } else { 0.0 }
}

/// Doubles have 16 digits: where an entry is so many times the mean of the diagonal to which it was added, fewer than
/// two are left for what the diagonal stands for.
const LARGEST_RATIO: f64 = 1e14;

/// The factor of a diagonal plus the entries that `push` adds up; diverged if they drown it, or it is not positive.
fn factorized(
    run: &mut Run<'_, '_>,
    diagonal: Vec<f64>,
    push: impl FnOnce(&mut Vec<(u64, f64)>),
) -> Result<Cholesky> {
    let n = diagonal.len();
    let limit = LARGEST_RATIO * diagonal.iter().sum::<f64>() / n.max(1) as f64;
    let mut entries: Vec<(u64, f64)> =
        (0u32..).zip(diagonal).map(|(i, value)| (entry_key(i, i), value)).collect();
    push(&mut entries);
    // Stable, so that sums do not depend on the number of threads.
    entries.par_sort_by_key(|(key, _)| *key);
    entries.dedup_by(|later, first| {
        let is_same = later.0 == first.0;
        if is_same {
            first.1 += later.1;
        }
        is_same
    });
    let (keys, values): (Vec<u64>, Vec<f64>) = entries.into_iter().unzip();
    // NaN is not below the limit either.
    if !values.iter().all(|value| value.abs() < limit.max(f64::MIN_POSITIVE)) {
        return Err(run.diverged());
    }
    let mut system = Cholesky::new(n, &keys, |bytes| run.claim(bytes))?;
    run.tick()?;
    if !system.factorize(&values) {
        return Err(run.diverged());
    }
    run.tick()?;
    Ok(system)
}

/// Solves a system for the three coordinates, which end one after the other in `right`.
fn solve(system: &Cholesky, n: usize, right_of: impl Fn(usize) -> DVec3 + Sync, right: &mut Vec<f64>) {
    right.resize(3 * n, 0.0);
    let (x, yz) = right.split_at_mut(n);
    let (y, z) = yz.split_at_mut(n);
    let rows = x.par_iter_mut().zip(y).zip(z).enumerate().with_min_len(CHUNK);
    rows.for_each(|(i, ((x, y), z))| DVec3 { x: *x, y: *y, z: *z } = right_of(i));
    system.solve(right);
}
