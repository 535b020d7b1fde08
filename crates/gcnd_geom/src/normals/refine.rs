//! Normal refinement: the bilateral filter on face normals (paper Sec. 6.1, Eq. 5).

use crate::error::{GeomError, Result, check_len};
use crate::mesh::check_vertices;
use crate::normals::kernel::{CHUNK, Filter, OwnNormal, STORED_BYTES_PER_FACE, unit_or_zero};
use crate::normals::neighborhood::Neighborhood;
use crate::topology::Topology;
use crate::watch::{Ticks, Watch};
use glam::DVec3;
use rayon::prelude::*;

/// How to refine normals; [`RefineParams::default`] holds the paper's kernels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefineParams {
    /// The paper's m: 12 for CAD models and depth-camera scans, 1 for others; 0 changes nothing.
    pub iterations: usize,
    /// σ_s, in mesh units; `None` takes [`crate::face_geometry::FaceGeometry::mean_centroid_distance`], the paper's l̄_e.
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

    /// What [`refine_normals`] tells a watch of: the weights, then every iteration.
    pub(crate) fn steps(&self) -> usize {
        if self.iterations == 0 { 0 } else { self.iterations.saturating_add(1) }
    }
}

/// Smooths face normals along the surface but not across edges, `iterations` times:
/// n_i ← normalize( Σ_{j ∈ Ω_i} a_j · W_s(|c_j − c_i|) · W_r(|n_j − n_i|) · n_j ), with
/// W(x) = exp(−x² / (2σ²)) and Ω_i containing i.
///
/// - `topology`, `vertices` (V), in mesh units: the mesh whose areas a and centroids c weight the sum; they
///   do not change during refinement.
/// - `normals` (F): the predicted normals in the frame of `vertices`, of any length; zero where unknown.
/// - `watch`: hears when the weights are there and of every iteration, 1 + `iterations` in all.
///
/// Returns (F) unit normals. An unknown normal adds nothing to its neighbours and becomes their mean under
/// a_j · W_s; where nothing is known within Ω_i it stays zero.
///
/// On a noisy mesh's own normals, with [`Neighborhood::SharedVertex`] or [`Neighborhood::SharedEdge`], this is
/// bilateral normal filtering (Zheng et al. 2011, local scheme; [`crate::normals::bilateral_normal`]), but for the
/// face itself, which takes part here as it does in Zhang et al. 2015.
///
/// Memory: 112 bytes a face, and if there is more than one iteration the weights: 12 bytes for each of a face's
/// neighbours (about 150 bytes a face for `SharedVertex`), or none where that would exceed
/// 256 bytes a face and 64 MiB in all: there weights are computed anew in each iteration.
///
/// # Errors
/// [`GeomError::LengthMismatch`], [`GeomError::NonFiniteVertex`], [`GeomError::InvalidParameter`] for
/// parameters out of range and for a normal that is NaN or infinite, or [`GeomError::Cancelled`].
///
/// Paper: Sec. 6.1, Eq. 5; Ω as in Zhang et al. 2015.
/// Choice: docs/choices.md#refine-neighborhood, docs/choices.md#faces-without-normal.
///
/// ```
/// use gcnd_geom::{fixtures, normals::{refine_normals, RefineParams}, DVec3, Topology, Watch};
/// let (vertices, faces) = fixtures::grid(4, 4);
/// let mut normals = vec![DVec3::Z; faces.len()];
/// normals[10] = DVec3::new(0.1, 0.0, 1.0);
/// let topology = Topology::new(faces, vertices.len())?;
/// let refined = refine_normals(&topology, &vertices, &normals, &RefineParams::default(), &mut Watch::silent())?;
/// assert!(refined[10].angle_between(DVec3::Z) < 0.03);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn refine_normals(
    topology: &Topology,
    vertices: &[DVec3],
    normals: &[DVec3],
    params: &RefineParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    refine_counted(topology, vertices, normals, params, &mut Ticks::new(params.steps(), watch))
}

/// [`refine_normals`] as a part of longer work.
pub(crate) fn refine_counted(
    topology: &Topology,
    vertices: &[DVec3],
    normals: &[DVec3],
    params: &RefineParams,
    ticks: &mut Ticks<'_, '_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    check_len("vertices", topology.n_vertices(), vertices.len())?;
    check_vertices(vertices)?;
    let mut current = unit_normals(normals, topology.n_faces())?;
    if params.iterations == 0 {
        return Ok(current);
    }
    let filter = Filter::new(topology, vertices, params, OwnNormal::Counts)?;
    // Rows that serve only once are not worth storing.
    let share = if params.iterations > 1 { STORED_BYTES_PER_FACE } else { 0 };
    let rows = filter.stored_rows(share);
    ticks.tick()?;
    let mut next = vec![DVec3::ZERO; current.len()];
    for _ in 0..params.iterations {
        filter.iterate(&current, &mut next, &rows);
        std::mem::swap(&mut current, &mut next);
        ticks.tick()?;
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

#[cfg(test)]
mod tests;
