//! Which faces count as a face's neighbours in the normal filters.

use crate::normals::kernel::{CHUNK, STORED_BYTES, STORED_BYTES_PER_FACE};
use crate::topology::{RingScratch, Topology};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Which faces a face's normal is averaged with: Ω of Eq. 5, in each case with the face itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Neighborhood {
    /// `VertexNeighbors`: faces that share at least one vertex.
    SharedVertex,
    /// `EdgeNeighbors`: faces that share an edge.
    SharedEdge,
    /// Faces whose centroid is at most `multiple` mean centroid distances away and that are reached over
    /// faces for which the same holds, stepping across shared vertices; so a close but unconnected sheet
    /// stays out.
    Radius {
        /// Radius in units of [`crate::face_geometry::FaceGeometry::mean_centroid_distance`]; positive.
        multiple: f64,
    },
}

impl Neighborhood {
    /// The radius in mesh units; 0 where there is none.
    pub(crate) fn radius(&self, mean_distance: f64) -> f64 {
        match self {
            Self::Radius { multiple } => multiple * mean_distance,
            Self::SharedVertex | Self::SharedEdge => 0.0,
        }
    }
}

/// Scratch memory of one thread for [`Neighbors::of`].
#[derive(Default)]
pub(crate) struct NeighborScratch {
    ring: RingScratch,
    near: Vec<u32>,
}

/// Finds the neighbours of faces.
#[derive(Clone, Copy)]
pub(crate) struct Neighbors<'a> {
    pub topology: &'a Topology,
    pub neighborhood: Neighborhood,
    /// Centroids (F); used by `Radius` alone.
    pub centroids: &'a [DVec3],
    /// In the units of `centroids`.
    pub radius: f64,
}

impl Neighbors<'_> {
    /// The faces of Ω without the face itself, in an order that depends on the topology alone.
    pub fn of<'s>(&'s self, face_id: usize, scratch: &'s mut NeighborScratch) -> &'s [u32] {
        match self.neighborhood {
            Neighborhood::SharedVertex => self.topology.vertex_neighbors(face_id, &mut scratch.ring),
            Neighborhood::SharedEdge => self.topology.edge_neighbors(face_id),
            Neighborhood::Radius { .. } => {
                self.grow(face_id, &mut scratch.ring, &mut scratch.near);
                &scratch.near
            }
        }
    }

    /// Breadth-first growth over shared vertices through faces within the radius.
    fn grow(&self, face_id: usize, scratch: &mut RingScratch, near: &mut Vec<u32>) {
        near.clear();
        scratch.begin(self.topology.n_faces());
        scratch.visit(face_id as u32);
        let (mut slot, mut reached) = (0, face_id as u32);
        loop {
            for vertex_id in self.topology.faces()[reached as usize] {
                for &neighbor in self.topology.vertex_faces().row(vertex_id as usize) {
                    if scratch.visit(neighbor) {
                        let distance = self.centroids[neighbor as usize].distance(self.centroids[face_id]);
                        if distance <= self.radius {
                            near.push(neighbor);
                        }
                    }
                }
            }
            let Some(&next) = near.get(slot) else { break };
            (slot, reached) = (slot + 1, next);
        }
        near.sort_unstable();
    }
}

/// Neighbours of all faces, found once and kept where memory allows, found anew elsewhere.
pub(crate) struct NeighborLists<'a> {
    neighbors: Neighbors<'a>,
    chunks: Vec<Option<Lists>>,
}

/// Neighbours of the faces of one chunk.
#[derive(Default)]
struct Lists {
    ends: Vec<u32>,
    values: Vec<u32>,
}

impl<'a> NeighborLists<'a> {
    /// Finds the neighbours; keeps those of chunks that need at most 256 bytes a face, or 64 MiB in all.
    pub fn new(neighbors: Neighbors<'a>) -> Self {
        let n_faces = neighbors.topology.n_faces();
        let n_chunks = n_faces.div_ceil(CHUNK);
        let at_least = STORED_BYTES / n_chunks.max(1);
        let chunks = (0..n_chunks)
            .into_par_iter()
            .map_init(NeighborScratch::default, |scratch, chunk| {
                let faces = chunk * CHUNK..n_faces.min((chunk + 1) * CHUNK);
                let bytes = (STORED_BYTES_PER_FACE * faces.len()).max(at_least);
                Lists::new(&neighbors, faces, bytes / size_of::<u32>(), scratch)
            })
            .collect();
        Self { neighbors, chunks }
    }

    /// The neighbours of a face without itself, as [`Neighbors::of`].
    #[inline]
    pub fn of<'s>(&'s self, face_id: usize, scratch: &'s mut NeighborScratch) -> &'s [u32] {
        match &self.chunks[face_id / CHUNK] {
            Some(lists) => lists.row(face_id % CHUNK),
            None => self.neighbors.of(face_id, scratch),
        }
    }
}

impl Lists {
    /// Lists of some faces, or `None` if they hold more than `limit` neighbours.
    fn new(
        neighbors: &Neighbors<'_>,
        faces: Range<usize>,
        limit: usize,
        scratch: &mut NeighborScratch,
    ) -> Option<Self> {
        let mut lists = Self::default();
        for face_id in faces {
            let row = neighbors.of(face_id, scratch);
            if lists.values.len() + row.len() > limit {
                return None;
            }
            lists.values.extend_from_slice(row);
            lists.ends.push(lists.values.len() as u32);
        }
        lists.values.shrink_to_fit();
        Some(lists)
    }

    #[inline]
    fn row(&self, offset: usize) -> &[u32] {
        let start = if offset == 0 { 0 } else { self.ends[offset - 1] as usize };
        &self.values[start..self.ends[offset] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face_geometry::FaceGeometry;
    use crate::fixtures;

    #[test]
    fn lists_are_the_neighbours_whether_kept_or_not() {
        let (vertices, faces) = fixtures::icosphere(5);
        assert!(faces.len() > CHUNK, "more than one chunk");
        let centroids = FaceGeometry::compute(&vertices, &faces).centroids;
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let neighborhood = Neighborhood::Radius { multiple: 2.0 };
        let neighbors = Neighbors { topology: &topology, neighborhood, centroids: &centroids, radius: 0.05 };
        let mut lists = NeighborLists::new(neighbors);
        assert!(lists.chunks.iter().all(Option::is_some));
        lists.chunks[0] = None;
        let (mut one, mut other) = (NeighborScratch::default(), NeighborScratch::default());
        for face_id in (0..topology.n_faces()).step_by(7) {
            assert_eq!(lists.of(face_id, &mut one), neighbors.of(face_id, &mut other));
        }
        assert!(Lists::new(&neighbors, 0..100, 99, &mut one).is_none(), "over its memory");
    }
}
