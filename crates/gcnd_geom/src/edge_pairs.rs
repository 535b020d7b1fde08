//! The edges between two faces, each once: what the filters on edges work on.

use crate::mesh::Face;
use crate::topology::Topology;

/// An edge p₁p₃ between two faces, with p₂ opposite in the first and p₄ in the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct EdgePair {
    /// Ids of the first face and the second.
    pub faces: [u32; 2],
    /// Ids of p₁, p₂, p₃, p₄.
    pub vertices: [u32; 4],
    /// Whether both faces run along the edge in the same direction, so that one of their normals is to be turned.
    pub is_flipped: bool,
}

/// The edges between two faces, in the order of the faces; faces that use a vertex twice have none.
///
/// Around an edge of more than two faces each face pairs with the next.
pub(crate) fn find_edge_pairs(topology: &Topology) -> Vec<EdgePair> {
    let faces = topology.faces();
    let is_proper = |[a, b, c]: Face| a != b && b != c && c != a;
    let mut pairs = Vec::new();
    for (face_id, &face) in faces.iter().enumerate().filter(|(_, face)| is_proper(**face)) {
        for corner in 0..3 {
            let [p1, p3, p2] = [face[corner], face[(corner + 1) % 3], face[(corner + 2) % 3]];
            let shares_edge = |&&other: &&u32| {
                let other_face = faces[other as usize];
                other as usize > face_id
                    && is_proper(other_face)
                    && other_face.contains(&p1)
                    && other_face.contains(&p3)
            };
            if let Some(&next) = topology.edge_neighbors(face_id).iter().filter(shares_edge).min() {
                let other = faces[next as usize];
                let Some(p4) = other.into_iter().find(|v| ![p1, p3].contains(v)) else { continue };
                let is_flipped = (0..3).any(|c| other[c] == p1 && other[(c + 1) % 3] == p3);
                pairs.push(EdgePair {
                    faces: [face_id as u32, next],
                    vertices: [p1, p2, p3, p4],
                    is_flipped,
                });
            }
        }
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn pairs((vertices, faces): fixtures::MeshParts) -> Vec<EdgePair> {
        find_edge_pairs(&Topology::new(faces, vertices.len()).expect("valid"))
    }

    #[test]
    fn every_inner_edge_has_one() {
        assert_eq!(pairs(fixtures::cube()).len(), 18);
        assert_eq!(pairs(fixtures::grid(3, 2)).len(), 7 + 6);
        let shared = pairs(fixtures::three_on_an_edge());
        let faces: Vec<_> = shared.iter().map(|pair| pair.faces).collect();
        assert_eq!(faces, [[0, 1], [1, 2]], "one face with the next");
        assert!(pairs(fixtures::hourglass()).is_empty());
        let [edge] = pairs(fixtures::two_triangles())[..] else { panic!("one edge") };
        assert_eq!(edge, EdgePair { faces: [0, 1], vertices: [1, 0, 2, 3], is_flipped: false });
    }

    #[test]
    fn degenerate_and_flipped_faces() {
        let at = |faces: Vec<Face>| find_edge_pairs(&Topology::new(faces, 4).expect("valid"));
        assert!(at(vec![[0, 0, 1], [0, 1, 2]]).is_empty());
        let flipped = EdgePair { faces: [0, 1], vertices: [0, 2, 1, 3], is_flipped: true };
        assert_eq!(at(vec![[0, 1, 2], [0, 1, 3]]), [flipped]);
    }
}
