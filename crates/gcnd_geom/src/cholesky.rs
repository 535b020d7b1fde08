//! Sparse symmetric positive definite systems, whose pattern is analysed once.

use crate::error::Result;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::cholesky::{
    LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side};
use rayon::prelude::*;

/// An entry's place: what keys of entries are sorted by. Both halves of a symmetric matrix share it.
pub(crate) fn entry_key(a: u32, b: u32) -> u64 {
    u64::from(a.max(b)) << 32 | u64::from(a.min(b))
}

/// A Cholesky factor and the memory to make and use it, reused from one set of values to the next.
pub(crate) struct Cholesky {
    pattern: SymbolicSparseColMat<usize>,
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
}

impl Cholesky {
    /// Analyses a pattern over `0..n`: the keys of its upper triangle, ascending, each once, the diagonal among them.
    ///
    /// `claim` hears how many bytes the factor and its making will take, before they are taken.
    ///
    /// # Errors
    /// What `claim` returns.
    ///
    /// # Panics
    /// If memory runs out before the factor is known.
    pub fn new(n: usize, keys: &[u64], claim: impl FnOnce(u64) -> Result<()>) -> Result<Self> {
        let column_starts =
            (0..=n as u64).map(|column| keys.partition_point(|key| key >> 32 < column)).collect();
        let rows = keys.iter().map(|key| *key as u32 as usize).collect();
        let pattern = SymbolicSparseColMat::new_checked(n, n, column_starts, None, rows);
        let ordering = SymmetricOrdering::Amd;
        let symbolic =
            factorize_symbolic_cholesky(pattern.as_ref(), Side::Upper, ordering, Default::default())
                .expect("memory for the pattern of the factor");
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        claim((size_of::<f64>() * symbolic.len_val() + scratch.size_bytes()) as u64)?;
        let factor = vec![0.0; symbolic.len_val()];
        Ok(Self { pattern, symbolic, factor })
    }

    /// Factorises the matrix of these values, in the order of the keys; false if it is not positive definite.
    pub fn factorize(&mut self, values: &[f64]) -> bool {
        let matrix = SparseColMatRef::new(self.pattern.as_ref(), values);
        let scratch = self.symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let mut memory = MemBuffer::new(scratch);
        // One thread: the factor must not depend on how many there are.
        let result = self.symbolic.factorize_numeric_llt(
            &mut self.factor,
            matrix,
            Side::Upper,
            Default::default(),
            Par::Seq,
            MemStack::new(&mut memory),
            Default::default(),
        );
        result.is_ok()
    }

    /// Solves in place for right-hand sides that lie one after the other, each on a thread of its own.
    pub fn solve(&self, right: &mut [f64]) {
        let n = self.symbolic.nrows();
        right.par_chunks_mut(n.max(1)).for_each(|right| {
            let mut memory = MemBuffer::new(self.symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
            let factorized = LltRef::new(&self.symbolic, &self.factor);
            let right = MatMut::from_column_major_slice_mut(right, n, 1);
            factorized.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut memory));
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GeomError;

    #[test]
    fn a_small_system_by_hand() {
        // [[4, 2, 0], [2, 5, 1], [0, 1, 3]] · (1, 2, 3) = (8, 15, 11), and twice the matrix gives half of it.
        let keys = [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2)].map(|(a, b)| entry_key(a, b));
        let mut claimed = 0;
        let claim = |bytes| {
            claimed = bytes;
            Ok(())
        };
        let mut system = Cholesky::new(3, &keys, claim).expect("allowed");
        assert!(claimed >= 5 * 8, "five entries and what it takes to make them: {claimed}");
        for scale in [1.0, 2.0] {
            assert!(system.factorize(&[4.0, 2.0, 5.0, 1.0, 3.0].map(|x| scale * x)));
            let mut right = [8.0, 15.0, 11.0, -8.0, -15.0, -11.0];
            system.solve(&mut right);
            for (x, expected) in right.iter().zip([1.0, 2.0, 3.0, -1.0, -2.0, -3.0]) {
                assert!((scale * x - expected).abs() < 1e-14, "{right:?}");
            }
        }
        assert!(!system.factorize(&[1.0, 2.0, 1.0, 0.0, 1.0]), "indefinite");
        assert!(!system.factorize(&[f64::NAN, 0.0, 1.0, 0.0, 1.0]));
        let no = GeomError::OutOfMemory { needed: 5, free: 4 };
        assert_eq!(Cholesky::new(3, &keys, |_| Err(no.clone())).err(), Some(no));
    }
}
