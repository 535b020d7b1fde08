//! The shape of a gather over patches, and the checks that every kernel makes before its first write.

use rayon::prelude::*;

use crate::error::{GeomError, Result, check_len};

/// The sizes of a gather: values (P, N, C), neighbours (P, N, K).
///
/// ```
/// use gcnd_geom::kernels::GatherShape;
/// let shape = GatherShape { n_patches: 256, n_nodes: 64, n_channels: 128, n_neighbors: 8 };
/// assert_eq!(shape.n_nodes * shape.n_channels, 8192);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GatherShape {
    /// P, the number of patches; may be 0.
    pub n_patches: usize,
    /// N, the number of nodes of each patch, 1 to 65,536.
    pub n_nodes: usize,
    /// C, the number of channels of each node, at least 1.
    pub n_channels: usize,
    /// K, the number of neighbours of each node, at least 1.
    pub n_neighbors: usize,
}

impl GatherShape {
    /// How many node ids an argmax of 16 bits can tell apart.
    const MAX_NODES: usize = 1 << 16;

    /// N · C, the number of values of one patch.
    pub(super) fn patch_values(&self) -> usize {
        self.n_nodes * self.n_channels
    }

    /// N · K, the number of neighbour ids of one patch.
    pub(super) fn patch_neighbors(&self) -> usize {
        self.n_nodes * self.n_neighbors
    }

    /// P · N · C, the length of the values.
    pub(super) fn n_values(&self) -> usize {
        self.n_patches * self.patch_values()
    }

    /// Checks the sizes and that their products fit an index.
    pub(super) fn check(&self) -> Result<()> {
        check_size("n_nodes", self.n_nodes, Self::MAX_NODES, "1 to 65536")?;
        check_size("n_channels", self.n_channels, usize::MAX, "at least 1")?;
        check_size("n_neighbors", self.n_neighbors, usize::MAX, "at least 1")?;
        let widest = self.n_channels.max(self.n_neighbors);
        check_product("values or neighbours", &[self.n_patches, self.n_nodes, widest])
    }

    /// Checks the length of an array of values.
    pub(super) fn check_values(&self, what: &'static str, got: usize) -> Result<()> {
        check_len(what, self.n_values(), got)
    }

    /// Checks the neighbours' length and that each of them is a node of its patch.
    pub(super) fn check_neighbors(&self, neighbors: &[i32]) -> Result<()> {
        check_len("neighbors", self.n_patches * self.patch_neighbors(), neighbors.len())?;
        let limit = self.n_nodes as u32;
        if all_below(neighbors, |id| id as u32, limit) {
            return Ok(());
        }
        let slot = neighbors.iter().position(|&id| id as u32 >= limit).unwrap_or(0);
        Err(GeomError::InvalidParameter {
            name: "neighbors",
            value: self.describe(slot, self.n_neighbors, i64::from(neighbors[slot])),
            allowed: "node ids inside the patch, 0 to n_nodes - 1",
        })
    }

    /// Checks the argmax's length and that each of its entries is a node of the patch.
    pub(super) fn check_argmax(&self, argmax: &[u16]) -> Result<()> {
        check_len("argmax", self.n_values(), argmax.len())?;
        let limit = self.n_nodes as u32;
        if all_below(argmax, u32::from, limit) {
            return Ok(());
        }
        let slot = argmax.iter().position(|&id| u32::from(id) >= limit).unwrap_or(0);
        Err(GeomError::InvalidParameter {
            name: "argmax",
            value: self.describe(slot, self.n_channels, i64::from(argmax[slot])),
            allowed: "node ids inside the patch, 0 to n_nodes - 1",
        })
    }

    /// Says which entry of a (P, N, `width`) array is wrong.
    fn describe(&self, slot: usize, width: usize, id: i64) -> String {
        let (node, column) = (slot / width, slot % width);
        let (patch, node) = (node / self.n_nodes, node % self.n_nodes);
        format!("{id} at [{patch}, {node}, {column}] with n_nodes {}", self.n_nodes)
    }
}

/// Returns [`GeomError::InvalidParameter`] unless 1 ≤ `value` ≤ `max`.
pub(super) fn check_size(name: &'static str, value: usize, max: usize, allowed: &'static str) -> Result<()> {
    if (1..=max).contains(&value) {
        return Ok(());
    }
    Err(GeomError::InvalidParameter { name, value: value.to_string(), allowed })
}

/// Returns [`GeomError::InvalidParameter`] unless the slope of LeakyReLU lies in 0 to 1.
pub(super) fn check_slope(slope: f32) -> Result<()> {
    if (0.0..=1.0).contains(&slope) {
        return Ok(());
    }
    Err(GeomError::InvalidParameter { name: "slope", value: slope.to_string(), allowed: "0 to 1" })
}

/// Returns [`GeomError::TooLarge`] unless the product of the sizes fits an index.
pub(super) fn check_product(what: &'static str, sizes: &[usize]) -> Result<()> {
    let limit = isize::MAX as usize;
    let product = sizes.iter().try_fold(1usize, |product, &size| product.checked_mul(size));
    match product {
        Some(count) if count <= limit => Ok(()),
        _ => Err(GeomError::TooLarge { what, count: product.unwrap_or(usize::MAX), limit }),
    }
}

/// Whether every id is below `limit`; a negative id widened to `u32` is not. Without early exit, so that it vectorises.
fn all_below<I: Copy + Sync>(ids: &[I], widen: impl Fn(I) -> u32 + Sync, limit: u32) -> bool {
    const CHUNK: usize = 1 << 15;
    ids.par_chunks(CHUNK).all(|chunk| chunk.iter().fold(0, |max, &id| widen(id).max(max)) < limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: GatherShape = GatherShape { n_patches: 2, n_nodes: 3, n_channels: 5, n_neighbors: 2 };

    #[test]
    fn names_the_wrong_neighbor() {
        let mut neighbors = [0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2];
        assert_eq!(SHAPE.check_neighbors(&neighbors), Ok(()));
        for bad in [3, -1, i32::MIN] {
            neighbors[9] = bad;
            let expected = GeomError::InvalidParameter {
                name: "neighbors",
                value: format!("{bad} at [1, 1, 1] with n_nodes 3"),
                allowed: "node ids inside the patch, 0 to n_nodes - 1",
            };
            assert_eq!(SHAPE.check_neighbors(&neighbors), Err(expected));
        }
    }

    #[test]
    fn refuses_empty_and_overflowing_sizes() {
        let refused = |shape: GatherShape, wrong: &str| match shape.check() {
            Err(GeomError::InvalidParameter { name, value, .. }) => {
                assert_eq!((name, value.as_str()), (wrong, if wrong == "n_nodes" { "65537" } else { "0" }));
            }
            other => panic!("{other:?}"),
        };
        refused(GatherShape { n_nodes: 65537, ..SHAPE }, "n_nodes");
        refused(GatherShape { n_channels: 0, ..SHAPE }, "n_channels");
        refused(GatherShape { n_neighbors: 0, ..SHAPE }, "n_neighbors");
        let huge = GatherShape { n_patches: usize::MAX / 2, ..SHAPE };
        assert!(matches!(huge.check(), Err(GeomError::TooLarge { count: usize::MAX, .. })));
        assert_eq!(GatherShape { n_patches: 0, ..SHAPE }.check(), Ok(()));
    }
}
