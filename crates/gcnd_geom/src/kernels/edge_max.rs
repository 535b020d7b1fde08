//! One EdgeConv stage at inference: gather, max, scale, add and activation in one pass.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::element::Element;
use super::gather_max::max_of_neighbors;
use super::shape::{GatherShape, check_slope};
use crate::error::{Result, check_len};

/// Evaluates an EdgeConv stage whose linear layer has already run per node.
///
/// `out[p,i,c] = leaky(a[p,i,c] + scale[c] · max_k b[p, neighbors[p,i,k], c])`, `leaky(x) = x if x > 0 else slope · x`
///
/// With `Linear(F_i, F_j − F_i) = W₁ F_i + W₂ (F_j − F_i)` and BatchNorm's evaluation map `y = s x + t` after the
/// maximum, `a = s ∘ (W₁ − W₂) F + t`, `b = W₂ F` and `scale = s`.
///
/// - `parts`: (P, N, 2 C), for each node its `a` and then its `b`, as one linear layer writes them.
/// - `scale`: (C).
/// - `neighbors`: (P, N, K), node ids inside the patch, 0 to N − 1.
/// - `shape`: P, N, C, K.
/// - `slope`: of LeakyReLU for negative values; 0 is ReLU, 1 the identity.
/// - `out`: (P, N, C), overwritten.
///
/// Computes in `f32` and rounds once at the end.
///
/// # Errors
///
/// [`LengthMismatch`](crate::GeomError::LengthMismatch) for an array of the wrong length,
/// [`InvalidParameter`](crate::GeomError::InvalidParameter) for a size of 0, more than 65,536 nodes, a neighbour
/// outside its patch or a slope outside 0 to 1; nothing is written then.
///
/// Paper: Sec. 5.1, Eq. 4.
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, edge_max_leaky};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 1, n_neighbors: 2 };
/// let mut out = [0.0f32; 2];
/// let a_b_of_each_node = [1.0, 2.0, -6.0, 4.0];
/// edge_max_leaky(&a_b_of_each_node, &[0.5], &[0, 1, 0, 0], shape, 0.25, &mut out)?;
/// assert_eq!(out, [3.0, -1.25]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn edge_max_leaky<T: Element>(
    parts: &[T],
    scale: &[f32],
    neighbors: &[i32],
    shape: GatherShape,
    slope: f32,
    out: &mut [T],
) -> Result<()> {
    shape.check()?;
    check_len("parts", 2 * shape.n_values(), parts.len())?;
    check_len("scale", shape.n_channels, scale.len())?;
    shape.check_values("out", out.len())?;
    shape.check_neighbors(neighbors)?;
    check_slope(slope)?;
    let arch = Arch::new();
    parts
        .par_chunks_exact(2 * shape.patch_values())
        .zip(neighbors.par_chunks_exact(shape.patch_neighbors()))
        .zip(out.par_chunks_exact_mut(shape.patch_values()))
        .for_each(|((parts, neighbors), out)| {
            arch.dispatch(EdgeMax { parts, scale, neighbors, shape, slope, out });
        });
    Ok(())
}

/// [`edge_max_leaky`] on one patch.
struct EdgeMax<'a, T> {
    parts: &'a [T],
    scale: &'a [f32],
    neighbors: &'a [i32],
    shape: GatherShape,
    slope: f32,
    out: &'a mut [T],
}

impl<T: Element> WithSimd for EdgeMax<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { parts, scale, neighbors, shape: GatherShape { n_channels, n_neighbors, .. }, slope, out } =
            self;
        let stride = 2 * n_channels;
        let rows = parts.chunks_exact(stride).zip(out.chunks_exact_mut(n_channels));
        for (neighbors, (parts_row, out)) in neighbors.chunks_exact(n_neighbors).zip(rows) {
            max_of_neighbors(&parts[n_channels..], stride, neighbors, out);
            for ((out, a), scale) in out.iter_mut().zip(&parts_row[..n_channels]).zip(scale) {
                let sum = a.to_f32() + scale * out.to_f32();
                *out = T::from_f32(if sum > 0.0 { sum } else { slope * sum });
            }
        }
    }
}
