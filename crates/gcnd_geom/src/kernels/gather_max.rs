//! Gather-max over the neighbours of every node, and its backward scatter.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::element::Element;
use super::shape::GatherShape;
use crate::error::Result;

/// Neighbours reduced in one pass over the channels: their addresses and ids stay in registers.
const GROUP: usize = 8;
/// Channels per block: a constant, so that the loop over it becomes a few whole registers without a tail.
const WIDE: usize = 64;
/// Channels per block in what [`WIDE`] leaves over.
const NARROW: usize = 16;

/// Takes the maximum over each node's neighbours, channel by channel, and records which node won.
///
/// `out[p,i,c] = max_k values[p, neighbors[p,i,k], c]`,
/// `argmax[p,i,c] = neighbors[p,i,k*]` with k* the first k that attains the maximum.
///
/// - `values`: (P, N, C), row-major.
/// - `neighbors`: (P, N, K), node ids inside the patch, 0 to N − 1.
/// - `shape`: P, N, C, K.
/// - `out`: (P, N, C), overwritten.
/// - `argmax`: (P, N, C), node ids, overwritten; what [`gather_max_backward`] needs.
///
/// −0 and +0 count as equal. A NaN is passed on where it is the first neighbour's and may be passed over elsewhere.
///
/// # Errors
///
/// [`LengthMismatch`](crate::GeomError::LengthMismatch) for an array of the wrong length,
/// [`InvalidParameter`](crate::GeomError::InvalidParameter) for a size of 0, more than 65,536 nodes or a
/// neighbour outside its patch; nothing is written then.
///
/// Paper: Sec. 5.1, Eq. 4 (the maximum over the edges of a node).
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, gather_max};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 2, n_neighbors: 2 };
/// let values: [f32; 4] = [1.0, 8.0, 3.0, 4.0];
/// let (mut out, mut argmax) = ([0.0; 4], [0; 4]);
/// gather_max(&values, &[0, 1, 1, 1], shape, &mut out, &mut argmax)?;
/// assert_eq!(out, [3.0, 8.0, 3.0, 4.0]);
/// assert_eq!(argmax, [1, 0, 1, 1]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn gather_max<T: Element>(
    values: &[T],
    neighbors: &[i32],
    shape: GatherShape,
    out: &mut [T],
    argmax: &mut [u16],
) -> Result<()> {
    shape.check()?;
    shape.check_values("values", values.len())?;
    shape.check_values("out", out.len())?;
    shape.check_values("argmax", argmax.len())?;
    shape.check_neighbors(neighbors)?;
    let arch = Arch::new();
    values
        .par_chunks_exact(shape.patch_values())
        .zip(neighbors.par_chunks_exact(shape.patch_neighbors()))
        .zip(out.par_chunks_exact_mut(shape.patch_values()))
        .zip(argmax.par_chunks_exact_mut(shape.patch_values()))
        .for_each(|(((values, neighbors), out), argmax)| {
            arch.dispatch(MaxAndArgmax { values, neighbors, shape, out, argmax });
        });
    Ok(())
}

/// Takes the maximum over each node's neighbours, channel by channel, without recording who won.
///
/// `out[p,i,c] = max_k values[p, neighbors[p,i,k], c]`
///
/// Arguments, the treatment of NaN and errors are those of [`gather_max`], without `argmax`.
///
/// Paper: Sec. 5.1, Eq. 4 (the maximum over the edges of a node).
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, gather_max_values};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 2, n_neighbors: 2 };
/// let mut out = [0.0; 4];
/// gather_max_values(&[1.0, 8.0, 3.0, 4.0], &[0, 1, 1, 1], shape, &mut out)?;
/// assert_eq!(out, [3.0, 8.0, 3.0, 4.0]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn gather_max_values<T: Element>(
    values: &[T],
    neighbors: &[i32],
    shape: GatherShape,
    out: &mut [T],
) -> Result<()> {
    shape.check()?;
    shape.check_values("values", values.len())?;
    shape.check_values("out", out.len())?;
    shape.check_neighbors(neighbors)?;
    let arch = Arch::new();
    values
        .par_chunks_exact(shape.patch_values())
        .zip(neighbors.par_chunks_exact(shape.patch_neighbors()))
        .zip(out.par_chunks_exact_mut(shape.patch_values()))
        .for_each(|((values, neighbors), out)| arch.dispatch(MaxOnly { values, neighbors, shape, out }));
    Ok(())
}

/// Sends each gradient back to the node that won the maximum: the backward pass of [`gather_max`].
///
/// `grad_in[p,j,c] = sum over i with argmax[p,i,c] = j of grad_out[p,i,c]`
///
/// - `grad_out`: (P, N, C), the gradient with respect to the output of [`gather_max`].
/// - `argmax`: (P, N, C), as [`gather_max`] wrote it.
/// - `shape`: P, N, C; K is not used, but must be at least 1.
/// - `grad_in`: (P, N, C), the gradient with respect to `values`, overwritten.
///
/// Sums are taken in `f32` in ascending i, and rounded once at the end for bfloat16.
///
/// # Errors
///
/// As [`gather_max`]; [`InvalidParameter`](crate::GeomError::InvalidParameter) for an entry of `argmax` outside its
/// patch.
///
/// Paper: Sec. 5.1, Eq. 4.
///
/// ```
/// use gcnd_geom::kernels::{GatherShape, gather_max_backward};
/// let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 2, n_neighbors: 2 };
/// let mut grad_in = [0.0; 4];
/// gather_max_backward(&[1.0, 2.0, 4.0, 8.0], &[1, 0, 1, 1], shape, &mut grad_in)?;
/// assert_eq!(grad_in, [0.0, 2.0, 5.0, 8.0]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn gather_max_backward<T: Element>(
    grad_out: &[T],
    argmax: &[u16],
    shape: GatherShape,
    grad_in: &mut [T],
) -> Result<()> {
    shape.check()?;
    shape.check_values("grad_out", grad_out.len())?;
    shape.check_values("grad_in", grad_in.len())?;
    shape.check_argmax(argmax)?;
    let arch = Arch::new();
    grad_out
        .par_chunks_exact(shape.patch_values())
        .zip(argmax.par_chunks_exact(shape.patch_values()))
        .zip(grad_in.par_chunks_exact_mut(shape.patch_values()))
        .for_each_init(
            || vec![0.0; shape.patch_values()],
            |sums, ((grad_out, argmax), grad_in)| {
                let n_channels = shape.n_channels;
                arch.dispatch(ScatterAdd { grad_out, argmax, n_channels, sums, grad_in });
            },
        );
    Ok(())
}

/// [`gather_max_backward`] on one patch.
struct ScatterAdd<'a, T> {
    grad_out: &'a [T],
    argmax: &'a [u16],
    n_channels: usize,
    sums: &'a mut [f32],
    grad_in: &'a mut [T],
}

impl<T: Element> WithSimd for ScatterAdd<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { grad_out, argmax, n_channels, sums, grad_in } = self;
        sums.fill(0.0);
        for (grad_row, winner_row) in grad_out.chunks_exact(n_channels).zip(argmax.chunks_exact(n_channels)) {
            for (channel, (grad, &winner)) in grad_row.iter().zip(winner_row).enumerate() {
                sums[usize::from(winner) * n_channels + channel] += grad.to_f32();
            }
        }
        for (grad, &sum) in grad_in.iter_mut().zip(sums.iter()) {
            *grad = T::from_f32(sum);
        }
    }
}

/// [`gather_max`] on one patch.
struct MaxAndArgmax<'a, T> {
    values: &'a [T],
    neighbors: &'a [i32],
    shape: GatherShape,
    out: &'a mut [T],
    argmax: &'a mut [u16],
}

impl<T: Element> WithSimd for MaxAndArgmax<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { values, neighbors, shape: GatherShape { n_channels, n_neighbors, .. }, out, argmax } =
            self;
        let rows = out.chunks_exact_mut(n_channels).zip(argmax.chunks_exact_mut(n_channels));
        for (neighbors, (out, argmax)) in neighbors.chunks_exact(n_neighbors).zip(rows) {
            out.copy_from_slice(row(values, n_channels, n_channels, neighbors[0]));
            argmax.fill(neighbors[0] as u16);
            for group in neighbors.chunks(GROUP) {
                let group = padded(group);
                let rows = rows_of(values, n_channels, n_channels, &group);
                let (wide, narrow) = split(n_channels);
                argmax_blocks::<T, WIDE>(rows, &group, 0..wide, out, argmax);
                argmax_blocks::<T, NARROW>(rows, &group, wide..narrow, out, argmax);
                argmax_blocks::<T, 1>(rows, &group, narrow..n_channels, out, argmax);
            }
        }
    }
}

/// Raises a range of channels of `out` to the maximum of itself and the rows, in blocks of `W`, and names the
/// row in `argmax` wherever one is larger, the first one on ties.
#[inline(always)]
fn argmax_blocks<T: Element, const W: usize>(
    rows: [&[T]; GROUP],
    group: &[i32; GROUP],
    channels: Range<usize>,
    out: &mut [T],
    argmax: &mut [u16],
) {
    for start in channels.step_by(W) {
        let rows = blocks::<T, W>(rows, start);
        let (out, argmax) = (&mut out[start..start + W], &mut argmax[start..start + W]);
        let mut keys = [rows[0][0].key(); W];
        let mut ids = [T::id(0); W];
        for lane in 0..W {
            let (mut best_key, mut best_id) = (out[lane].key(), T::id(argmax[lane]));
            for slot in 0..GROUP {
                let key = rows[slot][lane].key();
                let better = key > best_key;
                best_key = if better { key } else { best_key };
                best_id = if better { T::id(group[slot] as u16) } else { best_id };
            }
            (keys[lane], ids[lane]) = (best_key, best_id);
        }
        for lane in 0..W {
            out[lane] = T::from_key(keys[lane]);
            argmax[lane] = T::node_id(ids[lane]);
        }
    }
}

/// [`gather_max_values`] on one patch.
struct MaxOnly<'a, T> {
    values: &'a [T],
    neighbors: &'a [i32],
    shape: GatherShape,
    out: &'a mut [T],
}

impl<T: Element> WithSimd for MaxOnly<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { values, neighbors, shape: GatherShape { n_channels, n_neighbors, .. }, out } = self;
        for (neighbors, out) in neighbors.chunks_exact(n_neighbors).zip(out.chunks_exact_mut(n_channels)) {
            max_of_neighbors(values, n_channels, neighbors, out);
        }
    }
}

/// Writes the maximum over one node's neighbours to its row `out`; the rows of `values` start every `stride`.
#[inline(always)]
pub(super) fn max_of_neighbors<T: Element>(values: &[T], stride: usize, neighbors: &[i32], out: &mut [T]) {
    let n_channels = out.len();
    out.copy_from_slice(row(values, stride, n_channels, neighbors[0]));
    for group in neighbors.chunks(GROUP) {
        let rows = rows_of(values, stride, n_channels, &padded(group));
        let (wide, narrow) = split(n_channels);
        max_blocks::<T, WIDE>(rows, 0..wide, out);
        max_blocks::<T, NARROW>(rows, wide..narrow, out);
        max_blocks::<T, 1>(rows, narrow..n_channels, out);
    }
}

/// Raises a range of channels of `out` to the maximum of itself and the rows, in blocks of `W`.
#[inline(always)]
fn max_blocks<T: Element, const W: usize>(rows: [&[T]; GROUP], channels: Range<usize>, out: &mut [T]) {
    for start in channels.step_by(W) {
        let rows = blocks::<T, W>(rows, start);
        let out = &mut out[start..start + W];
        let mut keys = [rows[0][0].key(); W];
        for lane in 0..W {
            let mut best = out[lane].key();
            for row in rows {
                let key = row[lane].key();
                best = if key > best { key } else { best };
            }
            keys[lane] = best;
        }
        for lane in 0..W {
            out[lane] = T::from_key(keys[lane]);
        }
    }
}

/// Where the wide blocks of a row end, and where the narrow ones do.
#[inline(always)]
fn split(n_channels: usize) -> (usize, usize) {
    (n_channels - n_channels % WIDE, n_channels - n_channels % NARROW)
}

/// Fills a group up by repeating its last neighbour, which changes neither the maximum nor who wins it.
#[inline(always)]
fn padded(group: &[i32]) -> [i32; GROUP] {
    let mut ids = [group[0]; GROUP];
    for slot in 1..GROUP {
        ids[slot] = group[slot.min(group.len() - 1)];
    }
    ids
}

/// The values of one node.
#[inline(always)]
fn row<T>(values: &[T], stride: usize, n_channels: usize, node_id: i32) -> &[T] {
    &values[node_id as usize * stride..][..n_channels]
}

/// The values of a group of nodes.
#[inline(always)]
fn rows_of<'a, T>(
    values: &'a [T],
    stride: usize,
    n_channels: usize,
    group: &[i32; GROUP],
) -> [&'a [T]; GROUP] {
    // A loop, here and below: `array::map` is not inlined into the vectorised caller, which costs a call per block.
    let mut rows = [row(values, stride, n_channels, group[0]); GROUP];
    for slot in 1..GROUP {
        rows[slot] = row(values, stride, n_channels, group[slot]);
    }
    rows
}

/// `W` channels of a group of nodes.
#[inline(always)]
fn blocks<T, const W: usize>(rows: [&[T]; GROUP], start: usize) -> [&[T; W]; GROUP] {
    let block = |row: usize| &rows[row][start..].as_chunks().0[0];
    let mut blocks = [block(0); GROUP];
    for slot in 1..GROUP {
        blocks[slot] = block(slot);
    }
    blocks
}
