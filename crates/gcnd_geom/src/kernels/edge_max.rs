//! One EdgeConv stage at inference: gather, max, add and activation in one pass.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::gather_max::max_of_neighbors;
use super::shape::GatherShape;
use crate::error::{GeomError, Result};

/// Evaluates an EdgeConv stage whose linear layer (with BatchNorm folded into it) has already run per node.
///
/// `out[p,i,c] = leaky(a[p,i,c] + max_k b[p, neighbors[p,i,k], c])`, `leaky(x) = x if x > 0 else slope · x`
///
/// With `Linear(F_i, F_j − F_i) = W₁ F_i + W₂ (F_j − F_i) + t`, `a = (W₁ − W₂) F + t` and `b = W₂ F`.
///
/// - `a`: (P, N, C), the part of the node itself.
/// - `b`: (P, N, C), the part of the neighbour.
/// - `neighbors`: (P, N, K), node ids inside the patch, 0 to N − 1.
/// - `shape`: P, N, C, K.
/// - `slope`: of LeakyReLU for negative values; 0 is ReLU, 1 the identity.
/// - `out`: (P, N, C), overwritten.
///
/// # Errors
///
/// [`LengthMismatch`](GeomError::LengthMismatch) for an array of the wrong length,
/// [`InvalidParameter`](GeomError::InvalidParameter) for a size of 0, more than 65,536 nodes, a neighbour outside
/// its patch or a slope outside 0 to 1 (the activation must not decrease, or it could not be taken after the
/// maximum); nothing is written then.
///
/// Paper: Sec. 5.1, Eq. 4.
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, edge_max_leaky};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 1, n_neighbors: 2 };
/// let mut out = [0.0; 2];
/// edge_max_leaky(&[1.0, -6.0], &[2.0, 4.0], &[0, 1, 0, 0], shape, 0.25, &mut out)?;
/// assert_eq!(out, [5.0, -1.0]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn edge_max_leaky(
    a: &[f32],
    b: &[f32],
    neighbors: &[i32],
    shape: GatherShape,
    slope: f32,
    out: &mut [f32],
) -> Result<()> {
    shape.check()?;
    shape.check_values("a", a.len())?;
    shape.check_values("b", b.len())?;
    shape.check_values("out", out.len())?;
    shape.check_neighbors(neighbors)?;
    if !(0.0..=1.0).contains(&slope) {
        return Err(GeomError::InvalidParameter {
            name: "slope",
            value: slope.to_string(),
            allowed: "0 to 1",
        });
    }
    let arch = Arch::new();
    a.par_chunks_exact(shape.patch_values())
        .zip(b.par_chunks_exact(shape.patch_values()))
        .zip(neighbors.par_chunks_exact(shape.patch_neighbors()))
        .zip(out.par_chunks_exact_mut(shape.patch_values()))
        .for_each(|(((a, b), neighbors), out)| {
            arch.dispatch(EdgeMax { a, b, neighbors, shape, slope, out });
        });
    Ok(())
}

/// [`edge_max_leaky`] on one patch.
struct EdgeMax<'a> {
    a: &'a [f32],
    b: &'a [f32],
    neighbors: &'a [i32],
    shape: GatherShape,
    slope: f32,
    out: &'a mut [f32],
}

impl WithSimd for EdgeMax<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { a, b, neighbors, shape: GatherShape { n_channels, n_neighbors, .. }, slope, out } = self;
        let rows = a.chunks_exact(n_channels).zip(out.chunks_exact_mut(n_channels));
        for (neighbors, (a, out)) in neighbors.chunks_exact(n_neighbors).zip(rows) {
            max_of_neighbors(b, neighbors, out);
            for (out, a) in out.iter_mut().zip(a) {
                let sum = a + *out;
                *out = if sum > 0.0 { sum } else { slope * sum };
            }
        }
    }
}
