//! The slope of a quantity that is known by its jumps at a face's edges, in the plane of the face.

use super::operator::Edge;
use crate::csr::Csr;
use crate::edge_pairs::EdgePair;
use crate::face_geometry::FaceGeometry;
use crate::topology::Topology;
use glam::{DMat2, DVec2, DVec3};
use rayon::prelude::*;

/// A gradient counts as known if its two directions are, the weaker one at least by this fraction.
const LEAST_RATIO: f64 = 1e-3;

/// An edge seen from one of its faces, in the frame of that face.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Side {
    /// Along the edge, from p₁ to p₃.
    pub along: DVec2,
    /// Across the edge, from the first face to the second.
    pub across: DVec2,
    /// From this face's centroid to the other's, the other face unfolded into this one's plane.
    to_other: DVec2,
}

/// For every face the least-squares gradient G of V: Σ_e len_e / |d_e| · (G · d_e − V_e)² is least, with d_e the way to
/// the other face's centroid and V_e counted outwards.
pub(super) struct FaceGradients<'a> {
    edges: &'a [Edge],
    /// Of edge e, at 2 e from its first face, at 2 e + 1 from the second.
    sides: Vec<Side>,
    /// The inverse of Σ_e len_e / |d_e| · d_e d_eᵀ; `None` where one direction is unknown.
    inverses: Vec<Option<DMat2>>,
}

impl<'a> FaceGradients<'a> {
    pub fn new(
        topology: &Topology,
        positions: &[DVec3],
        geometry: &FaceGeometry,
        unit: f64,
        pairs: &[EdgePair],
        edges: &'a [Edge],
        face_edges: &Csr,
    ) -> Self {
        let frame_of = |face: usize| {
            let [a, b, _] = topology.faces()[face].map(|v| positions[v as usize]);
            let normal = geometry.normals[face];
            let x = (b - a).normalize_or_zero();
            [x, normal.cross(x)]
        };
        let sides: Vec<Side> = pairs
            .par_iter()
            .zip(edges)
            .flat_map_iter(|(pair, edge)| {
                let frames = pair.faces.map(|f| frame_of(f as usize));
                if edge.has_slope {
                    unfold(pair, positions, geometry, frames, unit)
                } else {
                    Default::default()
                }
            })
            .collect();
        let inverse_of = |face: usize| {
            let mut sum = DMat2::ZERO;
            for &slot in face_edges.row(face) {
                let d = sides[slot as usize].to_other;
                sum +=
                    least_squares_weight(&edges[slot as usize / 2], d) * DMat2::from_cols(d.x * d, d.y * d);
            }
            let trace = sum.x_axis.x + sum.y_axis.y;
            (sum.determinant() > LEAST_RATIO * trace * trace).then(|| sum.inverse())
        };
        let inverses = (0..topology.n_faces()).into_par_iter().map(inverse_of).collect();
        Self { edges, sides, inverses }
    }

    pub fn side(&self, slot: usize) -> &Side {
        &self.sides[slot]
    }

    /// Whether a face's gradient is known in both directions.
    pub fn is_known(&self, face: usize) -> bool {
        self.inverses[face].is_some()
    }

    /// What V of the edge at `slot` adds to the gradient of the face it is seen from; zero for an unknown gradient.
    pub fn weight(&self, face: usize, slot: usize) -> DVec2 {
        let edge = &self.edges[slot / 2];
        let d = self.sides[slot].to_other;
        let outwards = if slot.is_multiple_of(2) { 1.0 } else { -edge.turn };
        self.inverses[face].map_or(DVec2::ZERO, |m| m * d * (outwards * least_squares_weight(edge, d)))
    }
}

/// len_e / |d_e|, or zero for an edge without slope.
fn least_squares_weight(edge: &Edge, to_other: DVec2) -> f64 {
    let distance = to_other.length();
    if distance > 0.0 { edge.length / distance } else { 0.0 }
}

/// Both sides of an edge between faces that have an area.
fn unfold(
    pair: &EdgePair,
    positions: &[DVec3],
    geometry: &FaceGeometry,
    frames: [[DVec3; 2]; 2],
    unit: f64,
) -> [Side; 2] {
    let [start, _, end, _] = pair.vertices.map(|v| positions[v as usize]);
    let length = start.distance(end);
    let direction = (end - start) / length;
    let [first, second] = pair.faces.map(|f| {
        let from_start = geometry.centroids[f as usize] - start;
        // Where the centroid lies along the edge, and how far from it: a third of the height.
        (from_start, from_start.dot(direction), 2.0 * geometry.areas[f as usize] / (3.0 * length))
    });
    let (dx, dy) = ((second.1 - first.1) * unit, (first.2 + second.2) * unit);
    let side_of = |[x, y]: [DVec3; 2], from_start: DVec3, towards: f64| {
        let along = DVec2::new(direction.dot(x), direction.dot(y)).normalize_or_zero();
        let inwards = DVec2::new(from_start.dot(x), from_start.dot(y)).dot(along.perp());
        let across = along.perp() * (-towards * inwards.signum());
        Side { along, across, to_other: towards * (dx * along + dy * across) }
    };
    [side_of(frames[0], first.0, 1.0), side_of(frames[1], second.0, -1.0)]
}
