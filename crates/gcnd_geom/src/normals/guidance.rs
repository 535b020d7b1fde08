//! The guidance normals of guided filtering: each face listens to the most consistent patch that holds it.

use crate::face_geometry::FaceGeometry;
use crate::normals::kernel::{CHUNK, unit_or_zero};
use crate::normals::neighborhood::{NeighborLists, NeighborScratch, Neighborhood, Neighbors};
use crate::topology::{RingScratch, Topology};
use glam::DVec3;
use rayon::prelude::*;

/// So many normals of a patch are compared with each other; larger patches are sampled evenly.
const MOST_COMPARED: usize = 128;
/// Keeps the relative saliency of a flat patch at zero (Zhang et al. 2015, Eq. 8).
const EPSILON: f64 = 1e-9;

/// How consistent a face's patch is and which way it looks.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Patch {
    /// H(P); infinite for a patch without any normal.
    inconsistency: f64,
    /// Area-weighted mean normal, unit.
    mean: DVec3,
}

/// Patches of all faces and memory that is reused between iterations.
pub(crate) struct Guidance<'a> {
    topology: &'a Topology,
    lists: NeighborLists<'a>,
    patches: Vec<Patch>,
    guides: Vec<DVec3>,
}

impl<'a> Guidance<'a> {
    /// Finds the patches: a face and those that share a vertex with it.
    pub fn new(topology: &'a Topology) -> Self {
        let neighborhood = Neighborhood::SharedVertex;
        let lists = NeighborLists::new(Neighbors { topology, neighborhood, centroids: &[], radius: 0.0 });
        let n_faces = topology.n_faces();
        let none = Patch { inconsistency: f64::INFINITY, mean: DVec3::ZERO };
        Self { topology, lists, patches: vec![none; n_faces], guides: vec![DVec3::ZERO; n_faces] }
    }

    /// Guidance (F) for the geometry at hand: unit, or zero where no patch has a normal.
    pub fn update(&mut self, geometry: &FaceGeometry) -> &[DVec3] {
        let (topology, lists) = (self.topology, &self.lists);
        self.patches.par_chunks_mut(CHUNK).enumerate().for_each_init(
            Scratch::default,
            |scratch, (chunk, patches)| {
                for (offset, patch) in patches.iter_mut().enumerate() {
                    *patch = measure(chunk * CHUNK + offset, topology, lists, geometry, scratch);
                }
            },
        );
        let patches = &self.patches;
        self.guides.par_chunks_mut(CHUNK).enumerate().for_each_init(
            NeighborScratch::default,
            |scratch, (chunk, guides)| {
                for (offset, guide) in guides.iter_mut().enumerate() {
                    let face_id = chunk * CHUNK + offset;
                    *guide = best(patches, lists.of(face_id, scratch), face_id).mean;
                }
            },
        );
        &self.guides
    }
}

/// The most consistent of the patches that hold a face; of equals the first, its own last.
fn best(patches: &[Patch], neighbors: &[u32], face_id: usize) -> Patch {
    let mut best = patches[face_id];
    let mut lowest = f64::INFINITY;
    for patch in neighbors.iter().map(|&j| patches[j as usize]).chain([patches[face_id]]) {
        if patch.inconsistency < lowest {
            (lowest, best) = (patch.inconsistency, patch);
        }
    }
    best
}

/// Scratch memory of one thread.
#[derive(Default)]
struct Scratch {
    neighbors: NeighborScratch,
    members: RingScratch,
    normals: Vec<DVec3>,
}

/// H(P) and the mean normal of one face's patch.
fn measure(
    face_id: usize,
    topology: &Topology,
    lists: &NeighborLists<'_>,
    geometry: &FaceGeometry,
    scratch: &mut Scratch,
) -> Patch {
    scratch.members.begin(topology.n_faces());
    scratch.normals.clear();
    let mut sum = DVec3::ZERO;
    for j in lists.of(face_id, &mut scratch.neighbors).iter().copied().chain([face_id as u32]) {
        let normal = geometry.normals[j as usize];
        if normal != DVec3::ZERO {
            scratch.members.visit(j);
            scratch.normals.push(normal);
            sum += geometry.areas[j as usize] * normal;
        }
    }
    let mean = unit_or_zero(sum);
    if mean == DVec3::ZERO {
        return Patch { inconsistency: f64::INFINITY, mean };
    }
    let range = largest_distance(&scratch.normals);
    let saliency = relative_saliency(&scratch.members, topology, &geometry.normals);
    Patch { inconsistency: range * saliency, mean }
}

/// Φ(P): the largest distance between two normals.
fn largest_distance(normals: &[DVec3]) -> f64 {
    let step = normals.len().div_ceil(MOST_COMPARED).max(1);
    let mut largest = 0f64;
    for i in (0..normals.len()).step_by(step) {
        for j in (0..i).step_by(step) {
            largest = largest.max(normals[i].distance_squared(normals[j]));
        }
    }
    largest.sqrt()
}

/// R(P): the largest distance across an inner edge over the sum across all; 1 for a patch without inner edges, whose
/// faces touch in vertices alone.
fn relative_saliency(members: &RingScratch, topology: &Topology, normals: &[DVec3]) -> f64 {
    let (mut largest, mut sum, mut has_edge) = (0f64, 0.0, false);
    for &j in members.found() {
        for &k in topology.edge_neighbors(j as usize) {
            if k > j && members.has_seen(k) {
                let distance = normals[j as usize].distance(normals[k as usize]);
                largest = largest.max(distance);
                sum += distance;
                has_edge = true;
            }
        }
    }
    if has_edge { largest / (sum + EPSILON) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn topology_and_geometry((vertices, faces): fixtures::MeshParts) -> (Topology, FaceGeometry) {
        let geometry = FaceGeometry::compute(&vertices, &faces);
        (Topology::new(faces, vertices.len()).expect("valid"), geometry)
    }

    #[test]
    fn one_fold_by_hand() {
        // Both patches are the whole mesh: one inner edge, so R = 1 and H = Φ, the distance of the two normals.
        let (topology, geometry) = topology_and_geometry(fixtures::two_triangles());
        let mut guidance = Guidance::new(&topology);
        let guides = guidance.update(&geometry).to_vec();
        let weighted: DVec3 = geometry.normals.iter().zip(&geometry.areas).map(|(n, a)| *n * *a).sum();
        assert!(guides.iter().all(|g| g.distance(weighted.normalize()) < 1e-15));
        let expected = geometry.normals[0].distance(geometry.normals[1]);
        assert!((guidance.patches[0].inconsistency - expected).abs() < 1e-8);
    }

    #[test]
    fn faces_beside_a_fold_listen_to_their_own_side() {
        // A grid folded by 90 degrees along x = 4.
        let (mut vertices, faces) = fixtures::grid(8, 8);
        for v in &mut vertices {
            if v.x > 4.0 {
                (v.x, v.z) = (4.0, v.x - 4.0);
            }
        }
        let (topology, geometry) = topology_and_geometry((vertices, faces));
        let mut guidance = Guidance::new(&topology);
        for (guide, normal) in guidance.update(&geometry).iter().zip(&geometry.normals) {
            assert!(guide.distance(*normal) < 1e-12, "{guide} {normal}");
        }
    }

    #[test]
    fn faces_that_share_no_edge_count_in_full() {
        let (topology, geometry) = topology_and_geometry(fixtures::hourglass());
        let mut guidance = Guidance::new(&topology);
        guidance.update(&geometry);
        let expected = geometry.normals[0].distance(geometry.normals[1]);
        assert_eq!(guidance.patches[0].inconsistency, expected);
    }

    #[test]
    fn large_patches_are_sampled() {
        let normals: Vec<DVec3> =
            (0..1000).map(|i| DVec3::new(f64::from(i), 1000.0, 0.0).normalize()).collect();
        let all = normals[0].distance(normals[999]);
        let sampled = largest_distance(&normals);
        assert!(sampled <= all && sampled > 0.98 * all, "{sampled} {all}");
        assert_eq!(largest_distance(&normals[..2]), normals[0].distance_squared(normals[1]).sqrt());
        assert_eq!(largest_distance(&[]), 0.0);
    }
}
