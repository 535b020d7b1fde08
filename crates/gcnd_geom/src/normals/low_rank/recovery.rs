//! Recovery of vertex normals from groups of patches alike.

use super::LowRankParams;
use super::patches::{Around, Patches};
use super::shrinkage::Shrinkage;
use crate::normals::kernel::unit_or_zero;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;

/// So many normals are recovered before they are added up.
const BLOCK: usize = 1 << 21;

/// Sums of recovered normals on their way to all vertices.
pub(crate) struct Recovery<'a> {
    topology: &'a Topology,
    patches: &'a Patches,
    normals: &'a [DVec3],
    params: &'a LowRankParams,
    sums: Vec<DVec3>,
}

/// One group: its patches, and their recovered normals one after the other.
struct Group {
    patches: Vec<u32>,
    recovered: Vec<DVec3>,
}

/// Scratch memory of one thread.
#[derive(Default)]
struct Scratch {
    around: Around,
    shrinkage: Shrinkage,
    coordinates: [Vec<f64>; 3],
}

impl<'a> Recovery<'a> {
    /// Starts the recovery of vertex normals (V).
    pub fn new(
        topology: &'a Topology,
        patches: &'a Patches,
        normals: &'a [DVec3],
        params: &'a LowRankParams,
    ) -> Self {
        Self { topology, patches, normals, params, sums: vec![DVec3::ZERO; normals.len()] }
    }

    /// Recovers the groups of one part of the vertices, of so many parts.
    pub fn run(&mut self, part: usize, n_parts: usize) {
        let n = self.normals.len();
        let block = (BLOCK / (self.params.patch_size * self.params.similar_patches)).max(1);
        let (first, end) = (n * part / n_parts, n * (part + 1) / n_parts);
        for start in (first..end).step_by(block) {
            let vertices = (start..end.min(start + block)).into_par_iter().with_min_len(16);
            let groups: Vec<Group> =
                vertices.map_init(Scratch::default, |scratch, v| self.recover(v, scratch)).collect();
            // One after the other, so that threads do not change the sums.
            for group in &groups {
                let members = group.patches.iter().flat_map(|&patch| self.patches.members(patch as usize));
                for (&v, normal) in members.zip(&group.recovered) {
                    self.sums[v as usize] += *normal;
                }
            }
        }
    }

    /// The sums so far (V).
    pub fn sums(&self) -> &[DVec3] {
        &self.sums
    }

    /// The vertex normals (V): unit, zero where none is known.
    pub fn finish(self) -> Vec<DVec3> {
        self.sums.into_par_iter().map(unit_or_zero).collect()
    }

    /// The group of one vertex.
    fn recover(&self, vertex_id: usize, scratch: &mut Scratch) -> Group {
        let LowRankParams { sigma_m, similar_patches, search_rings, .. } = *self.params;
        let patches = self.patches;
        let alike =
            patches.find_alike(self.topology, vertex_id, search_rings, similar_patches, &mut scratch.around);
        let (n_rows, n_columns) = (patches.members(vertex_id).len(), alike.len());
        for matrix in &mut scratch.coordinates {
            matrix.clear();
            matrix.resize(n_rows * n_columns, 0.0);
        }
        for (column, &patch) in alike.iter().enumerate() {
            let patch_from_world = patches.world_from_patch(patch as usize).transpose();
            for (row, &v) in patches.members(patch as usize).iter().enumerate() {
                let normal = (patch_from_world * self.normals[v as usize]).to_array();
                for (matrix, x) in scratch.coordinates.iter_mut().zip(normal) {
                    matrix[row * n_columns + column] = x;
                }
            }
        }
        let weights = scratch.coordinates.each_mut().map(|matrix| {
            let rank = scratch.shrinkage.recover(matrix, n_columns, sigma_m);
            n_rows.saturating_sub(rank).max(1) as f64 / n_rows as f64
        });
        let weights = DVec3::from_array(weights);
        let mut recovered = Vec::with_capacity(n_rows * n_columns);
        for (column, &patch) in alike.iter().enumerate() {
            let world_from_patch = patches.world_from_patch(patch as usize);
            for row in 0..n_rows {
                let normal = scratch.coordinates.each_ref().map(|matrix| matrix[row * n_columns + column]);
                recovered.push(world_from_patch * (weights * DVec3::from_array(normal)));
            }
        }
        Group { patches: alike, recovered }
    }
}
