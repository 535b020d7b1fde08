//! The linear system of the positions: (I + α RᵀR + β DᵀD) p = p* + β Dᵀδ.

use super::operator::{EdgeState, Stencil};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::cholesky::{SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side};
use glam::DVec3;
use rayon::prelude::*;

/// R = p₁ − p₂ + p₃ − p₄.
const REGULARIZER: [f64; 4] = [1.0, -1.0, 1.0, -1.0];
/// Pairs of a stencil's four vertices, each once.
const PAIRS: [[usize; 2]; 10] =
    [[0, 0], [1, 1], [2, 2], [3, 3], [0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// The system, whose pattern is analysed once, and memory that is reused between iterations.
pub(super) struct System {
    pattern: SymbolicSparseColMat<usize>,
    factorization: SymbolicCholesky<usize>,
    /// For each stencil and pair, its place in `values`.
    slots: Vec<[u32; 10]>,
    diagonal: Vec<u32>,
    values: Vec<f64>,
    factor: Vec<f64>,
    right: Vec<f64>,
    scratch: MemBuffer,
}

impl System {
    /// Analyses the pattern that the stencils give over vertices `0..n`.
    ///
    /// # Panics
    /// If memory runs out, or the pattern has more than 2³² entries.
    pub fn new(stencils: &[Stencil], n: usize) -> Self {
        let key = |a: u32, b: u32| u64::from(a.max(b)) << 32 | u64::from(a.min(b));
        let key_of = |s: &Stencil, [i, j]: [usize; 2]| key(s.vertices[i], s.vertices[j]);
        let mut keys: Vec<u64> = stencils.iter().flat_map(|s| PAIRS.map(|pair| key_of(s, pair))).collect();
        keys.extend((0..n as u32).map(|v| key(v, v)));
        keys.par_sort_unstable();
        keys.dedup();
        let slot = |key: u64| -> u32 {
            let place = keys.binary_search(&key).expect("every pair is in the pattern");
            u32::try_from(place).expect("fewer than 2^32 entries")
        };
        let slots = stencils.par_iter().map(|s| PAIRS.map(|pair| slot(key_of(s, pair)))).collect();
        let diagonal = (0..n as u32).map(|v| slot(key(v, v))).collect();
        let column_starts =
            (0..=n as u64).map(|column| keys.partition_point(|key| key >> 32 < column)).collect();
        let rows = keys.iter().map(|key| *key as u32 as usize).collect();
        let pattern = SymbolicSparseColMat::new_checked(n, n, column_starts, None, rows);
        let ordering = SymmetricOrdering::Amd;
        let factorization =
            factorize_symbolic_cholesky(pattern.as_ref(), Side::Upper, ordering, Default::default())
                .expect("memory for the pattern of the factor");
        let numeric = factorization.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let solving = factorization.solve_in_place_scratch::<f64>(3, Par::Seq);
        let scratch = MemBuffer::new(numeric.or(solving));
        let (values, factor) = (vec![0.0; keys.len()], vec![0.0; factorization.len_val()]);
        Self { pattern, factorization, slots, diagonal, values, factor, right: vec![0.0; 3 * n], scratch }
    }

    /// Solves for `positions`; false, with `positions` unchanged, if rounding has made the system singular.
    pub fn solve(
        &mut self,
        stencils: &[Stencil],
        edges: &[EdgeState],
        alpha: f64,
        beta: f64,
        noisy: &[DVec3],
        positions: &mut [DVec3],
    ) -> bool {
        self.assemble(stencils, edges, alpha, beta, noisy);
        let matrix = SparseColMatRef::new(self.pattern.as_ref(), &self.values[..]);
        // One thread: the factor must not depend on how many there are.
        let stack = MemStack::new(&mut self.scratch);
        let (none, params) = (Default::default(), Default::default());
        let factorized = self.factorization.factorize_numeric_llt(
            &mut self.factor,
            matrix,
            Side::Upper,
            none,
            Par::Seq,
            stack,
            params,
        );
        let Ok(factorized) = factorized else { return false };
        let n = positions.len();
        let right = MatMut::from_column_major_slice_mut(&mut self.right, n, 3);
        factorized.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut self.scratch));
        for (i, p) in positions.iter_mut().enumerate() {
            *p = DVec3::new(self.right[i], self.right[n + i], self.right[2 * n + i]);
        }
        true
    }

    /// Fills the upper triangle and the right-hand side, edge after edge.
    fn assemble(
        &mut self,
        stencils: &[Stencil],
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
    use super::super::operator::{find_stencils, measure_edges};
    use super::*;
    use crate::{Topology, fixtures};

    /// I + α RᵀR + β DᵀD times p, less p* + β Dᵀδ, stencil by stencil.
    fn residual(
        stencils: &[Stencil],
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
        let stencils = find_stencils(&Topology::new(faces, vertices.len()).expect("valid"));
        let mut edges = Vec::new();
        measure_edges(&stencils, &vertices, 1e-3, &mut edges);
        assert!(edges.iter().any(|e| e.delta != DVec3::ZERO) && edges.iter().any(|e| e.delta == DVec3::ZERO));
        let mut system = System::new(&stencils, vertices.len());
        for (alpha, beta) in [(0.1, 1e-3), (0.0, 10.0), (0.01, 500.0)] {
            let mut positions = vertices.clone();
            assert!(system.solve(&stencils, &edges, alpha, beta, &vertices, &mut positions));
            let worst = residual(&stencils, &edges, alpha, beta, &vertices, &positions);
            assert!(worst < 1e-11, "{alpha} {beta}: {worst}");
        }
    }
}
