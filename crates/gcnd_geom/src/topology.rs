//! Adjacency of a triangle mesh in compressed rows. No coordinates here.
//!
//! Boundaries, non-manifold edges and vertices, repeated faces and faces that use a vertex twice are all
//! represented as they are; nothing is repaired and nothing is refused.

use crate::csr::Csr;
use crate::error::Result;
use crate::mesh::{Face, check_faces};
use rayon::prelude::*;

/// Who touches whom: vertex → faces and face → faces across an edge.
///
/// Built once for a mesh and shared by every stage, since denoising never changes faces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topology {
    faces: Vec<Face>,
    vertex_faces: Csr,
    edge_neighbors: Csr,
}

impl Topology {
    /// Builds the adjacency of `faces` (F) over vertex ids `0..n_vertices`.
    ///
    /// # Errors
    /// [`crate::GeomError::IndexOutOfRange`] when a face names a vertex that does not exist,
    /// [`crate::GeomError::TooLarge`] when ids do not fit in 32 bits.
    ///
    /// ```
    /// use gcnd_geom::Topology;
    /// let topology = Topology::new(vec![[0, 1, 2], [2, 1, 3]], 4)?;
    /// assert_eq!(topology.edge_neighbors(0), [1]);
    /// # Ok::<(), gcnd_geom::GeomError>(())
    /// ```
    pub fn new(faces: Vec<Face>, n_vertices: usize) -> Result<Self> {
        check_faces(&faces, n_vertices)?;
        let vertex_faces = Csr::from_pairs(n_vertices, corner_pairs(&faces));
        let edge_neighbors = build_edge_neighbors(&faces, &vertex_faces);
        Ok(Self { faces, vertex_faces, edge_neighbors })
    }

    /// The faces as given (F).
    pub fn faces(&self) -> &[Face] {
        &self.faces
    }

    /// How many faces there are.
    pub fn n_faces(&self) -> usize {
        self.faces.len()
    }

    /// How many vertex ids there are, isolated ones included.
    pub fn n_vertices(&self) -> usize {
        self.vertex_faces.n_rows()
    }

    /// Vertex → the faces that use it, ascending, each once.
    pub fn vertex_faces(&self) -> &Csr {
        &self.vertex_faces
    }

    /// Faces that share an edge with `face_id` (`EdgeNeighbors`), in the order of the face's edges.
    ///
    /// Three inside a manifold, fewer at a boundary, more at a non-manifold edge; each face once.
    pub fn edge_neighbors(&self, face_id: usize) -> &[u32] {
        self.edge_neighbors.row(face_id)
    }

    /// All edge neighbours: row `i` is [`Topology::edge_neighbors`]`(i)`.
    pub fn edge_neighbor_rows(&self) -> &Csr {
        &self.edge_neighbors
    }

    /// The edges that one face alone uses, from start to end as that face runs through them.
    pub fn boundary_edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.faces.iter().enumerate().flat_map(move |(face_id, face)| {
            (0..3).map(|edge| [face[edge], face[(edge + 1) % 3]]).filter(move |&[a, b]| {
                let shares = |&f: &u32| {
                    let other = &self.faces[f as usize];
                    other.contains(&a) && other.contains(&b)
                };
                a != b && !self.edge_neighbors(face_id).iter().any(shares)
            })
        })
    }

    /// Whether each vertex lies on a boundary: on one of [`Topology::boundary_edges`] (V).
    pub fn boundary_vertices(&self) -> Vec<bool> {
        let mut is_boundary = vec![false; self.n_vertices()];
        for vertex_id in self.boundary_edges().flatten() {
            is_boundary[vertex_id as usize] = true;
        }
        is_boundary
    }

    /// Faces that share at least one vertex with `face_id` (`VertexNeighbors`), ascending, without itself.
    pub fn vertex_neighbors<'s>(&self, face_id: usize, scratch: &'s mut RingScratch) -> &'s [u32] {
        self.ring(face_id, 1, scratch)
    }

    /// Faces reached from `face_id` by at most `n` steps across shared vertices (`Ring(n)`), ascending,
    /// without itself.
    ///
    /// `scratch` is reused between calls to avoid allocation; any one made by [`RingScratch::new`] will do.
    pub fn ring<'s>(&self, face_id: usize, n: usize, scratch: &'s mut RingScratch) -> &'s [u32] {
        scratch.begin(self.n_faces());
        scratch.visit(face_id as u32);
        let mut frontier_start = 0;
        for _ in 0..n {
            let frontier_end = scratch.found.len();
            for slot in frontier_start..frontier_end {
                for vertex_id in self.faces[scratch.found[slot] as usize] {
                    for &neighbor in self.vertex_faces.row(vertex_id as usize) {
                        scratch.visit(neighbor);
                    }
                }
            }
            frontier_start = frontier_end;
        }
        scratch.found.swap_remove(0);
        scratch.found.sort_unstable();
        &scratch.found
    }
}

/// Scratch memory of one thread for ring queries: which faces a query has seen.
#[derive(Debug, Clone, Default)]
pub struct RingScratch {
    stamp_of_face: Vec<u32>,
    stamp: u32,
    found: Vec<u32>,
}

impl RingScratch {
    /// Empty scratch; it grows to the mesh's number of faces at the first query.
    pub fn new() -> Self {
        Self::default()
    }

    /// Forgets the last query, in constant time.
    pub fn begin(&mut self, n_faces: usize) {
        if self.stamp_of_face.len() < n_faces {
            self.stamp_of_face.resize(n_faces, 0);
        }
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.stamp_of_face.fill(0);
            self.stamp = 1;
        }
        self.found.clear();
    }

    /// Adds a face if this query has not seen it; says whether it was new.
    #[inline]
    pub fn visit(&mut self, face_id: u32) -> bool {
        let stamp = &mut self.stamp_of_face[face_id as usize];
        let is_new = *stamp != self.stamp;
        if is_new {
            *stamp = self.stamp;
            self.found.push(face_id);
        }
        is_new
    }

    /// Whether this query has seen a face.
    #[inline]
    pub fn has_seen(&self, face_id: u32) -> bool {
        self.stamp_of_face[face_id as usize] == self.stamp
    }

    /// The faces seen by this query, in the order of discovery.
    pub fn found(&self) -> &[u32] {
        &self.found
    }
}

/// `(vertex, face)` for each corner, a vertex that a face uses twice only once.
fn corner_pairs(faces: &[Face]) -> impl Iterator<Item = (u32, u32)> + Clone + '_ {
    (0u32..).zip(faces).flat_map(|(face_id, &[a, b, c])| {
        let keep = [true, b != a, c != a && c != b];
        [a, b, c].into_iter().zip(keep).filter(|&(_, k)| k).map(move |(v, _)| (v, face_id))
    })
}

fn build_edge_neighbors(faces: &[Face], vertex_faces: &Csr) -> Csr {
    const CHUNK: usize = 4096;
    let chunks: Vec<(Vec<u32>, Vec<u32>)> = faces
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, rows)| {
            let mut lengths = Vec::with_capacity(rows.len());
            let mut values = Vec::with_capacity(rows.len() * 3);
            for (offset, face) in rows.iter().enumerate() {
                let start = values.len();
                let face_id = (chunk * CHUNK + offset) as u32;
                push_edge_neighbors(face_id, face, faces, vertex_faces, &mut values);
                lengths.push((values.len() - start) as u32);
            }
            (lengths, values)
        })
        .collect();
    let lengths: Vec<u32> = chunks.iter().flat_map(|(lengths, _)| lengths.iter().copied()).collect();
    Csr::from_lengths(&lengths, chunks.into_iter().flat_map(|(_, values)| values).collect())
}

/// Appends the faces across each edge of one face; scans the shorter of the edge's two vertex stars, so
/// that a hub vertex of high degree costs nothing extra.
fn push_edge_neighbors(face_id: u32, face: &Face, faces: &[Face], vertex_faces: &Csr, values: &mut Vec<u32>) {
    let start = values.len();
    for edge in 0..3 {
        let (a, b) = (face[edge], face[(edge + 1) % 3]);
        if a == b {
            continue;
        }
        let (star_a, star_b) = (vertex_faces.row(a as usize), vertex_faces.row(b as usize));
        let (star, other) = if star_a.len() <= star_b.len() { (star_a, b) } else { (star_b, a) };
        for &neighbor in star {
            let shares_edge = neighbor != face_id && faces[neighbor as usize].contains(&other);
            if shares_edge && !values[start..].contains(&neighbor) {
                values.push(neighbor);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn topology((vertices, faces): (Vec<glam::DVec3>, Vec<Face>)) -> Topology {
        Topology::new(faces, vertices.len()).expect("fixtures are valid")
    }

    #[test]
    fn tetrahedron_faces_all_touch() {
        let t = topology(fixtures::tetrahedron());
        for face_id in 0..4u32 {
            let mut row = t.edge_neighbors(face_id as usize).to_vec();
            row.sort_unstable();
            assert_eq!(row, (0..4).filter(|&f| f != face_id).collect::<Vec<_>>());
        }
    }

    #[test]
    fn open_fan_ends_at_its_rim() {
        let t = topology(fixtures::open_fan());
        assert_eq!(t.edge_neighbors(0), [1]);
        assert_eq!(t.edge_neighbors(1), [0, 2]);
        assert_eq!(t.vertex_neighbors(0, &mut RingScratch::new()), [1, 2, 3]);
    }

    #[test]
    fn three_faces_on_one_edge_see_each_other() {
        let t = topology(fixtures::three_on_an_edge());
        for face_id in 0..3 {
            assert_eq!(t.edge_neighbors(face_id).len(), 2);
        }
    }

    #[test]
    fn hourglass_shares_a_vertex_but_no_edge() {
        let t = topology(fixtures::hourglass());
        assert!(t.edge_neighbors(0).is_empty());
        assert_eq!(t.vertex_neighbors(0, &mut RingScratch::new()), [1]);
    }

    #[test]
    fn boundary_vertices_lie_on_edges_of_one_face() {
        let inside = |mesh| {
            let is_boundary = topology(mesh).boundary_vertices();
            (0..is_boundary.len()).filter(|&v| !is_boundary[v]).collect::<Vec<_>>()
        };
        assert_eq!(inside(fixtures::tetrahedron()), [0, 1, 2, 3]);
        assert_eq!(inside(fixtures::grid(2, 3)), [4, 7]);
        assert!(inside(fixtures::open_fan()).is_empty(), "the hub is on the two rim edges");
        assert!(inside(fixtures::three_on_an_edge()).is_empty());
        let with_isolated = Topology::new(vec![[0, 1, 2], [0, 1, 2]], 4).expect("valid ids");
        assert_eq!(with_isolated.boundary_vertices(), [false; 4], "two equal faces close each other");
    }

    #[test]
    fn moebius_strip_closes() {
        let t = topology(fixtures::moebius());
        assert!((0..t.n_faces()).all(|f| t.edge_neighbors(f).len() == 2));
    }

    #[test]
    fn degenerate_and_duplicate_faces_are_kept_apart() {
        let t = Topology::new(vec![[0, 0, 1], [0, 1, 2], [0, 1, 2]], 3).expect("valid ids");
        assert_eq!(t.vertex_faces().row(0), [0, 1, 2]);
        assert_eq!(t.edge_neighbors(1), [0, 2]);
    }

    #[test]
    fn two_rings_of_a_grid_face() {
        let t = topology(fixtures::grid(6, 6));
        let mut scratch = RingScratch::new();
        let one: Vec<u32> = t.ring(30, 1, &mut scratch).to_vec();
        let two: Vec<u32> = t.ring(30, 2, &mut scratch).to_vec();
        assert_eq!(one.len(), 12, "an interior face of a regular grid has 12 vertex neighbours");
        assert!(one.iter().all(|f| two.contains(f)) && two.len() > one.len());
        assert!(!two.contains(&30));
    }

    #[test]
    fn index_out_of_range_is_refused() {
        let error = Topology::new(vec![[0, 1, 2], [0, 1, 7]], 3).unwrap_err();
        assert_eq!(error, crate::GeomError::IndexOutOfRange { face_id: 1, vertex_id: 7, n_vertices: 3 });
    }
}
