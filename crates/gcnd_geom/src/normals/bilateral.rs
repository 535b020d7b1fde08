//! Bilateral normal filtering (Zheng, Fu, Au, Tai 2011), local iterative and global implicit schemes.

use crate::error::{Result, check_positive};
use crate::face_geometry::FaceGeometry;
use crate::normals::kernel::{Filter, OwnNormal, STORED_BYTES_PER_FACE};
use crate::normals::neighborhood::Neighborhood;
use crate::normals::refine::RefineParams;
use crate::topology::Topology;
use crate::vertex_update::{Boundary, VertexUpdater};
use crate::watch::{Run, Watch};
use glam::DVec3;

/// Parameters of [`bilateral_normal`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BilateralNormalParams {
    /// σ_r, as a distance between unit normals (0 to 2); 0.35 suits synthetic noise, 0.45 scans.
    pub sigma_r: f64,
    /// σ_s, in mesh units; `None` takes [`FaceGeometry::mean_centroid_distance`].
    pub sigma_s: Option<f64>,
    /// Passes over the normals.
    pub normal_iterations: usize,
    /// Passes of vertex updating (Eq. 6 of the seed paper).
    pub vertex_iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
}

impl Default for BilateralNormalParams {
    fn default() -> Self {
        Self {
            sigma_r: 0.35,
            sigma_s: None,
            normal_iterations: 20,
            vertex_iterations: 20,
            fix_boundary: true,
        }
    }
}

impl BilateralNormalParams {
    /// Checks that both sigmas are positive and finite.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        check_positive("sigma_r", self.sigma_r)?;
        self.sigma_s.map_or(Ok(()), |sigma_s| check_positive("sigma_s", sigma_s))
    }

    /// The same kernels as Eq. 5 has them, in the units of a run.
    fn refine_params(&self, scale: f64) -> RefineParams {
        RefineParams {
            iterations: self.normal_iterations,
            sigma_s: self.sigma_s.map(|sigma_s| sigma_s * scale),
            sigma_r: self.sigma_r,
            neighborhood: Neighborhood::SharedVertex,
        }
    }
}

/// Filters a mesh's own normals bilaterally, then moves its vertices to fit them:
/// n_i ← normalize( Σ_{j ∈ N_i} a_j · W_s(|c_j − c_i|) · W_r(|n_j − n_i|) · n_j ), `normal_iterations` times, with
/// W(x) = exp(−x² / (2σ²)) and N_i the faces that share a vertex with i, without i; then
/// [`crate::vertex_update::update_vertices`].
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`BilateralNormalParams`]; areas a and centroids c are those of `vertices` throughout.
/// - `watch`: hears of every iteration, `normal_iterations` + `vertex_iterations` in all.
///
/// Returns (V) new positions, in mesh units. A face without area takes the mean of its neighbours' normals and has no
/// say in theirs; a face without neighbours keeps its normal.
///
/// Memory: as [`crate::normals::refine_normals`].
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`] or [`crate::GeomError::Cancelled`].
///
/// Source: Zheng et al. 2011, Eq. 5 (local scheme). As in the program of Zhang et al. 2015, whose errors it
/// reproduces, boundary vertices stay, unless `fix_boundary` is off.
///
/// ```
/// use gcnd_geom::normals::{BilateralNormalParams, bilateral_normal};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(6, 6);
/// vertices[24].z = 0.3;
/// let topology = Topology::new(faces, vertices.len())?;
/// let params = BilateralNormalParams::default();
/// let denoised = bilateral_normal(&topology, &vertices, &params, &mut Watch::silent())?;
/// assert!(denoised[24].z < 0.03);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn bilateral_normal(
    topology: &Topology,
    vertices: &[DVec3],
    params: &BilateralNormalParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let total = params.normal_iterations.saturating_add(params.vertex_iterations);
    let (mut run, positions) = Run::start(topology, vertices, total, watch)?;
    let mut current = FaceGeometry::compute(&positions, topology.faces()).normals;
    let mut next = current.clone();
    let filter = Filter::new(topology, &positions, &params.refine_params(run.scale), OwnNormal::Omitted)?;
    let rows = filter.stored_rows(STORED_BYTES_PER_FACE);
    for _ in 0..params.normal_iterations {
        filter.iterate(&current, &mut next, &rows);
        std::mem::swap(&mut current, &mut next);
        run.tick_normals(&current)?;
    }
    drop((filter, rows, next));
    move_to_normals(topology, run, positions, &current, params.vertex_iterations, params.fix_boundary)
}

/// The end of a normal filter: vertex updating, watched.
pub(crate) fn move_to_normals(
    topology: &Topology,
    run: Run<'_, '_>,
    positions: Vec<DVec3>,
    normals: &[DVec3],
    vertex_iterations: usize,
    fix_boundary: bool,
) -> Result<Vec<DVec3>> {
    let updater = VertexUpdater::new(topology, normals, Boundary::held_if(fix_boundary));
    move_by(updater, run, positions, vertex_iterations)
}

/// Passes of vertex updating, watched.
pub(crate) fn move_by(
    mut updater: VertexUpdater<'_>,
    mut run: Run<'_, '_>,
    mut positions: Vec<DVec3>,
    vertex_iterations: usize,
) -> Result<Vec<DVec3>> {
    for _ in 0..vertex_iterations {
        updater.step(&mut positions);
        run.tick_positions(&positions)?;
    }
    Ok(run.finish(positions))
}
