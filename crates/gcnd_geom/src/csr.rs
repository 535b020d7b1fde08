//! Compressed rows: many short lists of ids in two flat arrays.

/// Lists of `u32` ids, one per row, stored back to back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Csr {
    offsets: Vec<u64>,
    values: Vec<u32>,
}

impl Csr {
    /// Builds the rows from each row's length and a second pass that yields `(row, value)` pairs.
    ///
    /// Within a row, values keep the order in which `pairs` yields them.
    pub fn from_pairs(n_rows: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut offsets = vec![0u64; n_rows + 1];
        for (row, _) in pairs.clone() {
            offsets[row as usize + 1] += 1;
        }
        for row in 0..n_rows {
            offsets[row + 1] += offsets[row];
        }
        let mut values = vec![0u32; offsets[n_rows] as usize];
        let mut next = offsets.clone();
        for (row, value) in pairs {
            values[next[row as usize] as usize] = value;
            next[row as usize] += 1;
        }
        Self { offsets, values }
    }

    /// Builds the rows from their lengths and their values back to back.
    ///
    /// # Panics
    /// If the lengths do not add up to the number of values.
    pub fn from_lengths(lengths: &[u32], values: Vec<u32>) -> Self {
        let mut offsets = Vec::with_capacity(lengths.len() + 1);
        let mut total = 0u64;
        offsets.push(0);
        for &length in lengths {
            total += u64::from(length);
            offsets.push(total);
        }
        assert_eq!(total as usize, values.len(), "row lengths must add up to the number of values");
        Self { offsets, values }
    }

    /// The ids of one row.
    #[inline]
    pub fn row(&self, row: usize) -> &[u32] {
        &self.values[self.offsets[row] as usize..self.offsets[row + 1] as usize]
    }

    /// How many rows there are.
    pub fn n_rows(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Row boundaries in [`Csr::values`]: row `i` is `values[offsets[i]..offsets[i + 1]]`.
    pub fn offsets(&self) -> &[u64] {
        &self.offsets
    }

    /// All ids, row after row.
    pub fn values(&self) -> &[u32] {
        &self.values
    }
}
