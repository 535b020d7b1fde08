//! The k nearest nodes of every node of a patch, by the Euclidean distance of their features.

mod distance;
mod select;

use pulp::Arch;
use rayon::prelude::*;

use super::element::Element;
use super::shape::{check_product, check_size};
use super::simd::dispatch;
use crate::error::{GeomError, Result, check_len};
use distance::{Panels, RankKeys};
use select::Select;

/// Nodes above which a patch is refused: a patch of this crate has at most 512.
const MAX_NODES: usize = 1 << 15;

/// Finds the k nearest nodes of every node inside its patch; the node itself always comes first.
///
/// `out[p,i,0] = i`, then the k − 1 other nodes j with the smallest `d²(i,j) = |f_j|² − 2 f_i·f_j + |f_i|²`, nearest
/// first, the lower id first on ties. Nodes with the same features are exact ties.
///
/// - `features`: (P, N, C), row-major.
/// - `n_patches`, `n_nodes`, `n_channels`: P, N, C.
/// - `k`: how many, 1 to N, the node itself counted.
/// - `out`: (P, N, k), node ids inside the patch, overwritten.
///
/// Distances are taken in `f32` from the products of features relative to the patch's first node, so that a
/// common offset costs no accuracy; two distances may change places where they differ by less than the rounding of
/// |f_i − f_0|². A node whose norm is NaN or overflows is nobody else's neighbour, and a place that finds no
/// neighbour repeats the node itself.
///
/// # Errors
///
/// [`LengthMismatch`](GeomError::LengthMismatch) for an array of the wrong length,
/// [`InvalidParameter`](GeomError::InvalidParameter) for a size of 0, more than 32,768 nodes or k outside 1 to N;
/// nothing is written then.
///
/// Paper: Sec. 5.1 (dynamic EdgeConv, K = 8).
///
/// Choice: docs/choices.md#knn-self.
///
/// ```
/// use gcnd_geom::kernels::knn;
/// let features: [f32; 4] = [0.0, 5.0, 1.0, 7.0];
/// let mut out = [0; 8];
/// knn(&features, 1, 4, 1, 2, &mut out)?;
/// assert_eq!(out, [0, 2, 1, 3, 2, 0, 3, 1]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn knn<T: Element>(
    features: &[T],
    n_patches: usize,
    n_nodes: usize,
    n_channels: usize,
    k: usize,
    out: &mut [i32],
) -> Result<()> {
    check_size("n_nodes", n_nodes, MAX_NODES, "1 to 32768")?;
    check_size("n_channels", n_channels, usize::MAX, "at least 1")?;
    if !(1..=n_nodes).contains(&k) {
        let value = format!("{k} with n_nodes {n_nodes}");
        return Err(GeomError::InvalidParameter { name: "k", value, allowed: "1 to n_nodes" });
    }
    check_product("features or neighbours", &[n_patches, n_nodes, n_channels.max(k)])?;
    check_len("features", n_patches * n_nodes * n_channels, features.len())?;
    check_len("out", n_patches * n_nodes * k, out.len())?;
    let arch = Arch::new();
    features.par_chunks_exact(n_nodes * n_channels).zip(out.par_chunks_exact_mut(n_nodes * k)).for_each_init(
        || {
            let panels = Panels::new(arch, n_nodes, n_channels);
            let keys = RankKeys::new(&panels);
            (panels, keys)
        },
        |(panels, keys), (features, out)| knn_of_patch(arch, features, k, panels, keys, out),
    );
    Ok(())
}

/// [`knn`] on one patch.
fn knn_of_patch<T: Element>(
    arch: Arch,
    features: &[T],
    k: usize,
    panels: &mut Panels,
    keys: &mut RankKeys,
    out: &mut [i32],
) {
    panels.pack(arch, features);
    for (panel, out) in out.chunks_mut(panels.width() * k).enumerate() {
        keys.fill(arch, panels, panel);
        dispatch(arch, Select { keys, first_node: panel * panels.width(), k, out });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every instruction set that this processor can run.
    fn archs() -> Vec<Arch> {
        #[cfg(target_arch = "x86_64")]
        let avx2 = pulp::x86::V3::try_new().map(Arch::V3);
        #[cfg(not(target_arch = "x86_64"))]
        let avx2 = None;
        [Some(Arch::Scalar), avx2, Some(Arch::new())].into_iter().flatten().collect()
    }

    /// Small integers, for which every distance is exact: all instruction sets must then agree to the bit.
    #[test]
    fn every_vector_width_finds_the_same_neighbours() {
        for (n_nodes, n_channels, k) in
            [(1, 1, 1), (5, 3, 5), (37, 2, 4), (64, 9, 8), (65, 8, 17), (70, 5, 32), (50, 4, 41)]
        {
            let features: Vec<f32> =
                (0..n_nodes * n_channels).map(|i| ((i * i * 31 + i * 7) % 11) as f32 - 5.0).collect();
            let run = |arch: Arch| {
                let (mut panels, mut out) = (Panels::new(arch, n_nodes, n_channels), vec![-1; n_nodes * k]);
                let mut keys = RankKeys::new(&panels);
                knn_of_patch(arch, &features, k, &mut panels, &mut keys, &mut out);
                out
            };
            let expected = run(Arch::Scalar);
            for arch in archs() {
                assert_eq!(run(arch), expected, "{arch:?}: {n_nodes} nodes, {n_channels} channels, k {k}");
            }
        }
    }
}
