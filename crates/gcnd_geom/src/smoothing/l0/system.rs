//! The linear system of the positions: (I + α RᵀR + β DᵀD) p = p* + β Dᵀδ.

use super::operator::EdgeState;
use crate::cholesky::{Cholesky, entry_key};
use crate::edge_pairs::EdgePair;
use crate::error::Result;
use glam::DVec3;
use rayon::prelude::*;

/// R = p₁ − p₂ + p₃ − p₄.
const REGULARIZER: [f64; 4] = [1.0, -1.0, 1.0, -1.0];
/// Pairs of a stencil's four vertices, each once.
const PAIRS: [[usize; 2]; 10] =
    [[0, 0], [1, 1], [2, 2], [3, 3], [0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Doubles have 16 digits: above it, fewer than two are left for the positions.
const LARGEST_ENTRY: f64 = 1e14;

/// The system, whose pattern is analysed once, and memory that is reused between iterations.
pub(super) struct System {
    cholesky: Cholesky,
    /// For each stencil and pair, its place in `values`.
    slots: Vec<[u32; 10]>,
    diagonal: Vec<u32>,
    values: Vec<f64>,
    right: Vec<f64>,
}

impl System {
    /// Analyses the pattern that the stencils give over vertices `0..n`.
    ///
    /// `claim` hears how many bytes the factor and its making will take, before they are taken.
    ///
    /// # Errors
    /// What `claim` returns.
    ///
    /// # Panics
    /// If memory runs out before the factor is known, or the pattern has more than 2³² entries.
    pub fn new(stencils: &[EdgePair], n: usize, claim: impl FnOnce(u64) -> Result<()>) -> Result<Self> {
        let key_of = |s: &EdgePair, [i, j]: [usize; 2]| entry_key(s.vertices[i], s.vertices[j]);
        let mut keys: Vec<u64> = stencils.iter().flat_map(|s| PAIRS.map(|pair| key_of(s, pair))).collect();
        keys.extend((0..n as u32).map(|v| entry_key(v, v)));
        keys.par_sort_unstable();
        keys.dedup();
        let slot = |key: u64| -> u32 {
            let place = keys.binary_search(&key).expect("every pair is in the pattern");
            u32::try_from(place).expect("fewer than 2^32 entries")
        };
        let slots = stencils.par_iter().map(|s| PAIRS.map(|pair| slot(key_of(s, pair)))).collect();
        let diagonal = (0..n as u32).map(|v| slot(entry_key(v, v))).collect();
        let (cholesky, values) = (Cholesky::new(n, &keys, claim)?, vec![0.0; keys.len()]);
        Ok(Self { cholesky, slots, diagonal, values, right: vec![0.0; 3 * n] })
    }

    /// Solves for `positions`; false, with `positions` unchanged, if rounding has made the system singular, or so nearly
    /// that next to nothing of the given positions would be left in what is solved.
    pub fn solve(
        &mut self,
        stencils: &[EdgePair],
        edges: &[EdgeState],
        alpha: f64,
        beta: f64,
        noisy: &[DVec3],
        positions: &mut [DVec3],
    ) -> bool {
        self.assemble(stencils, edges, alpha, beta, noisy);
        // No eigenvalue is below 1, so the largest entry tells how much of that 1 rounding takes; NaN is not below either.
        let is_sound = self.diagonal.iter().all(|&slot| self.values[slot as usize] < LARGEST_ENTRY);
        if !is_sound || !self.cholesky.factorize(&self.values) {
            return false;
        }
        self.cholesky.solve(&mut self.right);
        let n = positions.len();
        for (i, p) in positions.iter_mut().enumerate() {
            *p = DVec3::new(self.right[i], self.right[n + i], self.right[2 * n + i]);
        }
        true
    }

    /// Fills the upper triangle and the right-hand side, edge after edge.
    fn assemble(
        &mut self,
        stencils: &[EdgePair],
        edges: &[EdgeState],
        alpha: f64,
        beta: f64,
        noisy: &[DVec3],
    ) {
        self.values.fill(0.0);
        for &slot in &self.diagonal {
            self.values[slot as usize] = 1.0;
        }
        let n = noisy.len();
        for (i, p) in noisy.iter().enumerate() {
            (self.right[i], self.right[n + i], self.right[2 * n + i]) = (p.x, p.y, p.z);
        }
        for ((stencil, edge), slots) in stencils.iter().zip(edges).zip(&self.slots) {
            for ([i, j], &slot) in PAIRS.into_iter().zip(slots) {
                let value =
                    beta * edge.weights[i] * edge.weights[j] + alpha * REGULARIZER[i] * REGULARIZER[j];
                // Two corners at one vertex meet on the diagonal, from both sides.
                let is_folded = i != j && stencil.vertices[i] == stencil.vertices[j];
                self.values[slot as usize] += if is_folded { 2.0 * value } else { value };
            }
            for (&v, weight) in stencil.vertices.iter().zip(edge.weights) {
                let pull = beta * weight * edge.delta;
                self.right[v as usize] += pull.x;
                self.right[n + v as usize] += pull.y;
                self.right[2 * n + v as usize] += pull.z;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::operator::measure_edges;
    use super::*;
    use crate::edge_pairs::find_edge_pairs;
    use crate::{Topology, fixtures};

    /// I + α RᵀR + β DᵀD times p, less p* + β Dᵀδ, stencil by stencil.
    fn residual(
        stencils: &[EdgePair],
        edges: &[EdgeState],
        alpha: f64,
        beta: f64,
        noisy: &[DVec3],
        p: &[DVec3],
    ) -> f64 {
        let mut left: Vec<DVec3> = p.iter().zip(noisy).map(|(p, noisy)| *p - *noisy).collect();
        for (stencil, edge) in stencils.iter().zip(edges) {
            let apply = |w: [f64; 4]| -> DVec3 {
                stencil.vertices.iter().zip(w).map(|(&v, w)| w * p[v as usize]).sum()
            };
            let (bend, skew) = (apply(edge.weights) - edge.delta, apply(REGULARIZER));
            for k in 0..4 {
                left[stencil.vertices[k] as usize] +=
                    beta * edge.weights[k] * bend + alpha * REGULARIZER[k] * skew;
            }
        }
        left.iter().map(|r| r.length()).fold(0.0, f64::max)
    }

    #[test]
    fn the_solution_satisfies_the_equations() {
        // The last two faces share all vertices, so that one stencil has a vertex twice.
        let (mut vertices, mut faces) = fixtures::icosphere(2);
        fixtures::jitter(&mut vertices, 0.05, 2);
        let first = vertices.len() as u32;
        vertices.extend([DVec3::splat(2.0), DVec3::new(2.0, 3.0, 2.0), DVec3::new(2.5, 2.0, 2.1)]);
        faces.extend([[first, first + 1, first + 2], [first + 1, first, first + 2]]);
        let stencils = find_edge_pairs(&Topology::new(faces, vertices.len()).expect("valid"));
        let mut edges = Vec::new();
        measure_edges(&stencils, &vertices, 1e-3, &mut edges);
        assert!(edges.iter().any(|e| e.delta != DVec3::ZERO) && edges.iter().any(|e| e.delta == DVec3::ZERO));
        let mut system = System::new(&stencils, vertices.len(), |_| Ok(())).expect("allowed");
        for (alpha, beta) in [(0.1, 1e-3), (0.0, 10.0), (0.01, 500.0)] {
            let mut positions = vertices.clone();
            assert!(system.solve(&stencils, &edges, alpha, beta, &vertices, &mut positions));
            let worst = residual(&stencils, &edges, alpha, beta, &vertices, &positions);
            assert!(worst < 1e-11, "{alpha} {beta}: {worst}");
        }
        for (alpha, beta) in [(1e15, 1.0), (0.1, 1e15), (f64::MAX, 1.0), (0.1, f64::INFINITY)] {
            let mut positions = vertices.clone();
            assert!(
                !system.solve(&stencils, &edges, alpha, beta, &vertices, &mut positions),
                "{alpha} {beta}"
            );
            assert_eq!(positions, vertices);
        }
    }
}
