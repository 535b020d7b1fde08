//! The nodes with the k smallest keys, for a whole vector of nodes at a time.

use pulp::{Simd, WithSimd};

use super::distance::{RankKeys, VECTORS};

/// Writes the neighbours (width, k) of the nodes of one panel; rows beyond the patch are not in `out`.
pub(super) struct Select<'a> {
    pub(super) keys: &'a RankKeys,
    /// The panel's first node.
    pub(super) first_node: usize,
    pub(super) k: usize,
    pub(super) out: &'a mut [i32],
}

impl WithSimd for Select<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // The node itself needs no place in the list. Lists of a constant length stay in registers.
        match self.k - 1 {
            0 => write_self(self),
            1..=3 => select::<S, 3>(simd, self),
            4..=7 => select::<S, 7>(simd, self),
            8..=11 => select::<S, 11>(simd, self),
            12..=15 => select::<S, 15>(simd, self),
            16..=19 => select::<S, 19>(simd, self),
            20..=31 => select::<S, 31>(simd, self),
            _ => sort(self, VECTORS * S::F32_LANES),
        }
    }
}

/// k = 1: every node is its own and only neighbour.
#[inline(always)]
fn write_self(panel: Select) {
    for (lane, own) in panel.out.iter_mut().enumerate() {
        *own = (panel.first_node + lane) as i32;
    }
}

/// Keeps, in every lane, the sorted list of the `M` smallest keys so far and the nodes they belong to.
#[inline(always)]
fn select<S: Simd, const M: usize>(simd: S, panel: Select) {
    let keys = &S::as_simd_f32s(panel.keys.values()).0[..panel.keys.n_nodes * VECTORS];
    for (vector, out) in panel.out.chunks_mut(S::F32_LANES * panel.k).enumerate() {
        let first_node = panel.first_node + vector * S::F32_LANES;
        let mut best = [simd.splat_f32s(f32::INFINITY); M];
        let mut ids = [own_ids(simd, first_node); M];
        for (node_id, keys) in keys.chunks_exact(VECTORS).enumerate() {
            let nearer = simd.less_than_f32s(keys[vector], best[M - 1]);
            // Late in a large patch, most nodes are too far away for every lane.
            if simd.first_true_m32s(nearer) == S::F32_LANES {
                continue;
            }
            insert(simd, keys[vector], simd.splat_u32s(node_id as u32), &mut best, &mut ids);
        }
        for (lane, out) in out.chunks_exact_mut(panel.k).enumerate() {
            out[0] = (first_node + lane) as i32;
        }
        for (slot, ids) in ids.iter().enumerate().take(panel.k - 1) {
            let lanes: &[u32] = bytemuck::cast_slice(std::slice::from_ref(ids));
            for (out, &id) in out.chunks_exact_mut(panel.k).zip(lanes) {
                out[slot + 1] = id as i32;
            }
        }
    }
}

/// Inserts a key into sorted lists, behind the keys that equal it, and drops each list's last one.
#[inline(always)]
fn insert<S: Simd, const M: usize>(
    simd: S,
    key: S::f32s,
    id: S::u32s,
    best: &mut [S::f32s; M],
    ids: &mut [S::u32s; M],
) {
    let mut before = simd.less_than_f32s(key, best[M - 1]);
    for slot in (1..M).rev() {
        let before_previous = simd.less_than_f32s(key, best[slot - 1]);
        let inserted = simd.select_u32s(before, id, ids[slot]);
        ids[slot] = simd.select_u32s(before_previous, ids[slot - 1], inserted);
        best[slot] = simd.max_f32s(best[slot - 1], simd.min_f32s(best[slot], key));
        before = before_previous;
    }
    ids[0] = simd.select_u32s(before, id, ids[0]);
    best[0] = simd.min_f32s(best[0], key);
}

/// The ids of a vector of nodes, which stand wherever no neighbour was found.
#[inline(always)]
fn own_ids<S: Simd>(simd: S, first_node: usize) -> S::u32s {
    let mut ids = [simd.splat_u32s(0)];
    let lanes: &mut [u32] = bytemuck::cast_slice_mut(&mut ids);
    for (lane, id) in lanes.iter_mut().enumerate() {
        *id = (first_node + lane) as u32;
    }
    ids[0]
}

/// k > 32: sorts the keys of each node.
#[inline(never)]
fn sort(panel: Select, width: usize) {
    let mut order = Vec::with_capacity(panel.keys.n_nodes);
    for (lane, out) in panel.out.chunks_exact_mut(panel.k).enumerate() {
        let own = (panel.first_node + lane) as i32;
        let keys = panel.keys.values().iter().skip(lane).step_by(width).take(panel.keys.n_nodes);
        order.clear();
        order.extend(
            keys.zip(0i32..).filter(|(key, _)| **key < f32::INFINITY).map(|(&key, id)| (key + 0.0, id)),
        );
        // Adding 0 has made −0 and +0 the same, so the total order breaks ties by id alone.
        let nearer = |a: &(f32, i32), b: &(f32, i32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if order.len() >= panel.k {
            order.select_nth_unstable_by(panel.k - 1, nearer);
            order.truncate(panel.k - 1);
        }
        order.sort_unstable_by(nearer);
        out.fill(own);
        for (out, &(_, id)) in out[1..].iter_mut().zip(&order) {
            *out = id;
        }
    }
}
