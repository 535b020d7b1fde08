//! Weighted nuclear norm shrinkage of matrices with few columns, by the eigenvectors of their Gram matrix.

/// c of the weights: 2.8·√2.
const STRENGTH: f64 = 2.8 * std::f64::consts::SQRT_2;
/// ε, which keeps the weights finite.
const EPSILON: f64 = 1e-5;

/// Recovers matrices of a given number of columns; holds the memory for it.
#[derive(Default)]
pub(crate) struct Shrinkage {
    n_columns: usize,
    means: Vec<f64>,
    row: Vec<f64>,
    /// YᵀY, which ends as the diagonal of its eigenvalues.
    gram: Vec<f64>,
    /// One eigenvector a row.
    vectors: Vec<f64>,
    /// V diag(s'/s) Vᵀ: what Y is multiplied by.
    projection: Vec<f64>,
}

impl Shrinkage {
    /// Replaces a matrix (row-major, N columns) by the mean of each row plus the rest Y with its singular values s
    /// shrunk to max(s − w, 0), w = c·√N·σ² / (√max(s² − N·σ², 0) + ε). Returns how many of them remain.
    pub fn recover(&mut self, matrix: &mut [f64], n_columns: usize, sigma: f64) -> usize {
        self.n_columns = n_columns;
        self.means.clear();
        for row in matrix.chunks_exact_mut(n_columns) {
            let mean = row.iter().sum::<f64>() / n_columns as f64;
            row.iter_mut().for_each(|x| *x -= mean);
            self.means.push(mean);
        }
        self.multiply_transposed(matrix);
        diagonalize(&mut self.gram, &mut self.vectors, n_columns);
        let rank = self.project(sigma);
        for (row, mean) in matrix.chunks_exact_mut(n_columns).zip(&self.means) {
            self.row.clear();
            self.row.extend_from_slice(row);
            row.fill(*mean);
            for (x, factors) in self.row.iter().zip(self.projection.chunks_exact(n_columns)) {
                row.iter_mut().zip(factors).for_each(|(sum, factor)| *sum += x * factor);
            }
        }
        rank
    }

    /// The Gram matrix of the columns.
    fn multiply_transposed(&mut self, matrix: &[f64]) {
        let n = self.n_columns;
        self.gram.clear();
        self.gram.resize(n * n, 0.0);
        for row in matrix.chunks_exact(n) {
            for (x, sums) in row.iter().zip(self.gram.chunks_exact_mut(n)) {
                sums.iter_mut().zip(row).for_each(|(sum, y)| *sum += x * y);
            }
        }
    }

    /// Fills the projection; returns its rank.
    fn project(&mut self, sigma: f64) -> usize {
        let n = self.n_columns;
        self.projection.clear();
        self.projection.resize(n * n, 0.0);
        let mut rank = 0;
        for (k, vector) in self.vectors.chunks_exact(n).enumerate() {
            let square = self.gram[k * n + k];
            let kept = shrunk(square, n, sigma);
            if kept > 0.0 {
                rank += 1;
                let factor = kept / square.sqrt();
                for (x, sums) in vector.iter().zip(self.projection.chunks_exact_mut(n)) {
                    sums.iter_mut().zip(vector).for_each(|(sum, y)| *sum += factor * x * y);
                }
            }
        }
        rank
    }
}

/// max(s − w, 0) of a singular value s, given s².
fn shrunk(square: f64, n_columns: usize, sigma: f64) -> f64 {
    let (square, n) = (square.max(0.0), n_columns as f64);
    let signal = (square - n * sigma * sigma).max(0.0).sqrt();
    (square.sqrt() - STRENGTH * n.sqrt() * sigma * sigma / (signal + EPSILON)).max(0.0)
}

/// Diagonalises a symmetric n × n matrix by cyclic Jacobi rotations; row k of `vectors` becomes the eigenvector of the
/// k-th entry of the diagonal.
///
/// Deterministic: the same matrix always gives the same bits.
fn diagonalize(matrix: &mut [f64], vectors: &mut Vec<f64>, n: usize) {
    const MOST_SWEEPS: usize = 32;
    vectors.clear();
    vectors.resize(n * n, 0.0);
    vectors.iter_mut().step_by(n + 1).for_each(|x| *x = 1.0);
    let size = matrix.iter().fold(0.0, |size: f64, x| size.max(x.abs()));
    for _ in 0..MOST_SWEEPS {
        let mut is_done = true;
        for p in 0..n {
            for q in p + 1..n {
                if matrix[p * n + q].abs() > size * 1e-15 {
                    is_done = false;
                    rotate(matrix, vectors, n, p, q);
                }
            }
        }
        if is_done {
            break;
        }
    }
}

/// Makes the entries (p, q) and (q, p) zero, for p < q.
fn rotate(matrix: &mut [f64], vectors: &mut [f64], n: usize, p: usize, q: usize) {
    let theta = (matrix[q * n + q] - matrix[p * n + p]) / (2.0 * matrix[p * n + q]);
    // The smaller root, for a rotation of at most 45 degrees.
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let cosine = 1.0 / (t * t + 1.0).sqrt();
    let sine = t * cosine;
    let turn = |x: &mut f64, y: &mut f64| (*x, *y) = (cosine * *x - sine * *y, sine * *x + cosine * *y);
    for rows in [&mut *matrix, vectors] {
        let (before, after) = rows.split_at_mut(q * n);
        before[p * n..][..n].iter_mut().zip(&mut after[..n]).for_each(|(x, y)| turn(x, y));
    }
    for row in matrix.chunks_exact_mut(n) {
        let (before, after) = row.split_at_mut(q);
        turn(&mut before[p], &mut after[0]);
    }
    matrix[p * n + q] = 0.0;
    matrix[q * n + p] = 0.0;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn one_singular_value_by_hand() {
        // Rows ±a around their mean 1: Y = a·[1, −1; 1, −1], whose one singular value is 2a.
        let a = 0.75;
        let mut matrix = [1.0 + a, 1.0 - a, 1.0 + a, 1.0 - a];
        let rank = Shrinkage::default().recover(&mut matrix, 2, 0.2);
        let s = 2.0 * a;
        let kept = s - 2.8 * 2.0 * 0.04 / ((s * s - 2.0 * 0.04).sqrt() + 1e-5);
        let expected = [1.0, -1.0, 1.0, -1.0].map(|sign| 1.0 + sign * a * kept / s);
        assert_eq!(rank, 1);
        assert!(matrix.iter().zip(expected).all(|(x, e)| (x - e).abs() < 1e-14), "{matrix:?} {expected:?}");
    }

    #[test]
    fn noise_leaves_the_means() {
        let mut matrix = [0.1, 0.0, -0.1, 0.9, 1.0, 1.1];
        assert_eq!(Shrinkage::default().recover(&mut matrix, 3, 0.2), 0);
        assert!(matrix.iter().zip([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]).all(|(x, e)| (x - e).abs() < 1e-15));
        assert_eq!(Shrinkage::default().recover(&mut [0.3, -0.7], 1, 0.2), 0, "one column is its own mean");
    }

    proptest! {
        #[test]
        fn without_noise_nothing_changes(
            matrix in prop::collection::vec(-1.0..1.0f64, 12..=12),
            n_columns in prop::sample::select(vec![1, 2, 3, 4, 6]),
        ) {
            let mut recovered = matrix.clone();
            Shrinkage::default().recover(&mut recovered, n_columns, 1e-12);
            prop_assert!(matrix.iter().zip(&recovered).all(|(x, r)| (x - r).abs() < 1e-12));
        }

        #[test]
        fn any_symmetric_matrix_is_diagonalized(entries in prop::collection::vec(-1.0..1.0f64, 49..=49)) {
            let n = 7;
            let original: Vec<f64> = (0..49).map(|i| entries[i] + entries[(i % n) * n + i / n]).collect();
            let (mut matrix, mut vectors) = (original.clone(), Vec::new());
            diagonalize(&mut matrix, &mut vectors, n);
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            for k in 0..n {
                let vector = &vectors[k * n..][..n];
                for i in 0..n {
                    let residual = dot(&original[i * n..][..n], vector) - matrix[k * n + k] * vector[i];
                    let product = dot(vector, &vectors[i * n..][..n]);
                    prop_assert!(residual.abs() < 1e-13, "{residual}");
                    prop_assert!((product - f64::from(i == k)).abs() < 1e-13, "{product}");
                }
            }
        }
    }
}
