//! The area-based edge operator D and the edges that it acts on.

use crate::face_geometry::normal_and_area;
use crate::mesh::Face;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;

/// Edges of one unit of parallel work.
const CHUNK: usize = 4096;
/// Larger weights belong to faces so thin that their angle means nothing.
const LARGEST_WEIGHT: f64 = 1e3;

/// An edge p₁p₃ between two faces, with p₂ opposite in the first and p₄ in the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stencil {
    /// Ids of p₁, p₂, p₃, p₄.
    pub vertices: [u32; 4],
    /// Whether both faces run along the edge in the same direction, so that one of their normals is to be turned.
    is_flipped: bool,
}

/// D of one edge in one iteration.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct EdgeState {
    /// Weights of p₁ … p₄ in D; zero where there is no operator.
    pub weights: [f64; 4],
    /// δ.
    pub delta: DVec3,
}

/// The edges between two faces, in the order of the faces; faces that use a vertex twice have none.
///
/// Around an edge of more than two faces each face pairs with the next.
pub(super) fn find_stencils(topology: &Topology) -> Vec<Stencil> {
    let faces = topology.faces();
    let is_proper = |[a, b, c]: Face| a != b && b != c && c != a;
    let mut stencils = Vec::new();
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
                stencils.push(Stencil { vertices: [p1, p2, p3, p4], is_flipped });
            }
        }
    }
    stencils
}

/// γ̄: the mean angle between the normals at an edge, in radians; edges beside a face without area left out.
pub(super) fn mean_dihedral_angle(stencils: &[Stencil], positions: &[DVec3]) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for stencil in stencils {
        let [p1, p2, p3, p4] = stencil.vertices.map(|v| positions[v as usize]);
        let (first, _) = normal_and_area(p1, p3, p2);
        let (second, _) =
            if stencil.is_flipped { normal_and_area(p1, p3, p4) } else { normal_and_area(p3, p1, p4) };
        if first != DVec3::ZERO && second != DVec3::ZERO {
            sum += first.angle_between(second);
            count += 1;
        }
    }
    if count == 0 { 0.0 } else { sum / count as f64 }
}

/// D and δ of all edges: δ is D where |D|² is `threshold` or more, else zero.
pub(super) fn measure_edges(
    stencils: &[Stencil],
    positions: &[DVec3],
    threshold: f64,
    edges: &mut Vec<EdgeState>,
) {
    let measure = |stencil: &Stencil| {
        let corners = stencil.vertices.map(|v| positions[v as usize]);
        let weights = operator_weights(corners);
        let bend: DVec3 = corners.iter().zip(weights).map(|(p, w)| *p * w).sum();
        EdgeState { weights, delta: if bend.length_squared() >= threshold { bend } else { DVec3::ZERO } }
    };
    stencils.par_iter().with_min_len(CHUNK).map(measure).collect_into_vec(edges);
}

/// Weights of p₁ … p₄ in D (He, Schaefer 2013, Eq. 8); all zero where they make no sense.
fn operator_weights([p1, p2, p3, p4]: [DVec3; 4]) -> [f64; 4] {
    let (_, area123) = normal_and_area(p1, p2, p3);
    let (_, area134) = normal_and_area(p1, p3, p4);
    let total = area123 + area134;
    let length2 = p1.distance_squared(p3);
    let along = |p: DVec3, q: DVec3| p.dot(q) / (length2 * total);
    let weights = [
        area123 * along(p4 - p3, p3 - p1) + area134 * along(p1 - p3, p3 - p2),
        area134 / total,
        area123 * along(p3 - p1, p1 - p4) + area134 * along(p2 - p1, p1 - p3),
        area123 / total,
    ];
    // NaN, from a total or a length of zero, is not below the limit either.
    let is_sound = area123 > 0.0 && area134 > 0.0 && weights.iter().all(|w| w.abs() < LARGEST_WEIGHT);
    if is_sound { weights } else { [0.0; 4] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn stencils((vertices, faces): fixtures::MeshParts) -> Vec<Stencil> {
        find_stencils(&Topology::new(faces, vertices.len()).expect("valid"))
    }

    #[test]
    fn every_inner_edge_has_one() {
        assert_eq!(stencils(fixtures::cube()).len(), 18);
        assert_eq!(stencils(fixtures::grid(3, 2)).len(), 7 + 6);
        assert_eq!(stencils(fixtures::three_on_an_edge()).len(), 2, "one face with the next");
        assert!(stencils(fixtures::hourglass()).is_empty());
        let [edge] = stencils(fixtures::two_triangles())[..] else { panic!("one edge") };
        assert_eq!(edge, Stencil { vertices: [1, 0, 2, 3], is_flipped: false });
    }

    #[test]
    fn degenerate_and_flipped_faces() {
        let at = |faces: Vec<Face>| find_stencils(&Topology::new(faces, 4).expect("valid"));
        assert!(at(vec![[0, 0, 1], [0, 1, 2]]).is_empty());
        assert_eq!(at(vec![[0, 1, 2], [0, 1, 3]]), [Stencil { vertices: [0, 2, 1, 3], is_flipped: true }]);
    }

    #[test]
    fn weights_by_hand_on_a_square() {
        // Diagonal of a unit square: both areas 1/2, |e|² = 2.
        let weights = operator_weights([DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]);
        assert_eq!(weights, [-0.5, 0.5, -0.5, 0.5]);
    }

    #[test]
    fn the_operator_vanishes_on_planes_alone() {
        let flat = [(0.1, 0.2), (2.0, -0.7), (1.5, 1.1), (-0.9, 0.8)].map(|(x, y)| DVec3::new(x, y, 0.3));
        let bend = |corners: [DVec3; 4]| -> DVec3 {
            corners.iter().zip(operator_weights(corners)).map(|(p, w)| *p * w).sum()
        };
        assert!(bend(flat).length() < 1e-15);
        let mut folded = flat;
        folded[3].z += 0.5;
        assert!(bend(folded).length() > 0.1);
    }

    #[test]
    fn thin_and_empty_faces_have_no_operator() {
        let p = DVec3::new;
        for fourth in [p(0.5, 0.0, 0.0), p(0.0, 0.0, 0.0)] {
            assert_eq!(operator_weights([p(0., 0., 0.), p(0., 1., 0.), p(1., 0., 0.), fourth]), [0.0; 4]);
        }
        let (a, b) = (p(0.0, 0.0, 0.0), p(1e-9, 0.0, 0.0));
        assert_eq!(operator_weights([a, p(1.0, 1.0, 0.0), b, p(1.0, -1.0, 0.0)]), [0.0; 4]);
    }

    #[test]
    fn angles_are_averaged_without_sign() {
        let (vertices, faces) = fixtures::cube();
        let topology = Topology::new(faces, 8).expect("valid");
        let expected = 12.0 / 18.0 * std::f64::consts::FRAC_PI_2;
        assert!((mean_dihedral_angle(&find_stencils(&topology), &vertices) - expected).abs() < 1e-7);
        let flat = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(0.3, -1.0, 0.0)];
        let flipped = [Stencil { vertices: [0, 2, 1, 3], is_flipped: true }];
        assert!((mean_dihedral_angle(&flipped, &flat) - std::f64::consts::PI).abs() < 1e-7);
    }
}
