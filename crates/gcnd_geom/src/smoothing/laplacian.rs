//! Laplacian smoothing with uniform weights.

use crate::error::{Result, check_parameter};
use crate::smoothing::umbrella::smooth;
use crate::topology::Topology;
use crate::watch::Watch;
use glam::DVec3;

/// Parameters of [`laplacian`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaplacianParams {
    /// λ: the part of the way to the neighbours' mean; 0 < λ ≤ 1.
    pub lambda: f64,
    /// Passes over the vertices.
    pub iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
}

impl Default for LaplacianParams {
    fn default() -> Self {
        Self { lambda: 0.5, iterations: 10, fix_boundary: true }
    }
}

impl LaplacianParams {
    /// Checks λ.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the value.
    pub fn validate(&self) -> Result<()> {
        check_parameter(
            "lambda",
            self.lambda,
            self.lambda > 0.0 && self.lambda <= 1.0,
            "above 0 and at most 1",
        )
    }
}

/// Moves every vertex towards the mean of its neighbours, `iterations` times:
/// v_i ← v_i + λ · (1 / |N_i| · Σ_{j ∈ N_i} v_j − v_i), with N_i the vertices that share an edge with i.
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`LaplacianParams`].
/// - `watch`: hears of every iteration.
///
/// Returns (V) new positions, in mesh units. It shrinks the mesh and rounds its edges; vertices without faces stay.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`],
/// [`crate::GeomError::NonFiniteVertex`] or [`crate::GeomError::Cancelled`].
///
/// Source: Taubin 1995, Sec. 2 (Gaussian smoothing with equal weights).
///
/// ```
/// use gcnd_geom::smoothing::{LaplacianParams, laplacian};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(4, 4);
/// vertices[12].z = 1.0;
/// let topology = Topology::new(faces, vertices.len())?;
/// let params = LaplacianParams { iterations: 1, ..LaplacianParams::default() };
/// let smoothed = laplacian(&topology, &vertices, &params, &mut Watch::silent())?;
/// assert_eq!(smoothed[12].z, 0.5);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn laplacian(
    topology: &Topology,
    vertices: &[DVec3],
    params: &LaplacianParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    smooth(topology, vertices, &[params.lambda], params.iterations, params.fix_boundary, watch)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn a_tetrahedron_shrinks_to_its_middle_by_hand() {
        // v + λ (m − v) with m the mean of the other three = c + (c − v) / 3 around the centre c.
        let (vertices, faces) = fixtures::tetrahedron();
        let center = DVec3::splat(0.25);
        let topology = Topology::new(faces, 4).expect("valid");
        let params = LaplacianParams { lambda: 0.75, iterations: 1, fix_boundary: true };
        let moved = laplacian(&topology, &vertices, &params, &mut Watch::silent()).expect("valid");
        for v in moved {
            assert!(v.distance(center) < 1e-15, "{v}");
        }
    }
}
