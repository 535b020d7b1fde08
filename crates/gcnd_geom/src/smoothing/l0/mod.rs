//! Mesh denoising by L0 minimisation (He, Schaefer 2013).

mod operator;
mod system;

use crate::edge_pairs::find_edge_pairs;
use crate::error::{Result, check_parameter, check_positive};
use crate::face_geometry::mean_edge_length;
use crate::topology::Topology;
use crate::watch::{Run, Watch};
use glam::DVec3;
use operator::{mean_dihedral_angle, measure_edges};
use system::System;

/// Parameters of [`l0`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct L0Params {
    /// λ, in mesh units squared: what an edge may bend before it counts; `None` takes 0.2 · ē² · γ̄, with ē the mean
    /// edge length and γ̄ the mean angle between the normals at an edge, in radians.
    pub lambda: Option<f64>,
    /// α in the first iteration, the weight of the regularisation; `None` takes 0.1 · γ̄.
    pub alpha: Option<f64>,
    /// What α is multiplied by after each iteration; 0 < mu_alpha ≤ 1.
    pub mu_alpha: f64,
    /// β in the first iteration.
    pub beta: f64,
    /// Iterations end when β has reached this.
    pub beta_max: f64,
    /// μ: what β is multiplied by after each iteration; above 1.
    pub mu_beta: f64,
}

impl Default for L0Params {
    fn default() -> Self {
        Self {
            lambda: None,
            alpha: None,
            mu_alpha: 0.5,
            beta: 1e-3,
            beta_max: 1e3,
            mu_beta: std::f64::consts::SQRT_2,
        }
    }
}

/// Steps from `beta` to `beta_max` at most.
const MAX_ITERATIONS: f64 = 20_000.0;

impl L0Params {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        for (name, value) in [("lambda", self.lambda), ("alpha", self.alpha)] {
            let value = value.unwrap_or_default();
            check_parameter(name, value, value.is_finite() && value >= 0.0, "a finite number, 0 or more")?;
        }
        let is_decay = self.mu_alpha > 0.0 && self.mu_alpha <= 1.0;
        check_parameter("mu_alpha", self.mu_alpha, is_decay, "above 0 and at most 1")?;
        check_positive("beta", self.beta)?;
        check_positive("beta_max", self.beta_max)?;
        let is_growth = self.mu_beta >= 1.001 && self.mu_beta.is_finite();
        check_parameter("mu_beta", self.mu_beta, is_growth, "1.001 or more, finite")?;
        let is_reached = (self.beta_max / self.beta).ln() <= MAX_ITERATIONS * self.mu_beta.ln();
        check_parameter(
            "beta",
            self.beta,
            is_reached,
            "so near to beta_max that mu_beta takes it there in 20000 steps",
        )
    }

    /// β of every iteration.
    fn betas(&self) -> Vec<f64> {
        std::iter::successors(Some(self.beta), |beta| Some(beta * self.mu_beta))
            .take_while(|beta| *beta < self.beta_max)
            .collect()
    }
}

/// Flattens all but as few edges as possible: minimises
/// |p − p*|² + α Σ_e |R_e(p)|² + β Σ_e |D_e(p) − δ_e|² + λ Σ_e [δ_e ≠ 0]
/// by turns over δ, where δ_e = D_e(p) if |D_e(p)|² ≥ λ/β and else 0, and over p, a sparse linear system; after each turn
/// β grows and α falls. D_e is the area-based edge operator, zero where the two faces at an edge are coplanar, and
/// R_e = p₁ − p₂ + p₃ − p₄ for an edge p₁p₃ with p₂ and p₄ opposite.
///
/// - `topology`, `vertices` (V), p* in mesh units; they are not changed.
/// - `params`: see [`L0Params`].
/// - `watch`: hears of the analysis of the system's pattern, then of every iteration, 41 by default.
///
/// Returns (V) new positions, in mesh units. Edges on a boundary have no operator; an edge of more than two faces has
/// one for each face and the next; faces without area, and edges beside faces so thin that a weight in D exceeds 1000,
/// have none. Vertices without faces stay.
///
/// Memory: about 2 kB a vertex, growing with the logarithm of their number: the system's Cholesky factor.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`], also when α or β have grown so large that
/// rounding leaves next to nothing of p* in the system, [`crate::GeomError::OutOfMemory`] if `watch` does not allow the
/// factor, or [`crate::GeomError::Cancelled`].
///
/// Source: He, Schaefer 2013, Eqs. 5, 8 and 9. The λ and α are those of the program of Zhang et al. 2015, with γ̄ averaged
/// without sign: it averages signed angles, which cancel, and hardly denoises.
///
/// ```
/// use gcnd_geom::smoothing::{L0Params, l0};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(6, 6);
/// vertices[24].z = 0.3;
/// let topology = Topology::new(faces, vertices.len())?;
/// let denoised = l0(&topology, &vertices, &L0Params::default(), &mut Watch::silent())?;
/// assert!(denoised[24].z < 0.1);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn l0(
    topology: &Topology,
    vertices: &[DVec3],
    params: &L0Params,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let betas = params.betas();
    let (mut run, mut positions) = Run::start(topology, vertices, betas.len().saturating_add(1), watch)?;
    let stencils = find_edge_pairs(topology);
    if stencils.is_empty() || betas.is_empty() {
        return Ok(vertices.to_vec());
    }
    let gamma = mean_dihedral_angle(&stencils, &positions);
    let edge_length = mean_edge_length(&positions, topology.faces());
    let scaled = params.lambda.map(|lambda| lambda * run.scale * run.scale);
    let lambda = scaled.unwrap_or(0.2 * edge_length * edge_length * gamma);
    let mut alpha = params.alpha.unwrap_or(0.1 * gamma);
    let noisy = positions.clone();
    let mut system = System::new(&stencils, positions.len(), |bytes| run.claim(bytes))?;
    run.tick()?;
    let mut edges = Vec::new();
    for beta in betas {
        measure_edges(&stencils, &positions, lambda / beta, &mut edges);
        let is_solved = system.solve(&stencils, &edges, alpha, beta, &noisy, &mut positions);
        if !is_solved {
            return Err(run.diverged());
        }
        alpha *= params.mu_alpha;
        run.tick_positions(&positions)?;
    }
    Ok(run.finish(positions))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GeomError, fixtures};

    fn denoised((vertices, faces): &fixtures::MeshParts, params: &L0Params) -> Result<Vec<DVec3>> {
        let topology = Topology::new(faces.clone(), vertices.len()).expect("valid");
        l0(&topology, vertices, params, &mut Watch::silent())
    }

    #[test]
    fn a_folded_pair_stays_or_flattens_as_lambda_asks() {
        let mesh = fixtures::two_triangles();
        let with = |lambda| L0Params { lambda: Some(lambda), alpha: Some(0.0), ..L0Params::default() };
        let worst =
            |moved: &[DVec3]| moved.iter().zip(&mesh.0).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        // |D|² is at most 1 here: 1e-9 over the first β keeps it, 1e6 over the last does not.
        assert!(worst(&denoised(&mesh, &with(1e-9)).expect("valid")) < 1e-9);
        let flat = denoised(&mesh, &with(1e6)).expect("valid");
        let height = (flat[3] - flat[0]).dot((flat[1] - flat[0]).cross(flat[2] - flat[0]));
        assert!(height.abs() < 2e-3 && worst(&flat) > 0.05, "{height}");
    }

    #[test]
    fn betas_are_forty_by_default() {
        let betas = L0Params::default().betas();
        assert_eq!((betas.len(), betas[0]), (40, 1e-3));
        assert!(betas[39] < 1e3 && betas[39] * 1.5 > 1e3);
    }

    #[test]
    fn vertices_far_from_any_edge_stay() {
        let (mut vertices, faces) = fixtures::two_triangles();
        vertices.push(DVec3::splat(1.5));
        let moved = denoised(&(vertices.clone(), faces), &L0Params::default()).expect("valid");
        assert!(moved[4].distance(vertices[4]) < 1e-15);
        let lonely = (vertices[..3].to_vec(), vec![[0, 1, 2]]);
        assert_eq!(denoised(&lonely, &L0Params::default()), Ok(lonely.0.clone()));
    }

    #[test]
    fn parameters_out_of_range_name_themselves() {
        let default = L0Params::default();
        let cases = [
            ("lambda", L0Params { lambda: Some(-1.0), ..default }),
            ("alpha", L0Params { alpha: Some(f64::NAN), ..default }),
            ("mu_alpha", L0Params { mu_alpha: 1.5, ..default }),
            ("beta", L0Params { beta: 0.0, ..default }),
            ("beta_max", L0Params { beta_max: f64::INFINITY, ..default }),
            ("mu_beta", L0Params { mu_beta: 1.0, ..default }),
            // Times 1.001 and rounded it stays what it is.
            ("beta", L0Params { beta: 5e-324, mu_beta: 1.001, ..default }),
        ];
        for (expected, params) in cases {
            match denoised(&fixtures::cube(), &params) {
                Err(GeomError::InvalidParameter { name, .. }) => assert_eq!(name, expected),
                other => panic!("{expected}: {other:?}"),
            }
        }
    }
}
