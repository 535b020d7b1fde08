//! Patch selection (paper Sec. 4.1, Eq. 1): which faces belong to the patch of a face. The only user of the
//! KD-tree.

use super::id_slots::IdSlots;
use crate::face_geometry::FaceGeometry;
use crate::topology::Topology;
use glam::DVec3;
use kiddo::kd_tree::QueryScratch;
use kiddo::{Eytzinger, ImmutableKdTree, SquaredEuclidean};

/// The vertices that faces use, arranged for radius queries.
#[derive(Debug)]
pub(crate) struct VertexTree(ImmutableKdTree<f64, 3>);

impl VertexTree {
    /// Arranges the vertices that at least one face uses.
    ///
    /// # Panics
    /// If there is no such vertex or one is not finite; the extractor has checked both.
    pub(crate) fn new(topology: &Topology, vertices: &[DVec3]) -> Self {
        let stars = topology.vertex_faces();
        let entries: Vec<(u32, [f64; 3])> = (0u32..)
            .zip(vertices)
            .filter(|(vertex_id, _)| !stars.row(*vertex_id as usize).is_empty())
            .map(|(vertex_id, v)| (vertex_id, v.to_array()))
            .collect();
        Self(ImmutableKdTree::new_from_entries(&entries).expect("a checked mesh has finite vertices"))
    }

    /// Calls `visit` with every vertex strictly closer to `center` than `radius`, in an order that depends on
    /// the tree alone.
    #[inline]
    fn visit_within(
        &self,
        center: DVec3,
        radius: f64,
        vertices: &[DVec3],
        scratch: &mut QueryScratch<Eytzinger, f64, 3>,
        mut visit: impl FnMut(u32),
    ) {
        // The tree's own test is inclusive and may round otherwise than Eq. 1 does here, so it gets a slightly
        // larger ball, and where its answer is close Eq. 1 decides.
        const SLACK: f64 = 1e-9;
        let squared = radius * radius;
        let certain = squared * (1.0 - SLACK);
        self.0
            .query(&center.to_array())
            .within::<SquaredEuclidean<f64>>(squared * (1.0 + SLACK))
            .unsorted()
            .with_scratch(scratch)
            .visit(|near| {
                let is_inside = || vertices[near.item as usize].distance_squared(center) < squared;
                if near.distance < certain || is_inside() {
                    visit(near.item);
                }
            });
    }
}

/// A face of a patch with its squared distance to the centre, as bits: for numbers not below zero their order
/// is the numbers' order, and integers compare faster.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Candidate {
    squared_distance_bits: u64,
    pub(crate) face_id: u32,
}

/// Memory of one thread for selecting patches.
pub(crate) struct SelectScratch {
    seen_vertices: IdSlots,
    /// The faces of the last patch; node numbers are entered here as slots.
    pub(crate) seen_faces: IdSlots,
    query: QueryScratch<Eytzinger, f64, 3>,
    /// The centre and its 2-ring, the centre first.
    pub(crate) two_ring: Vec<u32>,
    /// The patch: the centre, then the others by (distance of centroids, face id).
    pub(crate) candidates: Vec<Candidate>,
    /// Faces whose neighbours are still to be looked at, and what is known of the parts of a patch.
    pub(crate) frontier: Vec<u32>,
    pub(crate) is_other_sheet: Vec<bool>,
}

impl SelectScratch {
    pub(crate) fn new() -> Self {
        Self {
            seen_vertices: IdSlots::new(),
            seen_faces: IdSlots::new(),
            query: QueryScratch::new(),
            two_ring: Vec::new(),
            candidates: Vec::new(),
            frontier: Vec::new(),
            is_other_sheet: Vec::new(),
        }
    }
}

/// What the 2-ring says about a patch before it is selected.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PatchScale {
    /// Eq. 1's r in mesh units; `None` where it is zero or its square no longer a normal number.
    pub(crate) radius: Option<f64>,
    /// Mean area of the centre and its 2-ring, in mesh units squared.
    pub(crate) mean_area: f64,
    /// Sum of area · normal over the same faces.
    pub(crate) area_normal: DVec3,
}

impl PatchScale {
    /// 1/r. Without a radius it is zero: offsets are dropped rather than left in units of the mesh.
    pub(crate) fn length_scale(&self) -> f64 {
        self.radius.map_or(0.0, f64::recip)
    }
}

/// Computes r = patch_scale · sqrt(mean area of the centre and its 2-ring); leaves those faces in
/// `scratch.two_ring`.
pub(crate) fn patch_scale_of(
    topology: &Topology,
    geometry: &FaceGeometry,
    face_id: u32,
    patch_scale: f64,
    scratch: &mut SelectScratch,
) -> PatchScale {
    collect_two_ring(topology, face_id, scratch);
    let (mut area, mut area_normal) = (0.0, DVec3::ZERO);
    for &ring_face in &scratch.two_ring {
        let ring_face = ring_face as usize;
        area += geometry.areas[ring_face];
        area_normal += geometry.areas[ring_face] * geometry.normals[ring_face];
    }
    let mean_area = area / scratch.two_ring.len() as f64;
    let radius = patch_scale * mean_area.sqrt();
    let usable = (radius * radius).is_normal();
    PatchScale { radius: usable.then_some(radius), mean_area, area_normal }
}

/// The centre, then the faces within two steps across shared vertices.
fn collect_two_ring(topology: &Topology, face_id: u32, scratch: &mut SelectScratch) {
    let SelectScratch { seen_vertices, seen_faces, two_ring, .. } = scratch;
    let (faces, stars) = (topology.faces(), topology.vertex_faces());
    seen_vertices.clear();
    seen_faces.clear();
    two_ring.clear();
    two_ring.push(face_id);
    seen_faces.insert(face_id);
    let mut frontier_start = 0;
    for _ in 0..2 {
        let frontier_end = two_ring.len();
        for slot in frontier_start..frontier_end {
            for vertex_id in faces[two_ring[slot] as usize] {
                if seen_vertices.insert(vertex_id) {
                    let star = stars.row(vertex_id as usize);
                    two_ring.extend(star.iter().filter(|&&neighbor| seen_faces.insert(neighbor)));
                }
            }
        }
        frontier_start = frontier_end;
    }
}

/// Selects the faces with a vertex strictly within `radius` of the centre's centroid, and the centre itself;
/// leaves them in `scratch.candidates`.
pub(crate) fn select_patch(
    topology: &Topology,
    geometry: &FaceGeometry,
    vertices: &[DVec3],
    tree: &VertexTree,
    face_id: u32,
    radius: Option<f64>,
    scratch: &mut SelectScratch,
) {
    let SelectScratch { seen_faces, query, candidates, .. } = scratch;
    let center = geometry.centroids[face_id as usize];
    let stars = topology.vertex_faces();
    seen_faces.clear();
    candidates.clear();
    seen_faces.insert(face_id);
    candidates.push(Candidate { squared_distance_bits: 0, face_id });
    let Some(radius) = radius else { return };
    tree.visit_within(center, radius, vertices, query, |vertex_id| {
        for &near_face in stars.row(vertex_id as usize) {
            if seen_faces.insert(near_face) {
                let squared_distance = geometry.centroids[near_face as usize].distance_squared(center);
                candidates.push(Candidate {
                    squared_distance_bits: squared_distance.to_bits(),
                    face_id: near_face,
                });
            }
        }
    });
    // The tree's order is an accident of its construction; this one is not, so sums over a patch are
    // reproducible.
    candidates[1..].sort_unstable();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;
    use crate::topology::RingScratch;

    #[test]
    fn two_ring_equals_the_topology_query() {
        for (vertices, faces) in [fixtures::grid(7, 5), fixtures::moebius(), fixtures::three_on_an_edge()] {
            let topology = Topology::new(faces, vertices.len()).expect("valid");
            let mut scratch = SelectScratch::new();
            for face_id in 0..topology.n_faces() {
                collect_two_ring(&topology, face_id as u32, &mut scratch);
                assert_eq!(scratch.two_ring[0], face_id as u32);
                scratch.two_ring[1..].sort_unstable();
                assert_eq!(scratch.two_ring[1..], *topology.ring(face_id, 2, &mut RingScratch::new()));
            }
        }
    }

    #[test]
    fn scale_of_a_grid_face() {
        let (vertices, faces) = fixtures::grid(6, 6);
        let geometry = FaceGeometry::compute(&vertices, &faces);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let scale = patch_scale_of(&topology, &geometry, 30, 4.0, &mut SelectScratch::new());
        assert_eq!(scale.mean_area, 0.5);
        assert_eq!(scale.radius, Some(4.0 * 0.5f64.sqrt()));
        assert_eq!(scale.area_normal.normalize(), DVec3::Z);
    }
}
