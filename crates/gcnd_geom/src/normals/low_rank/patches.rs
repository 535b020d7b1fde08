//! Patches of vertices: who belongs to them, in which frame they stand, and which of them are alike.

use crate::patch::symmetric_eigen::{Symmetric3, symmetric_eigen};
use crate::topology::{RingScratch, Topology};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Vertices of one unit of parallel work.
const CHUNK: usize = 256;
/// So many vertices around one are looked at, at most; ten rings of a mesh hold 300 to 800.
const MOST_AROUND: usize = 1024;
/// Covariances whose squared distance is below this differ by rounding alone.
const SAME: f64 = 1e-12;

/// The patches of all vertices.
pub(crate) struct Patches {
    size: usize,
    /// A row of `size` vertices for each vertex, of which the first `lengths` count.
    members: Vec<u32>,
    shapes: Vec<Shape>,
}

/// What is known of a patch as a whole.
#[derive(Debug, Clone, Copy)]
struct Shape {
    length: u32,
    /// e₁ along the normals, e₂ along their largest change, e₁ × e₂.
    world_from_patch: DMat3,
    /// Σ Rᵀ(n − n̄)(n − n̄)ᵀR of the vertex normals and of the guidance.
    covariances: [Symmetric3; 2],
}

impl Patches {
    /// Finds the patches of `size` vertices for given vertex normals and guidance, unit or zero (V).
    pub fn new(
        topology: &Topology,
        positions: &[DVec3],
        normals: &[DVec3],
        guides: &[DVec3],
        size: usize,
    ) -> Self {
        let unknown =
            Shape { length: 0, world_from_patch: DMat3::IDENTITY, covariances: [Symmetric3::default(); 2] };
        let mut members = vec![0; size * positions.len()];
        let mut shapes = vec![unknown; positions.len()];
        let chunks = members.par_chunks_mut(size * CHUNK).zip(shapes.par_chunks_mut(CHUNK));
        chunks.enumerate().for_each_init(Around::default, |around, (chunk, (members, shapes))| {
            for (offset, (row, shape)) in members.chunks_mut(size).zip(shapes).enumerate() {
                let center = chunk * CHUNK + offset;
                around.grow(topology, center, usize::MAX, size);
                let found = around.nearest(positions, center, size);
                let frame = frame(found, guides);
                around.order_rings(positions, center, frame);
                let found = &around.found;
                row[..found.len()].copy_from_slice(found);
                let covariances = [normals, guides].map(|normals| covariance(found, normals, frame));
                *shape = Shape { length: found.len() as u32, world_from_patch: frame, covariances };
            }
        });
        Self { size, members, shapes }
    }

    /// The vertices of a patch, ring by ring, its own first.
    pub fn members(&self, vertex_id: usize) -> &[u32] {
        &self.members[vertex_id * self.size..][..self.shapes[vertex_id].length as usize]
    }

    /// A patch's frame, as columns.
    pub fn world_from_patch(&self, vertex_id: usize) -> DMat3 {
        self.shapes[vertex_id].world_from_patch
    }

    /// Appends the `count` patches of the same length that are most like a vertex's own within `rings` steps: its own,
    /// then by likeness, equals by distance in steps.
    pub fn find_alike(
        &self,
        topology: &Topology,
        vertex_id: usize,
        rings: usize,
        count: usize,
        around: &mut Around,
    ) -> Vec<u32> {
        around.grow(topology, vertex_id, rings, MOST_AROUND);
        let own = &self.shapes[vertex_id];
        let candidates = around.found.iter().zip(0u32..).skip(1);
        let mut others: Vec<(f64, u32, u32)> = candidates
            .map(|(&other, slot)| (self.shapes[other as usize], slot, other))
            .filter(|(shape, ..)| shape.length == own.length)
            .map(|(shape, slot, other)| (own.unlikeness(&shape), slot, other))
            .collect();
        let by_likeness = |a: &(f64, u32, u32), b: &(f64, u32, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let wanted = count - 1;
        if others.len() > wanted {
            if wanted > 0 {
                others.select_nth_unstable_by(wanted - 1, by_likeness);
            }
            others.truncate(wanted);
        }
        others.sort_unstable_by(by_likeness);
        [vertex_id as u32].into_iter().chain(others.iter().map(|(.., other)| *other)).collect()
    }
}

impl Shape {
    /// |C − C'|² · |C_g − C'_g|².
    fn unlikeness(&self, other: &Self) -> f64 {
        let distance = |i: usize| {
            let (a, b) = (&self.covariances[i], &other.covariances[i]);
            let diagonal = (a.diagonal - b.diagonal).length_squared();
            (diagonal + 2.0 * (a.off_diagonal - b.off_diagonal).length_squared()).max(SAME)
        };
        distance(0) * distance(1)
    }
}

/// The vertices around one, in rings of equal distance in steps across faces; reused between queries.
#[derive(Default)]
pub(crate) struct Around {
    scratch: RingScratch,
    /// Ring after ring; within a ring in the order in which faces name them, so that vertex ids do not matter.
    found: Vec<u32>,
    /// Where each ring ends.
    ends: Vec<usize>,
    keys: Vec<(f64, u32)>,
}

impl Around {
    /// Finds whole rings around a vertex, itself the first, until there are `enough` vertices or `rings` around it;
    /// breaks a ring off at 1024 vertices in all.
    fn grow(&mut self, topology: &Topology, vertex_id: usize, rings: usize, enough: usize) {
        let scratch = &mut self.scratch;
        scratch.begin(topology.n_vertices());
        scratch.visit(vertex_id as u32);
        self.ends.clear();
        self.ends.push(1);
        let mut ring = 0..1;
        'rings: for _ in 0..rings {
            for slot in ring.clone() {
                for &face_id in topology.vertex_faces().row(scratch.found()[slot] as usize) {
                    for neighbor in topology.faces()[face_id as usize] {
                        scratch.visit(neighbor);
                        if scratch.found().len() == MOST_AROUND {
                            break 'rings;
                        }
                    }
                }
            }
            ring = ring.end..scratch.found().len();
            if ring.is_empty() {
                break;
            }
            self.ends.push(ring.end);
            if ring.end >= enough {
                break;
            }
        }
        self.found.clear();
        self.found.extend_from_slice(scratch.found());
        if self.ends.last() != Some(&self.found.len()) {
            self.ends.push(self.found.len());
        }
    }

    /// Keeps `size` vertices: of the last ring those nearest to the centre.
    fn nearest(&mut self, positions: &[DVec3], center: usize, size: usize) -> &[u32] {
        if self.found.len() > size {
            let last = self.ends[self.ends.len() - 2].min(size)..self.found.len();
            self.order(last, |v| positions[v as usize].distance_squared(positions[center]));
            self.found.truncate(size);
        }
        &self.found
    }

    /// Orders each ring by the angle around the frame's first axis, from the second.
    fn order_rings(&mut self, positions: &[DVec3], center: usize, world_from_patch: DMat3) {
        let patch_from_world = world_from_patch.transpose();
        let angle = |v: u32| {
            let way = patch_from_world * (positions[v as usize] - positions[center]);
            way.z.atan2(way.y)
        };
        for ring in 1..self.ends.len() {
            let end = self.ends[ring].min(self.found.len());
            self.order(self.ends[ring - 1].min(end)..end, angle);
        }
    }

    /// Sorts some of the vertices by a key, equals as they are.
    fn order(&mut self, slots: std::ops::Range<usize>, key: impl Fn(u32) -> f64) {
        self.keys.clear();
        self.keys.extend(self.found[slots.clone()].iter().map(|&v| (key(v), v)));
        self.keys.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.found[slots].iter_mut().zip(&self.keys).for_each(|(v, key)| *v = key.1);
    }
}

/// The eigenvectors of Σ g gᵀ as columns; the first points along Σ g, and Σ (g·e₂)³ ≥ 0.
fn frame(members: &[u32], guides: &[DVec3]) -> DMat3 {
    let mut squares = Symmetric3::default();
    let guides = members.iter().map(|&v| guides[v as usize]);
    guides.clone().for_each(|g| squares.add_outer(1.0, g));
    let [first, second, _] = symmetric_eigen(&squares).vectors;
    let first = if guides.clone().sum::<DVec3>().dot(first) < 0.0 { -first } else { first };
    let skew: f64 = guides.map(|g| g.dot(second).powi(3)).sum();
    let second = if skew < 0.0 { -second } else { second };
    DMat3::from_cols(first, second, first.cross(second))
}

/// Σ Rᵀ(n − n̄)(n − n̄)ᵀR, with n̄ the unit mean.
fn covariance(members: &[u32], normals: &[DVec3], world_from_patch: DMat3) -> Symmetric3 {
    let normals = members.iter().map(|&v| normals[v as usize]);
    let mean = normals.clone().sum::<DVec3>().normalize_or_zero();
    let patch_from_world = world_from_patch.transpose();
    let mut covariance = Symmetric3::default();
    normals.for_each(|n| covariance.add_outer(1.0, patch_from_world * (n - mean)));
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn flat_patches(mesh: &fixtures::MeshParts, size: usize) -> (Topology, Patches) {
        let (vertices, faces) = mesh;
        let topology = Topology::new(faces.clone(), vertices.len()).expect("valid");
        let normals = vec![DVec3::Z; vertices.len()];
        let patches = Patches::new(&topology, vertices, &normals, &normals, size);
        (topology, patches)
    }

    #[test]
    fn rings_of_a_grid_vertex() {
        let (vertices, faces) = fixtures::grid(4, 4);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let mut around = Around::default();
        around.grow(&topology, 12, 1, usize::MAX);
        let mut found = around.found.clone();
        found.sort_unstable();
        assert_eq!((found, around.ends.clone()), (vec![6, 7, 11, 12, 13, 17, 18], vec![1, 7]));
        around.grow(&topology, 12, 9, usize::MAX);
        assert_eq!(around.ends, [1, 7, 19, 23, 25], "corners across the diagonals are four steps away");
    }

    #[test]
    fn the_last_ring_gives_its_nearest_in_order_of_angle() {
        let (_, patches) = flat_patches(&fixtures::grid(4, 4), 5);
        // The neighbours across diagonals, 6 and 18, are farther.
        let members = patches.members(12);
        let around: Vec<u32> = members[1..].iter().chain(&members[1..]).copied().collect();
        assert_eq!(members[0], 12);
        assert!(around.windows(4).any(|ring| ring == [7, 13, 17, 11]), "{members:?}");
    }

    #[test]
    fn equal_patches_rank_by_steps() {
        let (topology, patches) = flat_patches(&fixtures::grid(6, 6), 7);
        let mut alike = patches.find_alike(&topology, 24, 2, 7, &mut Around::default());
        assert_eq!(alike[0], 24);
        alike.sort_unstable();
        assert_eq!(alike, [16, 17, 23, 24, 25, 31, 32], "a vertex and its first ring");
        assert_eq!(patches.find_alike(&topology, 24, 2, 1, &mut Around::default()), [24]);
    }

    #[test]
    fn small_components_and_lone_vertices_are_patches() {
        let (mut vertices, faces) = fixtures::tetrahedron();
        vertices.push(DVec3::ONE);
        let (topology, patches) = flat_patches(&(vertices, faces), 50);
        assert_eq!(patches.members(2).len(), 4);
        assert_eq!(patches.find_alike(&topology, 2, 10, 10, &mut Around::default()).len(), 4);
        assert_eq!(patches.members(4), [4]);
        assert_eq!(patches.find_alike(&topology, 4, 10, 10, &mut Around::default()), [4]);
    }

    #[test]
    fn a_hub_is_searched_in_part() {
        let rim = 3000;
        let faces = (1..rim).map(|i| [0, i, i + 1]).collect();
        let topology = Topology::new(faces, rim as usize + 1).expect("valid");
        let mut around = Around::default();
        around.grow(&topology, 5, 10, usize::MAX);
        assert_eq!((around.found.len(), around.ends.last()), (MOST_AROUND, Some(&MOST_AROUND)));
    }

    #[test]
    fn the_frame_of_a_fold_by_hand() {
        // Two normals up, one to the side: Σ g gᵀ = diag(1, 0, 2), and Σ (g·x)³ > 0.
        let guides = [DVec3::Z, DVec3::Z, DVec3::X];
        let frame = frame(&[0, 1, 2], &guides);
        assert!(frame.abs_diff_eq(DMat3::from_cols(DVec3::Z, DVec3::X, DVec3::Y), 1e-15), "{frame}");
        // n̄ = (1, 0, 2)/√5, in the frame (2, 1, 0)/√5.
        let mean = DVec3::new(2.0, 1.0, 0.0) / 5f64.sqrt();
        let mut expected = Symmetric3::default();
        [DVec3::X, DVec3::X, DVec3::Y].iter().for_each(|n| expected.add_outer(1.0, n - mean));
        let found = covariance(&[0, 1, 2], &guides, frame);
        assert!((found.diagonal - expected.diagonal).length() < 1e-14);
        assert!((found.off_diagonal - expected.off_diagonal).length() < 1e-14);
    }
}
