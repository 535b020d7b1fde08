//! Mean and maximum over the nodes of every patch, and the backward pass.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::element::Element;
use super::shape::GatherShape;
use crate::error::{GeomError, Result, check_len};

/// Takes the mean and the maximum over the nodes of each patch, channel by channel, and records which node won.
///
/// `out[p,c] = mean_i values[p,i,c]`, `out[p,C+c] = max_i values[p,i,c]`, `argmax[p,c]` the first i that attains it.
///
/// - `values`: (P, N, C), row-major.
/// - `shape`: P, N, C; K is not used, but must be at least 1.
/// - `out`: (P, 2 C), overwritten.
/// - `argmax`: (P, C), node ids, overwritten; what [`pool_nodes_backward`] needs.
///
/// Sums are taken in `f32` in ascending i and rounded once at the end. The maximum passes over NaN; of
/// nothing but NaN it is −∞.
///
/// # Errors
///
/// [`LengthMismatch`](crate::GeomError::LengthMismatch) for an array of the wrong length,
/// [`InvalidParameter`](crate::GeomError::InvalidParameter) for a size of 0 or more than 65,536 nodes; nothing is
/// written then.
///
/// Paper: Sec. 5.1, average and max pooling.
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, pool_nodes};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 2, n_neighbors: 1 };
/// let (mut out, mut argmax) = ([0.0f32; 4], [0; 2]);
/// pool_nodes(&[1.0, 8.0, 3.0, 4.0], shape, &mut out, &mut argmax)?;
/// assert_eq!(out, [2.0, 6.0, 3.0, 8.0]);
/// assert_eq!(argmax, [1, 0]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn pool_nodes<T: Element>(
    values: &[T],
    shape: GatherShape,
    out: &mut [T],
    argmax: &mut [u16],
) -> Result<()> {
    shape.check()?;
    shape.check_values("values", values.len())?;
    check_pooled(shape, out.len(), argmax.len())?;
    let arch = Arch::new();
    values
        .par_chunks_exact(shape.patch_values())
        .zip(out.par_chunks_exact_mut(2 * shape.n_channels))
        .zip(argmax.par_chunks_exact_mut(shape.n_channels))
        .for_each_init(
            || Scratch::new(shape.n_channels),
            |scratch, ((values, out), argmax)| arch.dispatch(Pool { values, scratch, out, argmax }),
        );
    Ok(())
}

/// Spreads the gradients of mean and maximum over the nodes: the backward pass of [`pool_nodes`].
///
/// `grad_in[p,i,c] = grad_out[p,c] / N + (argmax[p,c] = i ? grad_out[p,C+c] : 0)`
///
/// - `grad_out`: (P, 2 C).
/// - `argmax`: (P, C), as [`pool_nodes`] wrote it.
/// - `shape`: as there.
/// - `grad_in`: (P, N, C), overwritten.
///
/// # Errors
///
/// As [`pool_nodes`]; [`InvalidParameter`](crate::GeomError::InvalidParameter) for an entry of `argmax` outside its
/// patch.
///
/// Paper: Sec. 5.1.
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, pool_nodes_backward};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 1, n_neighbors: 1 };
/// let mut grad_in = [0.0f32; 2];
/// pool_nodes_backward(&[4.0, 1.0], &[1], shape, &mut grad_in)?;
/// assert_eq!(grad_in, [2.0, 3.0]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn pool_nodes_backward<T: Element>(
    grad_out: &[T],
    argmax: &[u16],
    shape: GatherShape,
    grad_in: &mut [T],
) -> Result<()> {
    shape.check()?;
    check_pooled(shape, grad_out.len(), argmax.len())?;
    shape.check_values("grad_in", grad_in.len())?;
    if let Some(node_id) = argmax.iter().find(|&&node_id| usize::from(node_id) >= shape.n_nodes) {
        let value = node_id.to_string();
        return Err(GeomError::InvalidParameter { name: "argmax", value, allowed: "ids below n_nodes" });
    }
    let arch = Arch::new();
    grad_in
        .par_chunks_exact_mut(shape.patch_values())
        .zip(grad_out.par_chunks_exact(2 * shape.n_channels))
        .zip(argmax.par_chunks_exact(shape.n_channels))
        .for_each(|((grad_in, grad_out), argmax)| {
            arch.dispatch(Spread { grad_out, argmax, n_nodes: shape.n_nodes, grad_in });
        });
    Ok(())
}

fn check_pooled(shape: GatherShape, pooled: usize, argmax: usize) -> Result<()> {
    let per_patch = shape.n_patches * shape.n_channels;
    check_len("pooled", 2 * per_patch, pooled)?;
    check_len("argmax", per_patch, argmax)
}

/// Running sums, maxima and winners of one patch.
struct Scratch {
    sum: Vec<f32>,
    best: Vec<f32>,
    winner: Vec<u32>,
}

impl Scratch {
    fn new(n_channels: usize) -> Self {
        Self { sum: vec![0.0; n_channels], best: vec![0.0; n_channels], winner: vec![0; n_channels] }
    }
}

/// [`pool_nodes`] on one patch.
struct Pool<'a, T> {
    values: &'a [T],
    scratch: &'a mut Scratch,
    out: &'a mut [T],
    argmax: &'a mut [u16],
}

impl<T: Element> WithSimd for Pool<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { values, scratch: Scratch { sum, best, winner }, out, argmax } = self;
        let n_channels = argmax.len();
        sum.fill(0.0);
        best.fill(f32::NEG_INFINITY);
        winner.fill(0);
        for (node, row) in (0u32..).zip(values.chunks_exact(n_channels)) {
            let running = sum.iter_mut().zip(best.iter_mut()).zip(winner.iter_mut());
            for (((sum, best), winner), value) in running.zip(row) {
                let value = value.to_f32();
                *sum += value;
                *winner = if value > *best { node } else { *winner };
                *best = if value > *best { value } else { *best };
            }
        }
        let count = (values.len() / n_channels) as f32;
        let (mean, max) = out.split_at_mut(n_channels);
        for channel in 0..n_channels {
            mean[channel] = T::from_f32(sum[channel] / count);
            max[channel] = T::from_f32(best[channel]);
            argmax[channel] = winner[channel] as u16;
        }
    }
}

/// [`pool_nodes_backward`] on one patch.
struct Spread<'a, T> {
    grad_out: &'a [T],
    argmax: &'a [u16],
    n_nodes: usize,
    grad_in: &'a mut [T],
}

impl<T: Element> WithSimd for Spread<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { grad_out, argmax, n_nodes, grad_in } = self;
        let n_channels = argmax.len();
        let (of_mean, of_max) = grad_out.split_at(n_channels);
        let share = |channel: usize| of_mean[channel].to_f32() / n_nodes as f32;
        let (first, others) = grad_in.split_at_mut(n_channels);
        for (channel, grad) in first.iter_mut().enumerate() {
            *grad = T::from_f32(share(channel));
        }
        for row in others.chunks_exact_mut(n_channels) {
            row.copy_from_slice(first);
        }
        for (channel, &winner) in argmax.iter().enumerate() {
            let grad = share(channel) + of_max[channel].to_f32();
            grad_in[usize::from(winner) * n_channels + channel] = T::from_f32(grad);
        }
    }
}
