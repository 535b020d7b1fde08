//! Mesh denoising by total generalised variation of normals (Liu, Li, Wang, Liu, Chen 2022).

mod gradient;
mod operator;
mod solver;
#[cfg(test)]
mod tests;

use crate::error::{Result, check_positive};
use crate::face_geometry::FaceGeometry;
use crate::normals::bilateral::move_to_normals;
use crate::topology::Topology;
use crate::watch::{Run, Watch};
use glam::DVec3;
use operator::Operators;
use solver::Solver;

/// Parameters of [`tgv`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TgvParams {
    /// α₁, the weight of creases: of what normals change from face to face beyond an even bend.
    pub alpha1: f64,
    /// α₀, the weight of changes of the bend.
    pub alpha0: f64,
    /// β, the weight of the given normals; more for less noise. Only the ratios of the three weights matter.
    pub beta: f64,
    /// Passes over the normals.
    pub normal_iterations: usize,
    /// Passes of vertex updating.
    pub vertex_iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
}

impl Default for TgvParams {
    fn default() -> Self {
        Self {
            alpha1: 1.0,
            alpha0: 0.5,
            beta: 2.5,
            normal_iterations: 50,
            vertex_iterations: 20,
            fix_boundary: false,
        }
    }
}

impl TgvParams {
    /// Checks that the three weights are positive and finite.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        check_positive("alpha1", self.alpha1)?;
        check_positive("alpha0", self.alpha0)?;
        check_positive("beta", self.beta)
    }
}

/// Filters a mesh's normals so that they bend evenly, or at creases, then moves its vertices to fit them. The normals N
/// and V minimise
/// α₁ Σ_e w_e len_e |(D N)_e − V_e| + α₀ Σ_e len_e |(S V)_e| + β/2 Σ_τ a_τ |N_τ − N⁰_τ|², |N_τ| = 1,
/// by an augmented Lagrangian, and [`crate::vertex_update::update_vertices`] follows. (D N)_e is the difference of the
/// normals of the two faces at edge e; V_e, a vector of each edge, is the part of it that belongs to an even bend; (S V)_e
/// is the difference of V's gradients in the two faces, unfolded into one plane, so that S V = 0 for normals that change
/// linearly; w_e = exp(−(|(D N)_e| / 1.5)⁴), anew in each iteration.
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`TgvParams`]; lengths len and areas a count in mean edge lengths, so the weights have no unit.
/// - `watch`: hears of the two systems, each when its pattern is analysed and when it is factorised, unless
///   `normal_iterations` is 0, then of every iteration: 4 + `normal_iterations` + `vertex_iterations` in all.
///
/// Returns (V) new positions, in mesh units. A boundary edge has no term; an edge of more than two faces has one for each
/// face and the next. Faces that run against a neighbour count as turned over. A face without area takes what its
/// neighbours agree on; a face that uses a vertex twice has no terms.
///
/// Memory: about 4 kB a face, growing with the logarithm of their number: the Cholesky factors of two systems.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`], also when a system cannot be solved,
/// [`crate::GeomError::OutOfMemory`] if `watch` does not allow a factor, or [`crate::GeomError::Cancelled`].
///
/// Source: Liu et al. 2022, with another S. `Choice:` S, w and the defaults, docs/choices.md#total-generalised-variation.
///
/// ```
/// use gcnd_geom::normals::{TgvParams, tgv};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(6, 6);
/// vertices[24].z = 0.3;
/// let topology = Topology::new(faces, vertices.len())?;
/// let denoised = tgv(&topology, &vertices, &TgvParams::default(), &mut Watch::silent())?;
/// assert!(denoised[24].z < 0.15);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn tgv(
    topology: &Topology,
    vertices: &[DVec3],
    params: &TgvParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let of_systems = if params.normal_iterations > 0 { 4 } else { 0 };
    let total = params.normal_iterations.saturating_add(params.vertex_iterations).saturating_add(of_systems);
    let (mut run, positions) = Run::start(topology, vertices, total, watch)?;
    let geometry = FaceGeometry::compute(&positions, topology.faces());
    let normals = if params.normal_iterations > 0 {
        let operators = Operators::new(topology, &positions, &geometry);
        let mut solver = Solver::new(&operators, params, &geometry.normals, &mut run)?;
        for _ in 0..params.normal_iterations {
            if !solver.step() {
                return Err(run.diverged());
            }
            run.tick()?;
        }
        solver.into_normals()
    } else {
        geometry.normals
    };
    move_to_normals(topology, run, positions, &normals, params.vertex_iterations, params.fix_boundary)
}
