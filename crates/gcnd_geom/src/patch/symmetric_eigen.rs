//! Eigenvalues and eigenvectors of a symmetric 3×3 matrix.

use glam::DVec3;

/// The six independent entries of a symmetric 3×3 matrix.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Symmetric3 {
    /// Diagonal: xx, yy, zz.
    pub(crate) diagonal: DVec3,
    /// Off the diagonal: yz, xz, xy (the entry opposite to each axis).
    pub(crate) off_diagonal: DVec3,
}

impl Symmetric3 {
    /// Adds `weight · v vᵀ`.
    #[inline]
    pub(crate) fn add_outer(&mut self, weight: f64, v: DVec3) {
        let scaled = weight * v;
        self.diagonal += scaled * v;
        self.off_diagonal += DVec3::new(scaled.y * v.z, scaled.x * v.z, scaled.x * v.y);
    }
}

/// Eigenvalues in descending order with their orthonormal eigenvectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Eigen3 {
    pub(crate) values: [f64; 3],
    pub(crate) vectors: [DVec3; 3],
}

/// Solves the symmetric eigenproblem by cyclic Jacobi rotations.
///
/// Deterministic: the same matrix always gives the same bits, and equal eigenvalues keep the order of the
/// axes. The signs of the vectors are whatever the rotations leave; a zero matrix gives the axes.
pub(crate) fn symmetric_eigen(matrix: &Symmetric3) -> Eigen3 {
    const MAX_SWEEPS: usize = 16;
    let mut d = matrix.diagonal.to_array();
    let mut off = matrix.off_diagonal.to_array();
    let mut vectors = [DVec3::X, DVec3::Y, DVec3::Z];
    let size = d.iter().chain(&off).fold(0.0, |size: f64, x| size.max(x.abs()));
    for _ in 0..MAX_SWEEPS {
        if off.iter().all(|x| x.abs() <= size * 1e-17) {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotate(&mut d, &mut off, &mut vectors, p, q);
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| d[j].total_cmp(&d[i]));
    Eigen3 { values: order.map(|i| d[i]), vectors: order.map(|i| vectors[i]) }
}

/// One Jacobi rotation in the plane of axes `p < q`: makes the entry (p, q) zero.
#[inline]
fn rotate(d: &mut [f64; 3], off: &mut [f64; 3], vectors: &mut [DVec3; 3], p: usize, q: usize) {
    let k = 3 - p - q;
    let a_pq = off[k];
    if a_pq == 0.0 {
        return;
    }
    let theta = (d[q] - d[p]) / (2.0 * a_pq);
    // The smaller root, for a rotation of at most 45 degrees; zero when theta² overflows, as it should be.
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    d[p] -= t * a_pq;
    d[q] += t * a_pq;
    off[k] = 0.0;
    // off[q] is the entry (p, k), off[p] is the entry (q, k).
    let (a_pk, a_qk) = (off[q], off[p]);
    off[q] = c * a_pk - s * a_qk;
    off[p] = s * a_pk + c * a_qk;
    let (v_p, v_q) = (vectors[p], vectors[q]);
    vectors[p] = c * v_p - s * v_q;
    vectors[q] = s * v_p + c * v_q;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn matrix(rows: &[(f64, DVec3)]) -> Symmetric3 {
        let mut m = Symmetric3::default();
        rows.iter().for_each(|&(weight, v)| m.add_outer(weight, v));
        m
    }

    fn apply(m: &Symmetric3, v: DVec3) -> DVec3 {
        let (d, o) = (m.diagonal, m.off_diagonal);
        DVec3::new(
            d.x * v.x + o.z * v.y + o.y * v.z,
            o.z * v.x + d.y * v.y + o.x * v.z,
            o.y * v.x + o.x * v.y + d.z * v.z,
        )
    }

    #[test]
    fn known_spectrum() {
        // [[2, 1, 0], [1, 2, 0], [0, 0, 5]] has eigenvalues 5, 3, 1.
        let m = Symmetric3 { diagonal: DVec3::new(2., 2., 5.), off_diagonal: DVec3::new(0., 0., 1.) };
        let e = symmetric_eigen(&m);
        for (value, expected) in e.values.iter().zip([5.0, 3.0, 1.0]) {
            assert!((value - expected).abs() < 1e-15);
        }
        assert_eq!(e.vectors[0], DVec3::Z);
        assert!((e.vectors[1].dot(DVec3::new(1., 1., 0.)).abs() - 2f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn zero_and_isotropic_matrices_give_the_axes() {
        for weight in [0.0, 3.0] {
            let m = matrix(&[(weight, DVec3::X), (weight, DVec3::Y), (weight, DVec3::Z)]);
            let e = symmetric_eigen(&m);
            assert_eq!(e.values, [weight; 3]);
            assert_eq!(e.vectors, [DVec3::X, DVec3::Y, DVec3::Z]);
        }
    }

    proptest! {
        #[test]
        fn decomposes_any_matrix(
            entries in prop::array::uniform6(-1.0..1.0f64), exponent in -140..140i32,
        ) {
            let scale = 10f64.powi(exponent);
            let [a, b, c, d, e, f] = entries.map(|x| x * scale);
            let m = Symmetric3 { diagonal: DVec3::new(a, b, c), off_diagonal: DVec3::new(d, e, f) };
            let eigen = symmetric_eigen(&m);
            prop_assert!(eigen.values[0] >= eigen.values[1] && eigen.values[1] >= eigen.values[2]);
            for i in 0..3 {
                let residual = apply(&m, eigen.vectors[i]) - eigen.values[i] * eigen.vectors[i];
                prop_assert!(residual.length() <= 1e-14 * scale, "{residual}");
                for j in 0..3 {
                    let expected = if i == j { 1.0 } else { 0.0 };
                    prop_assert!((eigen.vectors[i].dot(eigen.vectors[j]) - expected).abs() < 1e-14);
                }
            }
        }
    }
}
