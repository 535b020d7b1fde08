//! HC-Laplacian smoothing, which pushes vertices back towards where they came from.

use crate::error::{Result, check_parameter};
use crate::smoothing::umbrella::{CHUNK, Umbrella};
use crate::topology::Topology;
use crate::watch::{Run, Watch};
use glam::DVec3;
use rayon::prelude::*;

/// Parameters of [`hc_laplacian`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HcLaplacianParams {
    /// α: how much the original position counts against the one before the pass; 0 ≤ α ≤ 1.
    pub alpha: f64,
    /// β: how much a vertex's own correction counts against its neighbours'; 0 ≤ β ≤ 1.
    pub beta: f64,
    /// Passes over the vertices.
    pub iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
}

impl Default for HcLaplacianParams {
    fn default() -> Self {
        Self { alpha: 0.1, beta: 0.5, iterations: 10, fix_boundary: true }
    }
}

impl HcLaplacianParams {
    /// Checks α and β.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        for (name, value) in [("alpha", self.alpha), ("beta", self.beta)] {
            check_parameter(name, value, (0.0..=1.0).contains(&value), "0 to 1")?;
        }
        Ok(())
    }
}

/// Smooths and takes back most of the shrinking, `iterations` times; with o the original positions, q those before and
/// p those after a full Laplacian step p_i = 1 / |N_i| · Σ_{j ∈ N_i} q_j:
/// b_i = p_i − (α o_i + (1 − α) q_i), then p_i ← p_i − (β b_i + (1 − β) / |N_i| · Σ_{j ∈ N_i} b_j).
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`HcLaplacianParams`].
/// - `watch`: hears of every iteration.
///
/// Returns (V) new positions, in mesh units. Vertices without faces stay.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`] or [`crate::GeomError::Cancelled`].
///
/// Source: Vollmer et al. 1999, Sec. 3 (simultaneous version).
///
/// ```
/// use gcnd_geom::smoothing::{HcLaplacianParams, hc_laplacian};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (vertices, faces) = fixtures::icosphere(3);
/// let topology = Topology::new(faces, vertices.len())?;
/// let smoothed = hc_laplacian(&topology, &vertices, &HcLaplacianParams::default(), &mut Watch::silent())?;
/// assert!(smoothed.iter().all(|v| (v.length() - 1.0).abs() < 0.02));
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn hc_laplacian(
    topology: &Topology,
    vertices: &[DVec3],
    params: &HcLaplacianParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let (mut run, mut current) = Run::start(topology, vertices, params.iterations, watch)?;
    let umbrella = Umbrella::new(topology, params.fix_boundary);
    let original = current.clone();
    let mut smoothed = current.clone();
    let mut excess = vec![DVec3::ZERO; current.len()];
    for _ in 0..params.iterations {
        umbrella.step(&current, 1.0, &mut smoothed);
        let HcLaplacianParams { alpha, beta, .. } = *params;
        excess.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, b)| {
            *b = smoothed[i] - (alpha * original[i] + (1.0 - alpha) * current[i]);
        });
        current.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, v)| {
            if !umbrella.stays(i) {
                *v = smoothed[i] - (beta * excess[i] + (1.0 - beta) * umbrella.mean(&excess, i));
            }
        });
        run.tick_positions(&current)?;
    }
    Ok(run.finish(current))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn moved(params: &HcLaplacianParams) -> (Vec<DVec3>, Vec<DVec3>) {
        let (vertices, faces) = fixtures::tetrahedron();
        let topology = Topology::new(faces, 4).expect("valid");
        (hc_laplacian(&topology, &vertices, params, &mut Watch::silent()).expect("valid"), vertices)
    }

    #[test]
    fn one_pass_by_hand() {
        // Around the centre: p = −q/3, b = −4/3 q, mean of the others' b = 4/9 q.
        let params = HcLaplacianParams { alpha: 0.7, beta: 0.25, iterations: 1, fix_boundary: true };
        let (moved, vertices) = moved(&params);
        let factor = -1.0 / 3.0 - (0.25 * -4.0 / 3.0 + 0.75 * 4.0 / 9.0);
        let center = DVec3::splat(0.25);
        for (moved, v) in moved.iter().zip(&vertices) {
            assert!(moved.distance(center + factor * (*v - center)) < 1e-15);
        }
    }

    #[test]
    fn beta_one_takes_everything_back() {
        let params = HcLaplacianParams { alpha: 0.0, beta: 1.0, iterations: 7, fix_boundary: true };
        let (moved, vertices) = moved(&params);
        for (moved, v) in moved.iter().zip(&vertices) {
            assert!(moved.distance(*v) < 1e-15);
        }
    }
}
