//! The energy that [`super::fit_vertices`] makes least, and its conjugate gradients.

use super::ITERATIONS;
use crate::error::Result;
use crate::patch::quantile;
use crate::rim::{Boundary, Rim};
use crate::topology::Topology;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Noise in mean edges below which λ rises no further.
const LEAST_NOISE: f64 = 0.02;

/// A vertex that went so many times as far as the noise is followed half as much: it was no sample of the surface.
const FAR: f64 = 3.0;

/// μ: what holds a vertex where it was along the surface, of which normals say nothing.
const HOLD: f64 = 0.13;

/// Area in mean areas below which a face counts less and less.
const LEAST_AREA: f64 = 1e-3;

/// Share of the first squared residual at which the solver is done.
const ENOUGH: f64 = 1e-24;

/// Faces and vertices of one unit of parallel work; sums are made unit by unit, so that threads do not change them.
pub(super) const CHUNK: usize = 4096;

/// What one face has in E: its normal and ½ cot of its corners, each the weight of the edge opposite.
struct Term {
    normal: DVec3,
    cotangents: [f64; 3],
}

/// E as a quadratic form in the ways that vertices go, in mean edge lengths.
pub(super) struct Energy<'a> {
    topology: &'a Topology,
    terms: Vec<Term>,
    /// (V) λ_i m mᵀ + μ (1 − m mᵀ).
    holds: Vec<DMat3>,
    /// (V) inverse of the diagonal's blocks.
    inverses: Vec<DMat3>,
    /// (V) minus half the gradient of E at the start, where rims may go.
    start: Vec<DVec3>,
    rim: Rim,
    /// (V) m.
    means: Vec<DVec3>,
}

impl<'a> Energy<'a> {
    /// Of positions (V) with unit or zero normals (F), first positions (V), and the mean edge length.
    pub fn new(
        topology: &'a Topology,
        vertices: &[DVec3],
        normals: Vec<DVec3>,
        first: &[DVec3],
        edge: f64,
        pull: f64,
        boundary: Boundary,
    ) -> Self {
        let scaled: Vec<DVec3> = vertices.par_iter().with_min_len(CHUNK).map(|&v| v / edge).collect();
        let offsets: Vec<DVec3> =
            first.par_iter().zip(vertices).with_min_len(CHUNK).map(|(&r, &v)| (r - v) / edge).collect();
        let areas = areas_of(topology, &scaled);
        let floor = LEAST_AREA * areas.iter().sum::<f64>() / areas.len() as f64;
        let means = mean_normals(topology, &normals, &areas);
        let holds = holds(topology, &offsets, &means, pull);
        let faces = topology.faces().par_iter().zip(normals).zip(areas).with_min_len(CHUNK);
        let terms: Vec<Term> = faces
            .map(|((face, normal), area)| Term {
                normal,
                cotangents: half_cotangents(face.map(|v| scaled[v as usize]), area, floor),
            })
            .collect();
        let mut rim = Rim::new(topology, boundary);
        rim.place(&scaled);
        let mut energy = Self { topology, terms, holds, inverses: Vec::new(), start: Vec::new(), rim, means };
        energy.inverses = energy.per_vertex(|i| energy.block(i).inverse());
        energy.start =
            energy.per_vertex(|i| energy.allowed(i, energy.holds[i] * offsets[i] - energy.pull(i, &scaled)));
        energy
    }

    /// What a function gives for every vertex that has faces, and zero for the others.
    fn per_vertex<T: Default + Send>(&self, value: impl Fn(usize) -> T + Sync) -> Vec<T> {
        let ids = (0..self.topology.n_vertices()).into_par_iter().with_min_len(CHUNK);
        let has_faces = |i: usize| !self.topology.vertex_faces().row(i).is_empty();
        ids.map(|i| if has_faces(i) { value(i) } else { T::default() }).collect()
    }

    /// The faces of a vertex: the term, the other two corners, and the weights of the edges to them.
    fn around(&self, i: usize) -> impl Iterator<Item = (&Term, [(usize, f64); 2])> {
        self.topology.vertex_faces().row(i).iter().map(move |&face_id| {
            let term = &self.terms[face_id as usize];
            let face = self.topology.faces()[face_id as usize].map(|v| v as usize);
            let at = face.iter().position(|&v| v == i).unwrap_or(0);
            let (next, last) = ((at + 1) % 3, (at + 2) % 3);
            (term, [(face[next], term.cotangents[last]), (face[last], term.cotangents[next])])
        })
    }

    /// Half the gradient of the first sum at vertex i.
    fn pull(&self, i: usize, x: &[DVec3]) -> DVec3 {
        let of_face = |(term, edges): (&Term, [(usize, f64); 2])| {
            term.normal * edges.map(|(j, weight)| weight * term.normal.dot(x[i] - x[j])).iter().sum::<f64>()
        };
        self.around(i).map(of_face).sum()
    }

    /// The 3 × 3 block of vertex i on the diagonal.
    fn block(&self, i: usize) -> DMat3 {
        self.around(i).fold(self.holds[i], |sum, (Term { normal, .. }, [(_, a), (_, b)])| {
            sum + outer(*normal) * (a + b)
        })
    }

    /// What is left of a step where the rim is held.
    fn allowed(&self, i: usize, step: DVec3) -> DVec3 {
        self.rim.held(i, step, || self.means[i])
    }

    /// (V) ways to the least E, by conjugate gradients. `tick` is called after each step, and its error ends it.
    pub fn minimize(&self, mut tick: impl FnMut() -> Result<()>) -> Result<Vec<DVec3>> {
        let mut ways = vec![DVec3::ZERO; self.holds.len()];
        let mut residual = self.start.clone();
        let precondition =
            |residual: &[DVec3]| self.per_vertex(|i| self.allowed(i, self.inverses[i] * residual[i]));
        let mut direction = precondition(&residual);
        let mut descent = dot(&residual, &direction);
        let enough = ENOUGH * descent;
        for _ in 0..ITERATIONS {
            // A small mesh is there before; what follows would be rounding.
            if descent <= enough {
                tick()?;
                continue;
            }
            let image =
                self.per_vertex(|i| self.allowed(i, self.pull(i, &direction) + self.holds[i] * direction[i]));
            let length = descent / dot(&direction, &image);
            // Else beyond the range of numbers.
            if length.is_finite() {
                add(&mut ways, length, &direction);
                add(&mut residual, -length, &image);
                let preconditioned = precondition(&residual);
                let (before, now) = (descent, dot(&residual, &preconditioned));
                descent = now;
                let keep = now / before;
                direction.par_iter_mut().zip(preconditioned).with_min_len(CHUNK).for_each(|(d, z)| {
                    *d = z + keep * *d;
                });
            }
            tick()?;
        }
        Ok(ways)
    }
}

/// m mᵀ.
fn outer(m: DVec3) -> DMat3 {
    DMat3::from_cols(m * m.x, m * m.y, m * m.z)
}

fn areas_of(topology: &Topology, vertices: &[DVec3]) -> Vec<f64> {
    let area = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        (b - a).cross(c - a).length() / 2.0
    };
    topology.faces().par_iter().with_min_len(CHUNK).map(area).collect()
}

/// ½ cot of each corner, with the area in it not below `floor`, and less where it would be.
pub(super) fn half_cotangents([a, b, c]: [DVec3; 3], area: f64, floor: f64) -> [f64; 3] {
    let ratio = area / area.max(floor).powi(2) / 4.0;
    let weight = |dot: f64| Some(dot * ratio).filter(|weight| weight.is_finite()).unwrap_or(0.0);
    [(b - a).dot(c - a), (c - b).dot(a - b), (a - c).dot(b - c)].map(weight)
}

/// m of every vertex, zero where its normals cancel out.
fn mean_normals(topology: &Topology, normals: &[DVec3], areas: &[f64]) -> Vec<DVec3> {
    let ids = (0..topology.n_vertices()).into_par_iter().with_min_len(CHUNK);
    let mean = |i| {
        let row = topology.vertex_faces().row(i).iter();
        row.map(|&f| normals[f as usize] * areas[f as usize]).sum::<DVec3>().normalize_or_zero()
    };
    ids.map(mean).collect()
}

/// λ_i m mᵀ + μ (1 − m mᵀ) for every vertex, from how far the first positions are off, in mean edge lengths.
fn holds(topology: &Topology, offsets: &[DVec3], means: &[DVec3], pull: f64) -> Vec<DMat3> {
    let heights: Vec<f64> = offsets.iter().zip(means).map(|(offset, mean)| offset.dot(*mean)).collect();
    let has_faces = |&i: &usize| !topology.vertex_faces().row(i).is_empty();
    let mut seen: Vec<f64> = (0..heights.len()).filter(has_faces).map(|i| heights[i].abs()).collect();
    let noise = 1.4826 * quantile(&mut seen, 0.5);
    let pull = pull / noise.max(LEAST_NOISE);
    let hold = |(height, &mean): (f64, &DVec3)| {
        let far = if height == 0.0 { 0.0 } else { height / (FAR * noise) };
        DMat3::from_diagonal(DVec3::splat(HOLD)) + outer(mean) * (pull / (1.0 + far * far) - HOLD)
    };
    heights.into_par_iter().zip(means).with_min_len(CHUNK).map(hold).collect()
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    let sums = a
        .par_chunks(CHUNK)
        .zip(b.par_chunks(CHUNK))
        .map(|(a, b)| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() });
    sums.collect::<Vec<f64>>().into_iter().sum()
}

fn add(sum: &mut [DVec3], factor: f64, other: &[DVec3]) {
    sum.par_iter_mut().zip(other).with_min_len(CHUNK).for_each(|(a, b)| *a += factor * *b);
}
