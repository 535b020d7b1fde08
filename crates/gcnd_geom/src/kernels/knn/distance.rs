//! The distances of a patch's nodes, a panel of nodes at a time: as many as fill [`VECTORS`] vector registers.
//!
//! This is a Gram matrix product written out. On patches it is as fast as a general one, and it fixes the order of
//! every sum, so that nodes with the same features, of which repeated faces make many, are exact ties.

use pulp::{Arch, Simd, WithSimd};

use crate::kernels::element::Element;
use crate::kernels::simd::{AlignedBuffer, dispatch, mul_add};

/// Vector registers that hold one channel of one panel.
pub(super) const VECTORS: usize = 2;
/// Nodes whose distances to a panel are summed at the same time: VECTORS · ROWS sums hide the latency of one.
const ROWS: usize = 4;

/// The features of one patch, relative to its first node, as panels (n_panels, C, width).
pub(super) struct Panels {
    n_nodes: usize,
    n_channels: usize,
    width: usize,
    values: AlignedBuffer,
    /// The squared norm of every node, infinite where a panel is not full.
    norms: AlignedBuffer,
}

impl Panels {
    pub(super) fn new(arch: Arch, n_nodes: usize, n_channels: usize) -> Self {
        let width = dispatch(arch, PanelWidth);
        let n_padded = n_nodes.next_multiple_of(width);
        let values = AlignedBuffer::zeros(n_padded * n_channels);
        Self { n_nodes, n_channels, width, values, norms: AlignedBuffer::zeros(n_padded) }
    }

    /// Nodes per panel.
    pub(super) fn width(&self) -> usize {
        self.width
    }

    /// Fills the panels with the features (N, C) of one patch.
    pub(super) fn pack<T: Element>(&mut self, arch: Arch, features: &[T]) {
        let (n_channels, width) = (self.n_channels, self.width);
        let panels = self.values.floats_mut().chunks_exact_mut(n_channels * width);
        for (panel, rows) in panels.zip(features.chunks(n_channels * width)) {
            for (block, rows) in rows.chunks(n_channels * ROWS).enumerate() {
                transpose(rows, n_channels, block * ROWS, width, panel);
            }
        }
        dispatch(arch, Center { origin: &features[..n_channels], panels: self });
    }
}

struct PanelWidth;

impl WithSimd for PanelWidth {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> usize {
        VECTORS * S::F32_LANES
    }
}

/// Writes up to [`ROWS`] nodes to neighbouring lanes of a panel.
///
/// Compiled for the baseline on purpose: wider vectors turn the loop over channels into slow scattered writes.
#[inline(never)]
fn transpose<T: Element>(rows: &[T], n_channels: usize, lane: usize, width: usize, panel: &mut [f32]) {
    if rows.len() == ROWS * n_channels {
        let (first, rest) = rows.split_at(n_channels);
        let (second, rest) = rest.split_at(n_channels);
        let (third, fourth) = rest.split_at(n_channels);
        let rows = first.iter().zip(second).zip(third.iter().zip(fourth));
        for (((a, b), (c, d)), panel) in rows.zip(panel.chunks_exact_mut(width)) {
            let lanes = &mut panel[lane..lane + ROWS];
            lanes.copy_from_slice(&[a.to_f32(), b.to_f32(), c.to_f32(), d.to_f32()]);
        }
    } else {
        for (row, values) in rows.chunks_exact(n_channels).enumerate() {
            for (value, panel) in values.iter().zip(panel.chunks_exact_mut(width)) {
                panel[lane + row] = value.to_f32();
            }
        }
    }
}

/// Moves the origin of the features to the patch's first node and takes the squared norms.
struct Center<'a, T> {
    origin: &'a [T],
    panels: &'a mut Panels,
}

impl<T: Element> WithSimd for Center<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Panels { n_nodes, n_channels, width, values, norms } = self.panels;
        let panels = values.floats_mut().chunks_exact_mut(*n_channels * *width);
        for (panel, norms) in panels.zip(norms.floats_mut().chunks_exact_mut(*width)) {
            // The products of features are summed in the same order, channel by channel: nodes with the same
            // features are then at the distance 0 exactly.
            let mut sums = [simd.splat_f32s(0.0); VECTORS];
            let channels = S::as_mut_simd_f32s(panel).0.chunks_exact_mut(VECTORS);
            for (channel, origin) in channels.zip(self.origin) {
                let origin = origin.to_f32();
                // One broken node must not spoil the others.
                let origin = simd.splat_f32s(if origin.is_finite() { origin } else { 0.0 });
                for vector in 0..VECTORS {
                    let value = simd.sub_f32s(channel[vector], origin);
                    channel[vector] = value;
                    sums[vector] = mul_add(simd, value, value, sums[vector]);
                }
            }
            S::as_mut_simd_f32s(norms).0.copy_from_slice(&sums);
        }
        norms.floats_mut()[*n_nodes..].fill(f32::INFINITY);
    }
}

/// What the nodes j of a patch are ranked by as neighbours of the nodes i of one panel:
/// `key[j,i] = |f_j|² − 2 f_i·f_j`, which is d²(i,j) up to a term of i alone; (N, width).
pub(super) struct RankKeys {
    pub(super) n_nodes: usize,
    values: AlignedBuffer,
}

impl RankKeys {
    pub(super) fn new(panels: &Panels) -> Self {
        let n_padded = panels.n_nodes.next_multiple_of(panels.width);
        Self { n_nodes: panels.n_nodes, values: AlignedBuffer::zeros(n_padded * panels.width) }
    }

    /// Computes the keys of one panel; a node's own key, a NaN and an overflow become infinite.
    pub(super) fn fill(&mut self, arch: Arch, panels: &Panels, panel: usize) {
        dispatch(arch, FillKeys { panels, panel, keys: self.values.floats_mut() });
        let first_node = panel * panels.width;
        for lane in 0..panels.width {
            self.values.floats_mut()[(first_node + lane) * panels.width + lane] = f32::INFINITY;
        }
    }

    /// The keys.
    #[inline(always)]
    pub(super) fn values(&self) -> &[f32] {
        self.values.floats()
    }
}

struct FillKeys<'a> {
    panels: &'a Panels,
    panel: usize,
    keys: &'a mut [f32],
}

impl WithSimd for FillKeys<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let width = VECTORS * S::F32_LANES;
        let size = self.panels.n_channels * width;
        let values = self.panels.values.floats();
        let own = S::as_simd_f32s(&values[self.panel * size..][..size]).0;
        let keys = S::as_mut_simd_f32s(self.keys).0.chunks_exact_mut(ROWS * VECTORS);
        let norms = self.panels.norms.floats().chunks_exact(ROWS);
        for (block, (keys, norms)) in keys.zip(norms).enumerate() {
            let first_node = block * ROWS;
            let other = &values[first_node / width * size..][..size];
            keys_of_rows(simd, own, other, first_node % width, norms, keys);
        }
    }
}

/// The keys of [`ROWS`] nodes, from lane `lane` of the panel `other` on, as neighbours of the panel `own`.
#[inline(always)]
fn keys_of_rows<S: Simd>(
    simd: S,
    own: &[S::f32s],
    other: &[f32],
    lane: usize,
    norms: &[f32],
    keys: &mut [S::f32s],
) {
    let mut sums = [[simd.splat_f32s(0.0); VECTORS]; ROWS];
    let other = other.chunks_exact(VECTORS * S::F32_LANES);
    for (own, other) in own.chunks_exact(VECTORS).zip(other) {
        let other = &other[lane..lane + ROWS];
        for row in 0..ROWS {
            let feature = simd.splat_f32s(other[row]);
            for vector in 0..VECTORS {
                sums[row][vector] = mul_add(simd, feature, own[vector], sums[row][vector]);
            }
        }
    }
    let infinity = simd.splat_f32s(f32::INFINITY);
    for row in 0..ROWS {
        let norm = simd.splat_f32s(norms[row]);
        for vector in 0..VECTORS {
            let key = mul_add(simd, simd.splat_f32s(-2.0), sums[row][vector], norm);
            let finite = simd.less_than_f32s(simd.abs_f32s(key), infinity);
            keys[row * VECTORS + vector] = simd.select_f32s(finite, key, infinity);
        }
    }
}
