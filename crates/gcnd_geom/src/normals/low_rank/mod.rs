//! Non-local low-rank normal filtering (Li, Zhu, Fu, Heng 2018).

mod patches;
mod recovery;
mod shrinkage;

use crate::error::{Result, check_parameter, check_positive};
use crate::face_geometry::FaceGeometry;
use crate::normals::bilateral::move_by;
use crate::normals::kernel::{CHUNK, Filter, OwnNormal, STORED_BYTES_PER_FACE, unit_or_zero};
use crate::normals::neighborhood::Neighborhood;
use crate::normals::refine::RefineParams;
use crate::topology::Topology;
use crate::vertex_update::{Boundary, VertexUpdater};
use crate::watch::{Run, Watch};
use glam::DVec3;
use patches::Patches;
use rayon::prelude::*;
use recovery::Recovery;

/// Passes of the bilateral filter that guides the search for patches alike.
const GUIDANCE_PASSES: usize = 10;
/// Recovery tells how far it is so many times.
const PARTS: usize = 10;

/// Parameters of [`low_rank`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LowRankParams {
    /// σ_M: deviation of the noise in a coordinate of a normal; 0.2 suits synthetic noise, up to 0.4 much noise and scans.
    pub sigma_m: f64,
    /// N_k: how many patches alike are recovered together, the vertex's own among them; 1 to 64.
    pub similar_patches: usize,
    /// K: vertices of a patch; 2 to 512.
    pub patch_size: usize,
    /// Steps around a vertex within which patches are compared; 1 to 32.
    pub search_rings: usize,
    /// Passes over the normals.
    pub normal_iterations: usize,
    /// Passes of vertex updating (Eq. 6 of the seed paper).
    pub vertex_iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
    /// Whether a vertex moves by 1/18 of the sum of Eq. 6 however many faces it has, as in the authors' program, and not by
    /// 1 / (3 |F_i|); from 18 faces around a vertex on, that overshoots more in each pass, and diverges.
    pub fixed_step: bool,
}

impl Default for LowRankParams {
    fn default() -> Self {
        Self {
            sigma_m: 0.2,
            similar_patches: 10,
            patch_size: 50,
            search_rings: 10,
            normal_iterations: 1,
            vertex_iterations: 10,
            fix_boundary: false,
            fixed_step: false,
        }
    }
}

impl LowRankParams {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        check_positive("sigma_m", self.sigma_m)?;
        let counts = [
            ("similar_patches", self.similar_patches, 1..=64, "1 to 64"),
            ("patch_size", self.patch_size, 2..=512, "2 to 512"),
            ("search_rings", self.search_rings, 1..=32, "1 to 32"),
        ];
        counts.into_iter().try_for_each(|(name, value, range, allowed)| {
            check_parameter(name, value, range.contains(&value), allowed)
        })
    }
}

/// Recovers a mesh's normals from patches alike, whose normals would form matrices of low rank were it not for the
/// noise, then moves its vertices to fit them.
///
/// The patch of a vertex is its K nearest vertices, counted in steps across faces. With R the frame of the patch's
/// guidance normals g (eigenvectors of Σ g gᵀ, so that g·e₁ > 0 on the whole) and n̄ their unit mean, patches are alike
/// where C = Σ Rᵀ(n − n̄)(n − n̄)ᵀR is, of the vertex normals n and of g:
/// the N_k patches with the least |C − C'|² · |C_g − C'_g|² within `search_rings` steps. Their vertex normals, each in
/// its patch's frame, make one matrix of K rows and N_k columns for each coordinate, and of each matrix
/// Y = Ȳ + U diag(s) Vᵀ, Ȳ the means of its rows, the recovery is
/// Ȳ + U diag(max(s − w, 0)) Vᵀ, w = c·√N_k·σ_M² / (√max(s² − N_k·σ_M², 0) + ε), c = 2.8·√2, ε = 10⁻⁵.
/// A vertex's normal is the mean of all recoveries that hold it, each coordinate weighted by 1 − rank / K; a
/// face's is the mean of its vertices' normals. [`crate::vertex_update::update_vertices`] follows.
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`LowRankParams`]. Guidance is ten passes of [`crate::normals::refine_normals`] with σ_r = σ_M.
/// - `watch`: hears of 20 steps in each pass over the normals, ten of them guidance, and of every pass of vertex updating.
///
/// Returns (V) new positions, in mesh units. Faces without area have no say and take their vertices' normal. Patches are
/// alike only to those with as many vertices: a component of less than K is a patch as a whole. At most 1024 patches
/// are compared, the nearest ones.
///
/// Memory: about 500 bytes a vertex at the default patch size, and 50 MiB.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`] or [`crate::GeomError::Cancelled`].
///
/// Source: Li et al. 2018, as their published program has it. Choice: docs/choices.md#low-rank-recovery.
///
/// ```
/// use gcnd_geom::normals::{LowRankParams, low_rank};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(8, 8);
/// vertices[40].z = 0.3;
/// let topology = Topology::new(faces, vertices.len())?;
/// let denoised = low_rank(&topology, &vertices, &LowRankParams::default(), &mut Watch::silent())?;
/// assert!(denoised[40].z < 0.06);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn low_rank(
    topology: &Topology,
    vertices: &[DVec3],
    params: &LowRankParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let of_normals = params.normal_iterations.saturating_mul(GUIDANCE_PASSES + PARTS);
    let total = of_normals.saturating_add(params.vertex_iterations);
    let (mut run, positions) = Run::start(topology, vertices, total, watch)?;
    let mut normals = FaceGeometry::compute(&positions, topology.faces()).normals;
    for _ in 0..params.normal_iterations {
        let guides = guidance(topology, &positions, &normals, params.sigma_m, &mut run)?;
        let noisy = vertex_normals(topology, &normals);
        let patches = Patches::new(topology, &positions, &noisy, &guides, params.patch_size);
        let mut recovery = Recovery::new(topology, &patches, &noisy, params);
        for part in 0..PARTS {
            recovery.run(part, PARTS);
            run.tick_normals(recovery.sums())?;
        }
        let recovered = recovery.finish();
        normals = (topology.faces().par_iter().zip(&normals).with_min_len(CHUNK))
            .map(|(face, normal)| mean_or(*normal, face.iter().map(|&v| recovered[v as usize])))
            .collect();
    }
    let updater = VertexUpdater::new(topology, &normals, Boundary::held_if(params.fix_boundary));
    let updater = if params.fixed_step { updater.with_fixed_step() } else { updater };
    move_by(updater, run, positions, params.vertex_iterations)
}

/// Vertex normals (V) of bilaterally filtered face normals.
fn guidance(
    topology: &Topology,
    positions: &[DVec3],
    normals: &[DVec3],
    sigma_m: f64,
    run: &mut Run<'_, '_>,
) -> Result<Vec<DVec3>> {
    let neighborhood = Neighborhood::SharedVertex;
    let params = RefineParams { iterations: GUIDANCE_PASSES, sigma_s: None, sigma_r: sigma_m, neighborhood };
    let filter = Filter::new(topology, positions, &params, OwnNormal::Counts)?;
    let rows = filter.stored_rows(STORED_BYTES_PER_FACE);
    let mut current = normals.to_vec();
    let mut next = current.clone();
    for _ in 0..GUIDANCE_PASSES {
        filter.iterate(&current, &mut next, &rows);
        std::mem::swap(&mut current, &mut next);
        run.tick_normals(&current)?;
    }
    Ok(vertex_normals(topology, &current))
}

/// The mean normal of each vertex's faces (V); zero where there is none.
fn vertex_normals(topology: &Topology, normals: &[DVec3]) -> Vec<DVec3> {
    let faces = |v: usize| topology.vertex_faces().row(v).iter().map(|&f| normals[f as usize]);
    let vertices = (0..topology.n_vertices()).into_par_iter().with_min_len(CHUNK);
    vertices.map(|v| mean_or(DVec3::ZERO, faces(v))).collect()
}

/// The unit mean of some vectors, or `otherwise` if they cancel.
fn mean_or(otherwise: DVec3, vectors: impl Iterator<Item = DVec3>) -> DVec3 {
    match unit_or_zero(vectors.sum()) {
        DVec3::ZERO => otherwise,
        mean => mean,
    }
}
