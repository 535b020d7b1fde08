//! Refinement that stops where it would take detail away.

use crate::error::{GeomError, Result, check_len};
use crate::normals::refine::{RefineParams, refine_counted, unit_normals};
use crate::topology::Topology;
use crate::watch::{Ticks, Watch};
use glam::DVec3;
use rayon::prelude::*;

/// Faces of one unit of parallel work.
const CHUNK: usize = 4096;

/// Parameters of [`refine_consistent`].
#[derive(Debug, Clone, PartialEq)]
pub struct AdaptiveParams {
    /// The refinement itself (Eq. 5).
    pub refine: RefineParams,
    /// k: how far refinement may move normals, in units of how far the predictions disagree; > 0.
    pub tolerance: f64,
    /// Rounds of averaging over edge neighbours that make the region of a decision; about √rounds faces wide.
    pub region_rounds: usize,
}

impl Default for AdaptiveParams {
    fn default() -> Self {
        Self { refine: RefineParams::default(), tolerance: 1.0, region_rounds: 20 }
    }
}

impl AdaptiveParams {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`GeomError::InvalidParameter`] with the name, the value and what is allowed.
    pub fn validate(&self) -> Result<()> {
        if !(self.tolerance.is_finite() && self.tolerance > 0.0) {
            let value = self.tolerance.to_string();
            let allowed = "a positive finite number";
            return Err(GeomError::InvalidParameter { name: "tolerance", value, allowed });
        }
        self.refine.validate()
    }
}

/// Refines normals (Eq. 5) where that moves them no further than the predictions behind them disagree.
///
/// With ṅ the refined and n̂ the predicted normals, s the spread of the predictions, and ⟨·⟩ an average over the
/// region around a face:
///
/// `D² = ⟨‖ṅ − n̂‖²⟩`, `S² = ⟨s²⟩`, `w = exp(−(D² / (k² S²))²)`, result `normalize(w ṅ + (1 − w) n̂)`.
///
/// On flat and smooth regions the filter moves normals about as far as the predictions disagree: what it removes is
/// error. On detail it moves them further: what it removes is shape, and the predictions stay.
///
/// # Arguments
/// * `vertices` – positions (V), mesh units.
/// * `normals` – predicted normals (F), any length; zero where unknown.
/// * `spread` – disagreement of the predictions (F), as [`crate::patch::NormalAccumulator::spread`] gives it.
/// * `watch` – hears of the steps of [`crate::normals::refine_normals`], then of every round of both averages.
///
/// # Returns
/// Unit normals (F); zero where nothing is known.
///
/// # Errors
/// Those of [`crate::normals::refine_normals`]; [`GeomError::LengthMismatch`] and [`GeomError::InvalidParameter`] for `spread`.
///
/// Paper: Sec. 6.1, where m is chosen by hand for a mesh. Choice: docs/choices.md#refinement.
///
/// ```
/// use gcnd_geom::normals::{AdaptiveParams, refine_consistent};
/// use gcnd_geom::{DVec3, Topology, Watch, fixtures};
/// let (vertices, faces) = fixtures::grid(4, 4);
/// let topology = Topology::new(faces, vertices.len())?;
/// let (normals, spread) = (vec![DVec3::Z; 32], vec![0.05; 32]);
/// let (params, mut watch) = (AdaptiveParams::default(), Watch::silent());
/// let refined = refine_consistent(&topology, &vertices, &normals, &spread, &params, &mut watch)?;
/// assert_eq!(refined, normals);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn refine_consistent(
    topology: &Topology,
    vertices: &[DVec3],
    normals: &[DVec3],
    spread: &[f64],
    params: &AdaptiveParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    check_len("spread", topology.n_faces(), spread.len())?;
    if let Some(face_id) = spread.iter().position(|s| !(s.is_finite() && *s >= 0.0)) {
        let value = format!("{} at face {face_id}", spread[face_id]);
        return Err(GeomError::InvalidParameter { name: "spread", value, allowed: "0 or more" });
    }
    let predicted = unit_normals(normals, topology.n_faces())?;
    let total = params.refine.steps().saturating_add(params.region_rounds.saturating_mul(2));
    let mut ticks = Ticks::new(total, watch);
    let refined = refine_counted(topology, vertices, &predicted, &params.refine, &mut ticks)?;
    let moved = predicted.par_iter().zip(&refined).map(|(p, r)| p.distance_squared(*r)).collect();
    let moved = regional_mean(topology, moved, params.region_rounds, &mut ticks)?;
    let squares = spread.iter().map(|s| s * s).collect();
    let spread = regional_mean(topology, squares, params.region_rounds, &mut ticks)?;
    let allowed = params.tolerance * params.tolerance;
    let blend = |(((p, r), moved), spread): (((&DVec3, &DVec3), &f64), &f64)| {
        let weight = if *moved == 0.0 { 1.0 } else { (-(moved / (allowed * spread)).powi(2)).exp() };
        p.lerp(*r, weight).try_normalize().unwrap_or(*p)
    };
    Ok(predicted.par_iter().zip(&refined).zip(&moved).zip(&spread).map(blend).collect())
}

/// Averages a value over each face and its edge neighbours, `rounds` times.
fn regional_mean(
    topology: &Topology,
    mut values: Vec<f64>,
    rounds: usize,
    ticks: &mut Ticks<'_, '_>,
) -> Result<Vec<f64>> {
    let mut next = vec![0.0; values.len()];
    for _ in 0..rounds {
        next.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(face_id, mean)| {
            let neighbors = topology.edge_neighbors(face_id);
            let sum: f64 = neighbors.iter().map(|&j| values[j as usize]).sum();
            *mean = (values[face_id] + sum) / (1 + neighbors.len()) as f64;
        });
        std::mem::swap(&mut values, &mut next);
        ticks.tick()?;
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    /// A grid whose normals wave by up to `amplitude` from face to face.
    fn wavy(amplitude: f64) -> (Topology, Vec<DVec3>, Vec<DVec3>) {
        let (vertices, faces) = fixtures::grid(12, 12);
        let mut normals = vec![DVec3::Z; faces.len()];
        fixtures::jitter(&mut normals, amplitude, 3);
        let normals = normals.into_iter().map(DVec3::normalize).collect();
        (Topology::new(faces, vertices.len()).expect("valid"), vertices, normals)
    }

    fn params() -> AdaptiveParams {
        let refine = RefineParams { iterations: 12, ..RefineParams::default() };
        AdaptiveParams { refine, tolerance: 1.0, region_rounds: 10 }
    }

    fn mean_error(normals: &[DVec3]) -> f64 {
        normals.iter().map(|n| n.angle_between(DVec3::Z)).sum::<f64>() / normals.len() as f64
    }

    #[test]
    fn error_that_the_predictions_admit_is_refined_away() {
        let (topology, vertices, normals) = wavy(0.05);
        let spread = vec![0.2; normals.len()];
        let result =
            refine_consistent(&topology, &vertices, &normals, &spread, &params(), &mut Watch::silent())
                .expect("valid");
        assert!(mean_error(&result) < 0.3 * mean_error(&normals));
    }

    #[test]
    fn shape_that_the_predictions_agree_on_stays() {
        let (topology, vertices, normals) = wavy(0.05);
        let spread = vec![0.005; normals.len()];
        let result =
            refine_consistent(&topology, &vertices, &normals, &spread, &params(), &mut Watch::silent())
                .expect("valid");
        for (result, normal) in result.iter().zip(&normals) {
            assert!(result.distance(*normal) < 1e-6);
        }
    }

    #[test]
    fn no_spread_at_all_keeps_the_predictions() {
        let (topology, vertices, normals) = wavy(0.05);
        let spread = vec![0.0; normals.len()];
        let result =
            refine_consistent(&topology, &vertices, &normals, &spread, &params(), &mut Watch::silent())
                .expect("valid");
        for (result, normal) in result.iter().zip(&normals) {
            assert!(result.distance(*normal) < 1e-12);
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        let (topology, vertices, normals) = wavy(0.05);
        let run = |spread: &[f64], tolerance| {
            let params = AdaptiveParams { tolerance, ..params() };
            refine_consistent(&topology, &vertices, &normals, spread, &params, &mut Watch::silent())
                .unwrap_err()
        };
        let good = vec![0.1; normals.len()];
        assert!(matches!(run(&good, 0.0), GeomError::InvalidParameter { name: "tolerance", .. }));
        assert!(matches!(run(&good[1..], 1.0), GeomError::LengthMismatch { what: "spread", .. }));
        let mut bad = good.clone();
        bad[4] = f64::NAN;
        assert!(matches!(run(&bad, 1.0), GeomError::InvalidParameter { name: "spread", .. }));
    }
}
