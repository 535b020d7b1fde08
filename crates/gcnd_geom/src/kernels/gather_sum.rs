//! The sum over each node's neighbours: what the batch statistics over edges need of EdgeConv.

use rayon::prelude::*;

use super::element::Element;
use super::shape::GatherShape;
use crate::error::Result;

/// Sums the neighbours' values, channel by channel.
///
/// `out[p,i,c] = sum_k values[p, neighbors[p,i,k], c]`
///
/// - `values`: (P, N, C), row-major.
/// - `neighbors`: (P, N, K), node ids inside the patch, 0 to N − 1.
/// - `shape`: P, N, C, K.
/// - `out`: (P, N, C), overwritten.
///
/// Sums are taken in `f32` in ascending k.
///
/// # Errors
///
/// As [`gather_max`](super::gather_max).
///
/// Paper: Sec. 5.1, Eq. 4 (batch normalisation over the edges). Choice: docs/choices.md#edgeconv-split.
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, gather_sum};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 1, n_neighbors: 2 };
/// let mut out = [0.0f32; 2];
/// gather_sum(&[1.0, 3.0], &[0, 1, 1, 1], shape, &mut out)?;
/// assert_eq!(out, [4.0, 6.0]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn gather_sum<T: Element>(
    values: &[T],
    neighbors: &[i32],
    shape: GatherShape,
    out: &mut [T],
) -> Result<()> {
    for_each_patch(values, neighbors, shape, out, |values, neighbors, sums| {
        let c = shape.n_channels;
        for (sum, ids) in sums.chunks_exact_mut(c).zip(neighbors.chunks_exact(shape.n_neighbors)) {
            for &id in ids {
                add_row(sum, &values[id as usize * c..][..c]);
            }
        }
    })
}

/// Sends each gradient to every neighbour that was summed: the backward pass of [`gather_sum`].
///
/// `grad_in[p,j,c] = sum over (i, k) with neighbors[p,i,k] = j of grad_out[p,i,c]`
///
/// Arguments and errors are those of [`gather_sum`], with gradients in place of values.
///
/// Paper: Sec. 5.1, Eq. 4.
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, gather_sum_backward};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 1, n_neighbors: 2 };
/// let mut grad = [0.0f32; 2];
/// gather_sum_backward(&[1.0, 10.0], &[0, 1, 1, 1], shape, &mut grad)?;
/// assert_eq!(grad, [1.0, 21.0]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn gather_sum_backward<T: Element>(
    grad_out: &[T],
    neighbors: &[i32],
    shape: GatherShape,
    grad_in: &mut [T],
) -> Result<()> {
    for_each_patch(grad_out, neighbors, shape, grad_in, |grads, neighbors, sums| {
        let c = shape.n_channels;
        for (grad, ids) in grads.chunks_exact(c).zip(neighbors.chunks_exact(shape.n_neighbors)) {
            for &id in ids {
                add_row(&mut sums[id as usize * c..][..c], grad);
            }
        }
    })
}

/// Checks the arrays, then lets `accumulate` fill zeroed sums (N·C) from each patch's values and neighbours.
fn for_each_patch<T: Element>(
    values: &[T],
    neighbors: &[i32],
    shape: GatherShape,
    out: &mut [T],
    accumulate: impl Fn(&[T], &[i32], &mut [f32]) + Sync,
) -> Result<()> {
    shape.check()?;
    shape.check_values("values", values.len())?;
    shape.check_values("out", out.len())?;
    shape.check_neighbors(neighbors)?;
    values
        .par_chunks_exact(shape.patch_values())
        .zip(neighbors.par_chunks_exact(shape.patch_neighbors()))
        .zip(out.par_chunks_exact_mut(shape.patch_values()))
        .for_each_init(
            || vec![0.0f32; shape.patch_values()],
            |sums, ((values, neighbors), out)| {
                sums.fill(0.0);
                accumulate(values, neighbors, sums);
                for (out, &sum) in out.iter_mut().zip(sums.iter()) {
                    *out = T::from_f32(sum);
                }
            },
        );
    Ok(())
}

fn add_row<T: Element>(sum: &mut [f32], row: &[T]) {
    for (sum, value) in sum.iter_mut().zip(row) {
        *sum += value.to_f32();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::GeomError;

    const SHAPE: GatherShape = GatherShape { n_patches: 2, n_nodes: 3, n_channels: 2, n_neighbors: 2 };

    #[test]
    fn backward_is_the_transpose_of_forward() {
        let neighbors = [0, 1, 2, 2, 1, 0, 2, 1, 0, 0, 1, 2];
        let basis = |i: usize| {
            let mut v = [0.0f32; 12];
            v[i] = 1.0;
            v
        };
        for i in 0..12 {
            let (mut forward, mut backward) = ([0.0f32; 12], [0.0f32; 12]);
            gather_sum(&basis(i), &neighbors, SHAPE, &mut forward).expect("valid");
            for j in 0..12 {
                gather_sum_backward(&basis(j), &neighbors, SHAPE, &mut backward).expect("valid");
                assert_eq!(forward[j], backward[i], "entry ({j}, {i})");
            }
        }
    }

    #[test]
    fn neighbours_outside_the_patch_are_refused() {
        let mut out = [0.0f32; 12];
        let result = gather_sum(&[0.0f32; 12], &[3; 12], SHAPE, &mut out);
        assert!(matches!(result, Err(GeomError::InvalidParameter { name: "neighbors", .. })));
    }
}
