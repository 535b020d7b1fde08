//! Normal refinement: the bilateral filter on face normals (paper Sec. 6.1, Eq. 5).

use crate::error::{GeomError, Result, check_len};
use crate::face_geometry::FaceGeometry;
use crate::mesh::check_vertices;
use crate::topology::{RingScratch, Topology};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Which faces a face's normal is averaged with: Ω of Eq. 5, in each case with the face itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Neighborhood {
    /// `VertexNeighbors`: faces that share at least one vertex.
    SharedVertex,
    /// `EdgeNeighbors`: faces that share an edge.
    SharedEdge,
    /// Faces whose centroid is at most `multiple` mean centroid distances away and that are reached over
    /// faces for which the same holds, stepping across shared vertices; so a close but unconnected sheet
    /// stays out.
    Radius {
        /// Radius in units of [`FaceGeometry::mean_centroid_distance`]; positive.
        multiple: f64,
    },
}

/// How to refine normals; [`RefineParams::default`] holds the paper's kernels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefineParams {
    /// The paper's m: 12 for CAD models and depth-camera scans, 1 for others; 0 changes nothing.
    pub iterations: usize,
    /// σ_s, in mesh units; `None` takes [`FaceGeometry::mean_centroid_distance`], the paper's l̄_e.
    pub sigma_s: Option<f64>,
    /// σ_r, as a distance between unit normals (0 to 2).
    pub sigma_r: f64,
    /// The faces averaged over.
    pub neighborhood: Neighborhood,
}

impl Default for RefineParams {
    fn default() -> Self {
        Self { iterations: 1, sigma_s: None, sigma_r: 0.3, neighborhood: Neighborhood::SharedVertex }
    }
}

impl RefineParams {
    /// Checks that both sigmas and the radius are positive and finite.
    ///
    /// # Errors
    /// [`GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        let radius = match self.neighborhood {
            Neighborhood::Radius { multiple } => Some(multiple),
            Neighborhood::SharedVertex | Neighborhood::SharedEdge => None,
        };
        let given = [("sigma_s", self.sigma_s), ("sigma_r", Some(self.sigma_r)), ("multiple", radius)];
        for (name, value) in given {
            if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
                let allowed = "a positive finite number";
                return Err(GeomError::InvalidParameter { name, value: value.to_string(), allowed });
            }
        }
        Ok(())
    }
}

/// Smooths face normals along the surface but not across edges, `iterations` times:
/// n_i ← normalize( Σ_{j ∈ Ω_i} a_j · W_s(|c_j − c_i|) · W_r(|n_j − n_i|) · n_j ), with
/// W(x) = exp(−x² / (2σ²)) and Ω_i containing i.
///
/// - `topology`, `vertices` (V), in mesh units: the mesh whose areas a and centroids c weight the sum; they
///   do not change during refinement.
/// - `normals` (F): the predicted normals in the frame of `vertices`, of any length; zero where unknown.
///
/// Returns (F) unit normals. An unknown normal adds nothing to its neighbours and becomes their mean under
/// a_j · W_s; where nothing is known within Ω_i it stays zero.
///
/// On a noisy mesh's own normals, with [`Neighborhood::SharedVertex`] or [`Neighborhood::SharedEdge`], this is
/// bilateral normal filtering (Zheng et al. 2011, local scheme), but for the face itself, which takes part here
/// as it does in Zhang et al. 2015.
///
/// Memory: 112 bytes a face, and if there is more than one iteration the weights: 12 bytes for each of a face's
/// neighbours (about 150 bytes a face for `SharedVertex`), or none where that would exceed
/// 256 bytes a face and 64 MiB in all: there weights are computed anew in each iteration.
///
/// # Errors
/// [`GeomError::LengthMismatch`], [`GeomError::NonFiniteVertex`], or [`GeomError::InvalidParameter`] for
/// parameters out of range and for a normal that is NaN or infinite.
///
/// Paper: Sec. 6.1, Eq. 5; Ω as in Zhang et al. 2015.
/// Choice: docs/choices.md#refine-neighborhood, docs/choices.md#faces-without-normal.
///
/// ```
/// use gcnd_geom::{fixtures, normals::{refine_normals, RefineParams}, DVec3, Topology};
/// let (vertices, faces) = fixtures::grid(4, 4);
/// let mut normals = vec![DVec3::Z; faces.len()];
/// normals[10] = DVec3::new(0.1, 0.0, 1.0);
/// let topology = Topology::new(faces, vertices.len())?;
/// let refined = refine_normals(&topology, &vertices, &normals, &RefineParams::default())?;
/// assert!(refined[10].angle_between(DVec3::Z) < 0.03);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn refine_normals(
    topology: &Topology,
    vertices: &[DVec3],
    normals: &[DVec3],
    params: &RefineParams,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    check_len("vertices", topology.n_vertices(), vertices.len())?;
    check_vertices(vertices)?;
    let mut current = unit_normals(normals, topology.n_faces())?;
    if params.iterations == 0 {
        return Ok(current);
    }
    let filter = Filter::new(topology, vertices, params)?;
    // Rows that serve only once are not worth storing.
    let share = if params.iterations > 1 { STORED_BYTES_PER_FACE } else { 0 };
    let rows = filter.stored_rows(share);
    let mut next = vec![DVec3::ZERO; current.len()];
    for _ in 0..params.iterations {
        filter.iterate(&current, &mut next, &rows);
        std::mem::swap(&mut current, &mut next);
    }
    Ok(current)
}

/// Checks and normalises normals (F); zero stays zero.
///
/// # Errors
/// [`GeomError::LengthMismatch`], or [`GeomError::InvalidParameter`] for a NaN or infinite normal.
pub(crate) fn unit_normals(normals: &[DVec3], n_faces: usize) -> Result<Vec<DVec3>> {
    check_len("normals", n_faces, normals.len())?;
    if let Some(face_id) = normals.iter().position(|n| !n.is_finite()) {
        return Err(GeomError::InvalidParameter {
            name: "normals",
            value: format!("{} at face {face_id}", normals[face_id]),
            allowed: "finite vectors",
        });
    }
    Ok(normals.par_iter().with_min_len(CHUNK).map(|n| unit_or_zero(*n)).collect())
}

/// The unit vector along `v`, or zero for zero; neither underflows nor overflows.
fn unit_or_zero(v: DVec3) -> DVec3 {
    let scale = v.abs().max_element();
    if scale > 0.0 { (v / scale).normalize() } else { DVec3::ZERO }
}

/// Faces of one unit of parallel work.
const CHUNK: usize = 4096;
/// Neighbours may be stored up to so many bytes a face …
const STORED_BYTES_PER_FACE: usize = 256;
/// … or so many in all, whichever is more.
const STORED_BYTES: usize = 64 << 20;
/// A stored neighbour: its id and its weight.
const ENTRY_BYTES: usize = size_of::<u32>() + size_of::<f64>();

/// Neighbours and a_j · W_s of the faces of one chunk, without the faces themselves.
#[derive(Default)]
struct Rows {
    ends: Vec<u32>,
    neighbors: Vec<u32>,
    weights: Vec<f64>,
}

/// What stays the same over the iterations.
struct Filter<'a> {
    topology: &'a Topology,
    centroids: Vec<DVec3>,
    /// Areas over the largest area, so that the sum of Eq. 5 cannot underflow on a tiny mesh.
    areas: Vec<f64>,
    /// 1/σ_s; zero, hence W_s = 1, for a mesh without a length of its own.
    per_sigma_s: f64,
    sigma_r: f64,
    neighborhood: Neighborhood,
    radius: f64,
}

impl<'a> Filter<'a> {
    fn new(topology: &'a Topology, vertices: &[DVec3], params: &RefineParams) -> Result<Self> {
        let geometry = FaceGeometry::compute(vertices, topology.faces());
        let mean_distance = geometry.mean_centroid_distance(topology)?;
        let sigma_s = params.sigma_s.unwrap_or(mean_distance);
        let radius = match params.neighborhood {
            Neighborhood::Radius { multiple } => multiple * mean_distance,
            Neighborhood::SharedVertex | Neighborhood::SharedEdge => 0.0,
        };
        let mut areas = geometry.areas;
        let largest = areas.iter().copied().fold(0.0, f64::max);
        if largest > 0.0 {
            areas.par_iter_mut().with_min_len(CHUNK).for_each(|a| *a /= largest);
        }
        Ok(Self {
            topology,
            centroids: geometry.centroids,
            areas,
            per_sigma_s: if sigma_s > 0.0 { sigma_s.recip() } else { 0.0 },
            sigma_r: params.sigma_r,
            neighborhood: params.neighborhood,
            radius,
        })
    }

    /// One application of Eq. 5 to all faces.
    fn iterate(&self, current: &[DVec3], next: &mut [DVec3], rows: &[Option<Rows>]) {
        next.par_chunks_mut(CHUNK).zip(rows).enumerate().for_each_init(
            RingScratch::new,
            |scratch, (chunk, (out, rows))| {
                let first = chunk * CHUNK;
                match rows {
                    Some(rows) => self.apply_stored(first, current, out, rows),
                    None => self.apply_anew(first, current, out, scratch),
                }
            },
        );
    }

    fn apply_stored(&self, first: usize, current: &[DVec3], out: &mut [DVec3], rows: &Rows) {
        let mut start = 0;
        for ((offset, normal), &end) in out.iter_mut().enumerate().zip(&rows.ends) {
            let row = start..end as usize;
            start = row.end;
            let weighted = rows.neighbors[row.clone()].iter().copied().zip(rows.weights[row].iter().copied());
            *normal = self.filtered(first + offset, current, weighted);
        }
    }

    fn apply_anew(&self, first: usize, current: &[DVec3], out: &mut [DVec3], scratch: &mut RingScratch) {
        let mut near = Vec::new();
        for (offset, normal) in out.iter_mut().enumerate() {
            let face_id = first + offset;
            let neighbors = self.neighbors(face_id, scratch, &mut near);
            let weighted = neighbors.iter().map(|&j| (j, self.spatial_weight(face_id, j as usize)));
            *normal = self.filtered(face_id, current, weighted);
        }
    }

    /// Eq. 5 for one face, given its neighbours with their a_j · W_s.
    #[inline]
    fn filtered(
        &self,
        face_id: usize,
        current: &[DVec3],
        weighted: impl Iterator<Item = (u32, f64)>,
    ) -> DVec3 {
        let own = current[face_id];
        let mut sum = self.areas[face_id] * own;
        if own == DVec3::ZERO {
            for (neighbor, weight) in weighted {
                sum += weight * current[neighbor as usize];
            }
        } else {
            let scale = -0.5 / self.sigma_r / self.sigma_r;
            for (neighbor, weight) in weighted {
                let normal = current[neighbor as usize];
                sum += weight * (scale * normal.distance_squared(own)).exp() * normal;
            }
        }
        let filtered = unit_or_zero(sum);
        if filtered == DVec3::ZERO { own } else { filtered }
    }

    /// a_j · W_s(|c_j − c_i|).
    #[inline]
    fn spatial_weight(&self, i: usize, j: usize) -> f64 {
        let x = self.centroids[i].distance(self.centroids[j]) * self.per_sigma_s;
        self.areas[j] * (-0.5 * x * x).exp()
    }

    /// The faces of Ω without the face itself, in an order that depends on the topology alone.
    fn neighbors<'s>(
        &'s self,
        face_id: usize,
        scratch: &'s mut RingScratch,
        near: &'s mut Vec<u32>,
    ) -> &'s [u32] {
        match self.neighborhood {
            Neighborhood::SharedVertex => self.topology.vertex_neighbors(face_id, scratch),
            Neighborhood::SharedEdge => self.topology.edge_neighbors(face_id),
            Neighborhood::Radius { .. } => {
                self.grow(face_id, scratch, near);
                near
            }
        }
    }

    /// Breadth-first growth over shared vertices through faces within the radius.
    fn grow(&self, face_id: usize, scratch: &mut RingScratch, near: &mut Vec<u32>) {
        near.clear();
        scratch.begin(self.topology.n_faces());
        scratch.visit(face_id as u32);
        let (mut slot, mut reached) = (0, face_id as u32);
        loop {
            for vertex_id in self.topology.faces()[reached as usize] {
                for &neighbor in self.topology.vertex_faces().row(vertex_id as usize) {
                    if scratch.visit(neighbor) {
                        let distance = self.centroids[neighbor as usize].distance(self.centroids[face_id]);
                        if distance <= self.radius {
                            near.push(neighbor);
                        }
                    }
                }
            }
            let Some(&next) = near.get(slot) else { break };
            (slot, reached) = (slot + 1, next);
        }
        near.sort_unstable();
    }

    /// Rows of every chunk whose rows fit into the memory allowed, `None` for the others.
    fn stored_rows(&self, bytes_per_face: usize) -> Vec<Option<Rows>> {
        let n_faces = self.topology.n_faces();
        let n_chunks = n_faces.div_ceil(CHUNK);
        let at_least = if bytes_per_face == 0 { 0 } else { STORED_BYTES / n_chunks.max(1) };
        (0..n_chunks)
            .into_par_iter()
            .map_init(RingScratch::new, |scratch, chunk| {
                let faces = chunk * CHUNK..n_faces.min((chunk + 1) * CHUNK);
                let bytes = (bytes_per_face * faces.len()).max(at_least);
                if bytes == 0 { None } else { self.chunk_rows(faces, bytes / ENTRY_BYTES, scratch) }
            })
            .collect()
    }

    /// Rows of some faces, or `None` if they hold more than `limit` neighbours.
    fn chunk_rows(&self, faces: Range<usize>, limit: usize, scratch: &mut RingScratch) -> Option<Rows> {
        let mut rows = Rows::default();
        let mut near = Vec::new();
        for face_id in faces {
            let neighbors = self.neighbors(face_id, scratch, &mut near);
            if rows.neighbors.len() + neighbors.len() > limit {
                return None;
            }
            rows.neighbors.extend_from_slice(neighbors);
            rows.weights.extend(neighbors.iter().map(|&j| self.spatial_weight(face_id, j as usize)));
            rows.ends.push(rows.neighbors.len() as u32);
        }
        rows.neighbors.shrink_to_fit();
        rows.weights.shrink_to_fit();
        Some(rows)
    }
}

#[cfg(test)]
mod tests;
