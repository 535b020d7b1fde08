//! The first- and second-order difference operators of face normals, and their adjoints.

use super::gradient::{FaceGradients, Side};
use crate::csr::Csr;
use crate::edge_pairs::{EdgePair, find_edge_pairs};
use crate::face_geometry::{FaceGeometry, mean_edge_length};
use crate::normals::kernel::CHUNK;
use crate::topology::Topology;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Lengths, over the mean, are taken as at least this, so that no equation is empty.
const LEAST_LENGTH: f64 = 1e-6;
/// Larger weights belong to faces so thin that their gradient means nothing.
const LARGEST_WEIGHT: f64 = 1e3;

/// An edge between two faces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Edge {
    pub faces: [u32; 2],
    /// −1 where the second face is turned over against the first, else 1.
    pub turn: f64,
    /// Length over the mean of all edges.
    pub length: f64,
    /// Whether both faces have an area, so that V is a number and not zero here.
    pub has_slope: bool,
}

/// Sparse rows whose weights are pairs: one part along the row's edge, one across.
#[derive(Debug, Default)]
pub(super) struct Rows {
    starts: Vec<usize>,
    ids: Vec<u32>,
    weights: Vec<DVec2>,
}

impl Rows {
    /// Ids and weights of one row.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (usize, DVec2)> {
        let range = self.starts[row]..self.starts[row + 1];
        self.ids[range.clone()].iter().map(|id| *id as usize).zip(self.weights[range].iter().copied())
    }

    /// The same entries by id, of ids `0..n`.
    fn transposed(&self, n: usize) -> Self {
        let n_rows = self.starts.len() - 1;
        let mut starts = vec![0; n + 1];
        self.ids.iter().for_each(|id| starts[*id as usize + 1] += 1);
        (0..n).for_each(|id| starts[id + 1] += starts[id]);
        let mut next = starts.clone();
        let (mut ids, mut weights) = (vec![0; self.ids.len()], vec![DVec2::ZERO; self.ids.len()]);
        for row in 0..n_rows {
            for (id, weight) in self.row(row) {
                (ids[next[id]], weights[next[id]]) = (row as u32, weight);
                next[id] += 1;
            }
        }
        Self { starts, ids, weights }
    }
}

/// D, N → jumps at the edges, and S, V → jumps of its slope at the edges, in lengths of the mean edge.
pub(super) struct Operators {
    pub edges: Vec<Edge>,
    /// Areas over the square of the mean edge length.
    pub areas: Vec<f64>,
    /// Face → 2 · edge + 0 or 1, which of the edge's faces it is.
    face_edges: Csr,
    /// S, one row an edge, empty where a face has no gradient.
    pub slope_jumps: Rows,
    transposed: Rows,
}

impl Operators {
    pub fn new(topology: &Topology, positions: &[DVec3], geometry: &FaceGeometry) -> Self {
        let mean_length = mean_edge_length(positions, topology.faces());
        let unit = if mean_length > 0.0 { mean_length.recip() } else { 1.0 };
        let areas: Vec<f64> = geometry.areas.iter().map(|a| a * unit * unit).collect();
        let pairs = find_edge_pairs(topology);
        let edges: Vec<Edge> = pairs
            .iter()
            .map(|pair| {
                let [p1, _, p3, _] = pair.vertices.map(|v| positions[v as usize]);
                Edge {
                    faces: pair.faces,
                    turn: if pair.is_flipped { -1.0 } else { 1.0 },
                    length: (p1.distance(p3) * unit).max(LEAST_LENGTH),
                    has_slope: pair.faces.iter().all(|&f| areas[f as usize] > 0.0),
                }
            })
            .collect();
        let sides = (0u32..).zip(&edges).flat_map(|(e, edge)| {
            let [first, second] = edge.faces;
            [(first, 2 * e), (second, 2 * e + 1)]
        });
        let face_edges = Csr::from_pairs(areas.len(), sides);
        let slope_jumps = slope_jumps(topology, positions, geometry, unit, &pairs, &edges, &face_edges);
        let transposed = slope_jumps.transposed(edges.len());
        Self { edges, areas, face_edges, slope_jumps, transposed }
    }

    /// (D N)_e = ±N_second − N_first, the sign being `turn`.
    pub fn jump(&self, edge: &Edge, normals: &[DVec3]) -> DVec3 {
        let [first, second] = edge.faces.map(|f| normals[f as usize]);
        edge.turn * second - first
    }

    /// (Dᵀ x)_τ for the x of every edge.
    pub fn jump_adjoint(&self, face: usize, x: impl Fn(usize) -> DVec3) -> DVec3 {
        let terms = self.face_edges.row(face).iter().map(|&slot| {
            let e = slot as usize / 2;
            x(e) * if slot % 2 == 0 { -1.0 } else { self.edges[e].turn }
        });
        terms.sum()
    }

    /// (S V)_e: how V's slope jumps at an edge, along it and across it.
    pub fn slope_jump(&self, e: usize, v: &[DVec3]) -> [DVec3; 2] {
        let mut jump = [DVec3::ZERO; 2];
        for (id, weight) in self.slope_jumps.row(e) {
            jump[0] += weight.x * v[id];
            jump[1] += weight.y * v[id];
        }
        jump
    }

    /// (Sᵀ y)_e for the y of every edge.
    pub fn slope_jump_adjoint(&self, e: usize, y: impl Fn(usize) -> [DVec3; 2]) -> DVec3 {
        let terms = self.transposed.row(e).map(|(row, weight)| {
            let [along, across] = y(row);
            weight.x * along + weight.y * across
        });
        terms.sum()
    }
}

/// The rows of S: G_second − G_first of V, in the frame of the edge.
fn slope_jumps(
    topology: &Topology,
    positions: &[DVec3],
    geometry: &FaceGeometry,
    unit: f64,
    pairs: &[EdgePair],
    edges: &[Edge],
    face_edges: &Csr,
) -> Rows {
    let gradients = FaceGradients::new(topology, positions, geometry, unit, pairs, edges, face_edges);
    let row_of = |e: usize| {
        let mut row: Vec<(u32, DVec2)> = Vec::new();
        for (side, towards) in [(0, -1.0), (1, edges[e].turn)] {
            let Side { along, across, .. } = gradients.side(2 * e + side);
            let face = edges[e].faces[side] as usize;
            if !gradients.is_known(face) {
                return Vec::new();
            }
            for &slot in face_edges.row(face) {
                let (id, slope) = (slot / 2, gradients.weight(face, slot as usize));
                let weight = towards * DVec2::new(along.dot(slope), across.dot(slope));
                match row.iter_mut().find(|(other, _)| *other == id) {
                    Some((_, sum)) => *sum += weight,
                    None => row.push((id, weight)),
                }
            }
        }
        // NaN is not below the limit either.
        let is_sound = row.iter().all(|(_, weight)| weight.abs().max_element() < LARGEST_WEIGHT);
        row.retain(|(id, _)| edges[*id as usize].has_slope);
        if is_sound { row } else { Vec::new() }
    };
    let found: Vec<_> = (0..edges.len()).into_par_iter().with_min_len(CHUNK).map(row_of).collect();
    let mut rows = Rows { starts: vec![0], ..Rows::default() };
    for row in found {
        rows.ids.extend(row.iter().map(|(id, _)| id));
        rows.weights.extend(row.iter().map(|(_, weight)| weight));
        rows.starts.push(rows.ids.len());
    }
    rows
}
