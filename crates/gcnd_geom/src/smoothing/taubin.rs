//! Taubin smoothing: a shrinking and a growing pass by turns.

use crate::error::{Result, check_parameter};
use crate::smoothing::umbrella::smooth;
use crate::topology::Topology;
use crate::watch::Watch;
use glam::DVec3;

/// Parameters of [`taubin`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaubinParams {
    /// λ, the shrinking pass; 0 < λ ≤ 1.
    pub lambda: f64,
    /// μ, the growing pass; −2 ≤ μ < −λ. The pass band ends at 1/λ + 1/μ, about 0.1 by default.
    pub mu: f64,
    /// Pairs of a shrinking and a growing pass.
    pub iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
}

impl Default for TaubinParams {
    fn default() -> Self {
        Self { lambda: 0.5, mu: -0.53, iterations: 10, fix_boundary: true }
    }
}

impl TaubinParams {
    /// Checks λ and μ.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        check_parameter(
            "lambda",
            self.lambda,
            self.lambda > 0.0 && self.lambda <= 1.0,
            "above 0 and at most 1",
        )?;
        check_parameter(
            "mu",
            self.mu,
            (-2.0..-self.lambda).contains(&self.mu),
            "-2 or more and below -lambda",
        )
    }
}

/// Smooths without shrinking: a pass with λ, then one with μ < −λ, `iterations` times, each
/// v_i ← v_i + factor · (1 / |N_i| · Σ_{j ∈ N_i} v_j − v_i), with N_i the vertices that share an edge with i.
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`TaubinParams`].
/// - `watch`: hears of every pair of passes.
///
/// Returns (V) new positions, in mesh units. Vertices without faces stay.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`], which a far too strong μ brings about, or
/// [`crate::GeomError::Cancelled`].
///
/// Source: Taubin 1995, Sec. 3 (λ|μ algorithm), with equal weights.
///
/// ```
/// use gcnd_geom::smoothing::{TaubinParams, taubin};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (vertices, faces) = fixtures::icosphere(3);
/// let topology = Topology::new(faces, vertices.len())?;
/// let smoothed = taubin(&topology, &vertices, &TaubinParams::default(), &mut Watch::silent())?;
/// assert!(smoothed.iter().all(|v| (v.length() - 1.0).abs() < 0.02));
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn taubin(
    topology: &Topology,
    vertices: &[DVec3],
    params: &TaubinParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    smooth(topology, vertices, &[params.lambda, params.mu], params.iterations, params.fix_boundary, watch)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GeomError, fixtures};

    #[test]
    fn one_pair_of_passes_by_hand() {
        // Around its centre a tetrahedron's vertex is an eigenvector: the mean of the others is −1/3 of it, so each
        // pass multiplies it by 1 − 4/3 · factor.
        let (vertices, faces) = fixtures::tetrahedron();
        let topology = Topology::new(faces, 4).expect("valid");
        let params = TaubinParams { lambda: 0.3, mu: -0.6, iterations: 1, fix_boundary: false };
        let moved = taubin(&topology, &vertices, &params, &mut Watch::silent()).expect("valid");
        let center = DVec3::splat(0.25);
        for (moved, v) in moved.iter().zip(&vertices) {
            assert!(moved.distance(center + 0.6 * 1.8 * (*v - center)) < 1e-15);
        }
    }

    #[test]
    fn too_strong_a_mu_diverges_and_says_when() {
        let (mut vertices, faces) = fixtures::icosphere(2);
        fixtures::jitter(&mut vertices, 0.1, 1);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let params = TaubinParams { lambda: 0.1, mu: -2.0, iterations: 200, fix_boundary: true };
        let error = taubin(&topology, &vertices, &params, &mut Watch::silent()).unwrap_err();
        assert!(matches!(error, GeomError::Diverged { iteration: 2..20 }), "{error}");
    }
}
