//! Guided mesh normal filtering (Zhang, Deng, Zhang, Bouaziz, Liu 2015), local scheme.

use crate::error::{Result, check_positive};
use crate::face_geometry::FaceGeometry;
use crate::normals::guidance::Guidance;
use crate::normals::kernel::{CHUNK, unit_or_zero};
use crate::normals::neighborhood::{NeighborLists, NeighborScratch, Neighborhood, Neighbors};
use crate::topology::Topology;
use crate::vertex_update::{Boundary, VertexUpdater};
use crate::watch::{Run, Watch};
use glam::DVec3;
use rayon::prelude::*;

/// Parameters of [`guided_normal`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidedNormalParams {
    /// σ_r, as a distance between unit guidance normals (0 to 2); 0.35 suits synthetic noise, 0.45 scans.
    pub sigma_r: f64,
    /// σ_s, in mesh units; `None` takes [`FaceGeometry::mean_centroid_distance`], anew in each iteration.
    pub sigma_s: Option<f64>,
    /// r: radius of the faces averaged over, in mean centroid distances.
    pub radius: f64,
    /// Passes of filtering normals, each followed by vertex updating.
    pub normal_iterations: usize,
    /// Passes of vertex updating after each pass over the normals.
    pub vertex_iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
}

impl Default for GuidedNormalParams {
    fn default() -> Self {
        Self {
            sigma_r: 0.35,
            sigma_s: None,
            radius: 2.0,
            normal_iterations: 20,
            vertex_iterations: 20,
            fix_boundary: false,
        }
    }
}

impl GuidedNormalParams {
    /// Checks that the sigmas and the radius are positive and finite.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        check_positive("sigma_r", self.sigma_r)?;
        check_positive("radius", self.radius)?;
        self.sigma_s.map_or(Ok(()), |sigma_s| check_positive("sigma_s", sigma_s))
    }
}

/// Filters a mesh's normals bilaterally under the guidance of patch normals, moving its vertices in each iteration:
/// n_i ← normalize( Σ_{j ∈ N_i} a_j · W_s(|c_j − c_i|) · W_r(|g_j − g_i|) · n_j ), with W(x) = exp(−x² / (2σ²)).
///
/// The guidance g_i is the area-weighted mean normal of the most consistent patch that holds face i. A patch is a face
/// and all that share a vertex with it; the lower H(P) = Φ(P) · R(P), the more consistent it is, where Φ is the
/// largest distance between two normals of P and R the largest distance across one of its inner edges over the sum
/// across them all.
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`GuidedNormalParams`]. N_i are the faces whose centroid is within the radius and that are reached
///   over such faces across shared vertices, i among them; they are found once.
/// - `watch`: hears of every iteration over the normals.
///
/// Returns (V) new positions, in mesh units. Faces without area take the mean under the same weights and have no say.
/// Patches of more than 128 faces, which only a vertex of very high degree has, take Φ from a sample of 128.
///
/// Memory: about 300 bytes a face, and for neighbours 8 bytes each, up to 512 bytes a face or 128 MiB in all; beyond
/// that they are found anew in each iteration.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`] or [`crate::GeomError::Cancelled`].
///
/// Source: Zhang et al. 2015, Eqs. 5–9; geometrical neighbourhoods.
///
/// ```
/// use gcnd_geom::normals::{GuidedNormalParams, guided_normal};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(6, 6);
/// vertices[24].z = 0.3;
/// let topology = Topology::new(faces, vertices.len())?;
/// let params = GuidedNormalParams::default();
/// let denoised = guided_normal(&topology, &vertices, &params, &mut Watch::silent())?;
/// assert!(denoised[24].z < 0.03);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn guided_normal(
    topology: &Topology,
    vertices: &[DVec3],
    params: &GuidedNormalParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let (mut run, mut positions) = Run::start(topology, vertices, params.normal_iterations, watch)?;
    let start = FaceGeometry::compute(&positions, topology.faces());
    let neighborhood = Neighborhood::Radius { multiple: params.radius };
    let radius = neighborhood.radius(start.mean_centroid_distance(topology)?);
    let lists = NeighborLists::new(Neighbors { topology, neighborhood, centroids: &start.centroids, radius });
    let mut guidance = Guidance::new(topology);
    let mut updater = VertexUpdater::new(topology, &start.normals, Boundary::held_if(params.fix_boundary));
    let mut filtered = vec![DVec3::ZERO; topology.n_faces()];
    for _ in 0..params.normal_iterations {
        let geometry = FaceGeometry::compute(&positions, topology.faces());
        let sigma_s = match params.sigma_s {
            Some(sigma_s) => sigma_s * run.scale,
            None => geometry.mean_centroid_distance(topology)?,
        };
        let guides = guidance.update(&geometry);
        filter_jointly(&lists, &geometry, guides, sigma_s, params.sigma_r, &mut filtered);
        updater.set_normals(&filtered);
        for _ in 0..params.vertex_iterations {
            updater.step(&mut positions);
            run.check_positions(&positions)?;
        }
        run.tick_normals(&filtered)?;
    }
    Ok(run.finish(positions))
}

/// What the sum needs of a face, together in memory.
#[derive(Clone, Copy)]
struct Record {
    /// a_j · n_j.
    weighted: DVec3,
    guide: DVec3,
    centroid: DVec3,
}

/// Eq. 5 with guidance: the joint bilateral filter.
fn filter_jointly(
    lists: &NeighborLists<'_>,
    geometry: &FaceGeometry,
    guides: &[DVec3],
    sigma_s: f64,
    sigma_r: f64,
    filtered: &mut [DVec3],
) {
    let record = |i: usize| Record {
        weighted: geometry.areas[i] * geometry.normals[i],
        guide: guides[i],
        centroid: geometry.centroids[i],
    };
    let records: Vec<Record> = (0..filtered.len()).into_par_iter().with_min_len(CHUNK).map(record).collect();
    let spatial = if sigma_s > 0.0 { -0.5 / (sigma_s * sigma_s) } else { 0.0 };
    let range = -0.5 / (sigma_r * sigma_r);
    filtered.par_chunks_mut(CHUNK).enumerate().for_each_init(
        NeighborScratch::default,
        |scratch, (chunk, out)| {
            for (offset, normal) in out.iter_mut().enumerate() {
                let face_id = chunk * CHUNK + offset;
                let own = records[face_id];
                let mut sum = own.weighted;
                for &j in lists.of(face_id, scratch) {
                    let other = records[j as usize];
                    let exponent = spatial * other.centroid.distance_squared(own.centroid)
                        + range * other.guide.distance_squared(own.guide);
                    sum += exponent.exp() * other.weighted;
                }
                let mean = unit_or_zero(sum);
                *normal = if mean == DVec3::ZERO { geometry.normals[face_id] } else { mean };
            }
        },
    );
}
