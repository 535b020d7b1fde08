//! Fast and effective feature-preserving mesh denoising (Sun, Rosin, Martin, Langbein 2007).

use crate::error::{Result, check_parameter};
use crate::face_geometry::FaceGeometry;
use crate::normals::bilateral::move_to_normals;
use crate::normals::kernel::{CHUNK, unit_or_zero};
use crate::normals::neighborhood::{NeighborLists, NeighborScratch, Neighborhood, Neighbors};
use crate::topology::Topology;
use crate::watch::{Run, Watch};
use glam::DVec3;
use rayon::prelude::*;

/// Parameters of [`fast_effective`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FastEffectiveParams {
    /// T: neighbours whose normal makes a cosine of T or less with a face's own have no say; 0 ≤ T < 1.
    pub threshold: f64,
    /// Passes over the normals.
    pub normal_iterations: usize,
    /// Passes of vertex updating.
    pub vertex_iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
}

impl Default for FastEffectiveParams {
    fn default() -> Self {
        Self { threshold: 0.5, normal_iterations: 20, vertex_iterations: 50, fix_boundary: true }
    }
}

impl FastEffectiveParams {
    /// Checks the threshold.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the value.
    pub fn validate(&self) -> Result<()> {
        let is_allowed = (0.0..1.0).contains(&self.threshold);
        check_parameter("threshold", self.threshold, is_allowed, "0 or more and below 1")
    }
}

/// Averages normals with weights that grow with agreement, then moves the vertices to fit them:
/// n_i ← normalize( Σ_{j ∈ N_i} max(0, n_i · n_j − T)² · n_j ), `normal_iterations` times, with N_i the faces that share
/// a vertex with i, and i; then [`crate::vertex_update::update_vertices`].
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`FastEffectiveParams`].
/// - `watch`: hears of every iteration, `normal_iterations` + `vertex_iterations` in all.
///
/// Returns (V) new positions, in mesh units. A face without area takes the plain mean of its neighbours' normals and has
/// no say in theirs.
///
/// Memory: about 150 bytes a face, and for neighbours 4 bytes each, up to 256 bytes a face or 64 MiB in all.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`] or [`crate::GeomError::Cancelled`].
///
/// Source: Sun et al. 2007, Eqs. 4–6 (weights) and 8 (vertices). As in the program of Zhang et al. 2015, boundary
/// vertices stay, unless `fix_boundary` is off.
///
/// ```
/// use gcnd_geom::normals::{FastEffectiveParams, fast_effective};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(6, 6);
/// vertices[24].z = 0.3;
/// let topology = Topology::new(faces, vertices.len())?;
/// let params = FastEffectiveParams::default();
/// let denoised = fast_effective(&topology, &vertices, &params, &mut Watch::silent())?;
/// assert!(denoised[24].z < 0.03);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn fast_effective(
    topology: &Topology,
    vertices: &[DVec3],
    params: &FastEffectiveParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let total = params.normal_iterations.saturating_add(params.vertex_iterations);
    let (mut run, positions) = Run::start(topology, vertices, total, watch)?;
    let neighborhood = Neighborhood::SharedVertex;
    let lists = NeighborLists::new(Neighbors { topology, neighborhood, centroids: &[], radius: 0.0 });
    let mut current = FaceGeometry::compute(&positions, topology.faces()).normals;
    let mut next = current.clone();
    for _ in 0..params.normal_iterations {
        average(&lists, params.threshold, &current, &mut next);
        std::mem::swap(&mut current, &mut next);
        run.tick_normals(&current)?;
    }
    move_to_normals(topology, run, positions, &current, params.vertex_iterations, params.fix_boundary)
}

/// One pass over the normals.
fn average(lists: &NeighborLists<'_>, threshold: f64, current: &[DVec3], next: &mut [DVec3]) {
    next.par_chunks_mut(CHUNK).enumerate().for_each_init(
        NeighborScratch::default,
        |scratch, (chunk, out)| {
            for (offset, normal) in out.iter_mut().enumerate() {
                let face_id = chunk * CHUNK + offset;
                let own = current[face_id];
                let neighbors = lists.of(face_id, scratch).iter().map(|&j| current[j as usize]);
                let sum: DVec3 = if own == DVec3::ZERO {
                    neighbors.sum()
                } else {
                    neighbors.chain([own]).map(|n| (own.dot(n) - threshold).max(0.0).powi(2) * n).sum()
                };
                let mean = unit_or_zero(sum);
                *normal = if mean == DVec3::ZERO { own } else { mean };
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn weights_by_hand() {
        // Cosine 0.8 to the other face of two, T = 0.5: weights 0.25 for the face itself, 0.09 for the other.
        let (vertices, faces) = fixtures::two_triangles();
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let neighborhood = Neighborhood::SharedVertex;
        let lists =
            NeighborLists::new(Neighbors { topology: &topology, neighborhood, centroids: &[], radius: 0.0 });
        let after = |current: &[DVec3], threshold| {
            let mut next = vec![DVec3::ZERO; 2];
            average(&lists, threshold, current, &mut next);
            next
        };
        let current = [DVec3::Z, DVec3::new(0.6, 0.0, 0.8)];
        let expected = (0.25 * current[0] + 0.09 * current[1]).normalize();
        assert!(after(&current, 0.5)[0].distance(expected) < 1e-15);
        assert_eq!(after(&current, 0.8), current, "a cosine of T has no say");
        assert_eq!(after(&[DVec3::ZERO, DVec3::X], 0.5), [DVec3::X, DVec3::X]);
        assert_eq!(after(&[DVec3::ZERO; 2], 0.5), [DVec3::ZERO; 2]);
    }
}
