//! The area-based edge operator D.

use crate::edge_pairs::EdgePair;
use crate::face_geometry::normal_and_area;
use glam::DVec3;
use rayon::prelude::*;

/// Edges of one unit of parallel work.
const CHUNK: usize = 4096;
/// Larger weights belong to faces so thin that their angle means nothing.
const LARGEST_WEIGHT: f64 = 1e3;

/// D of one edge in one iteration.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct EdgeState {
    /// Weights of p₁ … p₄ in D; zero where there is no operator.
    pub weights: [f64; 4],
    /// δ.
    pub delta: DVec3,
}

/// γ̄: the mean angle between the normals at an edge, in radians; edges beside a face without area left out.
pub(super) fn mean_dihedral_angle(stencils: &[EdgePair], positions: &[DVec3]) -> f64 {
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
    stencils: &[EdgePair],
    positions: &[DVec3],
    threshold: f64,
    edges: &mut Vec<EdgeState>,
) {
    let measure = |stencil: &EdgePair| {
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
    use crate::edge_pairs::find_edge_pairs;
    use crate::{Topology, fixtures};

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
        assert!((mean_dihedral_angle(&find_edge_pairs(&topology), &vertices) - expected).abs() < 1e-7);
        let flat = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(0.3, -1.0, 0.0)];
        let flipped = [EdgePair { faces: [0, 1], vertices: [0, 2, 1, 3], is_flipped: true }];
        assert!((mean_dihedral_angle(&flipped, &flat) - std::f64::consts::PI).abs() < 1e-7);
    }
}
