//! Eq. 5 at work: weights that stay the same over the iterations are computed once and kept where memory allows.

use crate::error::Result;
use crate::face_geometry::FaceGeometry;
use crate::normals::neighborhood::{NeighborScratch, Neighborhood, Neighbors};
use crate::normals::refine::RefineParams;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// The unit vector along `v`, or zero for zero; neither underflows nor overflows.
pub(crate) fn unit_or_zero(v: DVec3) -> DVec3 {
    let scale = v.abs().max_element();
    if scale > 0.0 { (v / scale).normalize() } else { DVec3::ZERO }
}

/// Faces of one unit of parallel work.
pub(crate) const CHUNK: usize = 4096;
/// Neighbours may be stored up to so many bytes a face …
pub(crate) const STORED_BYTES_PER_FACE: usize = 256;
/// … or so many in all, whichever is more.
pub(crate) const STORED_BYTES: usize = 64 << 20;
/// A stored neighbour: its id and its weight.
const ENTRY_BYTES: usize = size_of::<u32>() + size_of::<f64>();

/// Neighbours and a_j · W_s of the faces of one chunk, without the faces themselves.
#[derive(Default)]
pub(crate) struct Rows {
    ends: Vec<u32>,
    neighbors: Vec<u32>,
    weights: Vec<f64>,
}

/// What stays the same over the iterations.
pub(crate) struct Filter<'a> {
    topology: &'a Topology,
    centroids: Vec<DVec3>,
    /// Areas over the largest area, so that the sum of Eq. 5 cannot underflow on a tiny mesh.
    areas: Vec<f64>,
    /// 1/σ_s; zero, hence W_s = 1, for a mesh without a length of its own.
    per_sigma_s: f64,
    sigma_r: f64,
    own: OwnNormal,
    neighborhood: Neighborhood,
    radius: f64,
}

/// Whether a face is its own neighbour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum OwnNormal {
    /// It is, with its area and full weight.
    Counts,
    /// It is not; its normal serves the range weight alone.
    Omitted,
}

impl<'a> Filter<'a> {
    pub fn new(
        topology: &'a Topology,
        vertices: &[DVec3],
        params: &RefineParams,
        own: OwnNormal,
    ) -> Result<Self> {
        let geometry = FaceGeometry::compute(vertices, topology.faces());
        let mean_distance = geometry.mean_centroid_distance(topology)?;
        let sigma_s = params.sigma_s.unwrap_or(mean_distance);
        let radius = params.neighborhood.radius(mean_distance);
        let mut areas = geometry.areas;
        let largest = areas.iter().copied().fold(0.0, f64::max);
        if largest > 0.0 {
            areas.par_iter_mut().with_min_len(CHUNK).for_each(|a| *a /= largest);
        }
        Ok(Self {
            topology,
            centroids: geometry.centroids,
            areas,
            per_sigma_s: if sigma_s > 0.0 { sigma_s.recip() } else { 0.0 },
            sigma_r: params.sigma_r,
            own,
            neighborhood: params.neighborhood,
            radius,
        })
    }

    /// One application of Eq. 5 to all faces.
    pub fn iterate(&self, current: &[DVec3], next: &mut [DVec3], rows: &[Option<Rows>]) {
        next.par_chunks_mut(CHUNK).zip(rows).enumerate().for_each_init(
            NeighborScratch::default,
            |scratch, (chunk, (out, rows))| {
                let first = chunk * CHUNK;
                match rows {
                    Some(rows) => self.apply_stored(first, current, out, rows),
                    None => self.apply_anew(first, current, out, scratch),
                }
            },
        );
    }

    fn apply_stored(&self, first: usize, current: &[DVec3], out: &mut [DVec3], rows: &Rows) {
        let mut start = 0;
        for ((offset, normal), &end) in out.iter_mut().enumerate().zip(&rows.ends) {
            let row = start..end as usize;
            start = row.end;
            let weighted = rows.neighbors[row.clone()].iter().copied().zip(rows.weights[row].iter().copied());
            *normal = self.filtered(first + offset, current, weighted);
        }
    }

    fn apply_anew(&self, first: usize, current: &[DVec3], out: &mut [DVec3], scratch: &mut NeighborScratch) {
        let neighbors = self.neighbors();
        for (offset, normal) in out.iter_mut().enumerate() {
            let face_id = first + offset;
            let weighted =
                neighbors.of(face_id, scratch).iter().map(|&j| (j, self.spatial_weight(face_id, j as usize)));
            *normal = self.filtered(face_id, current, weighted);
        }
    }

    /// Eq. 5 for one face, given its neighbours with their a_j · W_s.
    #[inline]
    fn filtered(
        &self,
        face_id: usize,
        current: &[DVec3],
        weighted: impl Iterator<Item = (u32, f64)>,
    ) -> DVec3 {
        let own = current[face_id];
        let mut sum = match self.own {
            OwnNormal::Counts => self.areas[face_id] * own,
            OwnNormal::Omitted => DVec3::ZERO,
        };
        if own == DVec3::ZERO {
            for (neighbor, weight) in weighted {
                sum += weight * current[neighbor as usize];
            }
        } else {
            let scale = -0.5 / self.sigma_r / self.sigma_r;
            for (neighbor, weight) in weighted {
                let normal = current[neighbor as usize];
                sum += weight * (scale * normal.distance_squared(own)).exp() * normal;
            }
        }
        let filtered = unit_or_zero(sum);
        if filtered == DVec3::ZERO { own } else { filtered }
    }

    /// a_j · W_s(|c_j − c_i|).
    #[inline]
    fn spatial_weight(&self, i: usize, j: usize) -> f64 {
        let x = self.centroids[i].distance(self.centroids[j]) * self.per_sigma_s;
        self.areas[j] * (-0.5 * x * x).exp()
    }

    /// Ω without the face itself.
    pub fn neighbors(&self) -> Neighbors<'_> {
        Neighbors {
            topology: self.topology,
            neighborhood: self.neighborhood,
            centroids: &self.centroids,
            radius: self.radius,
        }
    }

    /// Rows of every chunk whose rows fit into the memory allowed, `None` for the others.
    pub fn stored_rows(&self, bytes_per_face: usize) -> Vec<Option<Rows>> {
        let n_faces = self.topology.n_faces();
        let n_chunks = n_faces.div_ceil(CHUNK);
        let at_least = if bytes_per_face == 0 { 0 } else { STORED_BYTES / n_chunks.max(1) };
        (0..n_chunks)
            .into_par_iter()
            .map_init(NeighborScratch::default, |scratch, chunk| {
                let faces = chunk * CHUNK..n_faces.min((chunk + 1) * CHUNK);
                let bytes = (bytes_per_face * faces.len()).max(at_least);
                if bytes == 0 { None } else { self.chunk_rows(faces, bytes / ENTRY_BYTES, scratch) }
            })
            .collect()
    }

    /// Rows of some faces, or `None` if they hold more than `limit` neighbours.
    fn chunk_rows(&self, faces: Range<usize>, limit: usize, scratch: &mut NeighborScratch) -> Option<Rows> {
        let mut rows = Rows::default();
        let finder = self.neighbors();
        for face_id in faces {
            let neighbors = finder.of(face_id, scratch);
            if rows.neighbors.len() + neighbors.len() > limit {
                return None;
            }
            rows.neighbors.extend_from_slice(neighbors);
            rows.weights.extend(neighbors.iter().map(|&j| self.spatial_weight(face_id, j as usize)));
            rows.ends.push(rows.neighbors.len() as u32);
        }
        rows.neighbors.shrink_to_fit();
        rows.weights.shrink_to_fit();
        Some(rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn a_chunk_over_its_memory_is_not_stored() {
        let (vertices, faces) = fixtures::grid(8, 8);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let filter =
            Filter::new(&topology, &vertices, &RefineParams::default(), OwnNormal::Counts).expect("valid");
        let mut scratch = NeighborScratch::default();
        assert!(filter.chunk_rows(0..128, 100, &mut scratch).is_none());
        let rows = filter.chunk_rows(0..128, 2000, &mut scratch).expect("fits");
        assert_eq!(rows.ends.len(), 128);
        assert_eq!(rows.neighbors.len(), rows.weights.len());
        assert!(filter.stored_rows(0)[0].is_none() && filter.stored_rows(1)[0].is_some());
    }
}
