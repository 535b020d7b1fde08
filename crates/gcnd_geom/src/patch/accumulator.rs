//! Averaging what overlapping patches predict.
//!
//! Choice: docs/choices.md#cover.

use crate::error::{GeomError, Result, check_len};
use glam::{DMat3, DVec3};

/// Averages the normals that overlapping patches predict for each face:
/// n_f = normalize(Σ_p exp(−2 ‖c̄_p‖²) R_p n̂_p), c̄_p the face's centroid in patch p in patch radii.
///
/// Patches are added in the order given, so the result depends on nothing else.
///
/// ```
/// use gcnd_geom::{patch::NormalAccumulator, DVec3};
/// let mut sum = NormalAccumulator::new(2);
/// sum.add_centers(&[0], &[2.0, 0.0, 0.0], &[0., 1., 0., 0., 0., 1., 1., 0., 0.])?;
/// assert_eq!(sum.weights(), [1.0, 0.0]);
/// assert_eq!(sum.normals(&[DVec3::X, DVec3::Y])?, [DVec3::Z, DVec3::Y]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
///
/// Choice: docs/choices.md#cover.
#[derive(Debug, Clone, PartialEq)]
pub struct NormalAccumulator {
    sum: Vec<DVec3>,
    weight: Vec<f64>,
}

impl NormalAccumulator {
    /// Starts with nothing predicted for `n_faces` faces.
    pub fn new(n_faces: usize) -> Self {
        Self { sum: vec![DVec3::ZERO; n_faces], weight: vec![0.0; n_faces] }
    }

    /// Adds the predictions of P patches for all their nodes.
    ///
    /// `face_ids` (P, N) and `mask` (P, N; 0 = ignore), `features` (P, N, `n_channels`) with the centroid in
    /// channels 0–2 and `world_from_patch` (P, 3, 3) as [`super::PatchExtractor::extract`] wrote them;
    /// `predicted` (P, N, 3) in the patch frame, each scaled to unit length here, zero or NaN ignored.
    ///
    /// # Errors
    /// [`GeomError::LengthMismatch`] naming the array, [`GeomError::InvalidParameter`] for a face id that does
    /// not exist or fewer than 3 channels; nothing is added then.
    pub fn add(
        &mut self,
        face_ids: &[u32],
        mask: &[u8],
        predicted: &[f32],
        features: &[f32],
        n_channels: usize,
        world_from_patch: &[f64],
    ) -> Result<()> {
        let n_patches = world_from_patch.len() / 9;
        let n_nodes = face_ids.len().checked_div(n_patches).unwrap_or(0);
        check_len("world_from_patch", n_patches * 9, world_from_patch.len())?;
        check_len("face_ids", n_patches * n_nodes, face_ids.len())?;
        check_len("mask", face_ids.len(), mask.len())?;
        check_len("predicted", face_ids.len() * 3, predicted.len())?;
        check_len("features", face_ids.len() * n_channels, features.len())?;
        if n_channels < 3 {
            let value = n_channels.to_string();
            return Err(GeomError::InvalidParameter { name: "n_channels", value, allowed: "3 or more" });
        }
        self.check_face_ids(face_ids)?;
        for (node, (&face_id, _)) in face_ids.iter().zip(mask).enumerate().filter(|(_, (_, m))| **m != 0) {
            let frame = frame_at(world_from_patch, node / n_nodes);
            let centroid = vector_at(features, node * n_channels);
            let weight = (-2.0 * centroid.length_squared()).exp();
            self.add_one(face_id, weight, frame * vector_at(predicted, node * 3));
        }
        Ok(())
    }

    /// Adds one prediction per patch, for its centre, with weight 1.
    ///
    /// `face_ids` (P) the centres, `predicted` (P, 3) in the patch frame, `world_from_patch` (P, 3, 3).
    ///
    /// # Errors
    /// As [`NormalAccumulator::add`].
    pub fn add_centers(
        &mut self,
        face_ids: &[u32],
        predicted: &[f32],
        world_from_patch: &[f64],
    ) -> Result<()> {
        check_len("predicted", face_ids.len() * 3, predicted.len())?;
        check_len("world_from_patch", face_ids.len() * 9, world_from_patch.len())?;
        self.check_face_ids(face_ids)?;
        for (patch, &face_id) in face_ids.iter().enumerate() {
            let normal = vector_at(predicted, patch * 3);
            self.add_one(face_id, 1.0, frame_at(world_from_patch, patch) * normal);
        }
        Ok(())
    }

    /// How much the predictions for each face weigh together (F); 0 where there are none.
    pub fn weights(&self) -> &[f64] {
        &self.weight
    }

    /// The averaged unit normals (F); where nothing was added, or what was cancels, the face's `fallback` (F).
    ///
    /// # Errors
    /// [`GeomError::LengthMismatch`] when `fallback` has another length.
    pub fn normals(&self, fallback: &[DVec3]) -> Result<Vec<DVec3>> {
        check_len("fallback", self.sum.len(), fallback.len())?;
        let pairs = self.sum.iter().zip(fallback);
        Ok(pairs.map(|(sum, &fallback)| sum.try_normalize().unwrap_or(fallback)).collect())
    }

    /// How far the predictions for each face disagree (F): √(2(1 − ‖Σ w n̂‖ / Σ w)), n̂ unit.
    ///
    /// The root of the weighted mean squared distance of the predictions from their mean direction, 0 to √2, about
    /// an angle in radians; 0 for a face with fewer than two predictions.
    pub fn spread(&self) -> Vec<f64> {
        let pairs = self.sum.iter().zip(&self.weight);
        pairs
            .map(
                |(sum, &weight)| {
                    if weight > 0.0 { (2.0 * (1.0 - sum.length() / weight)).max(0.0).sqrt() } else { 0.0 }
                },
            )
            .collect()
    }

    fn add_one(&mut self, face_id: u32, weight: f64, normal: DVec3) {
        // A network's NaN must not spread to what other patches say of the face.
        if let Some(unit) = normal.try_normalize().filter(|_| weight.is_finite()) {
            self.sum[face_id as usize] += weight * unit;
            self.weight[face_id as usize] += weight;
        }
    }

    fn check_face_ids(&self, face_ids: &[u32]) -> Result<()> {
        match face_ids.iter().find(|&&face_id| face_id as usize >= self.sum.len()) {
            Some(face_id) => Err(GeomError::InvalidParameter {
                name: "face_ids",
                value: face_id.to_string(),
                allowed: "ids below the number of faces",
            }),
            None => Ok(()),
        }
    }
}

#[inline]
fn vector_at(values: &[f32], start: usize) -> DVec3 {
    DVec3::new(values[start].into(), values[start + 1].into(), values[start + 2].into())
}

/// The p-th 3×3 matrix of a row-major array.
#[inline]
fn frame_at(matrices: &[f64], patch: usize) -> DMat3 {
    DMat3::from_cols_slice(&matrices[patch * 9..patch * 9 + 9]).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns y, z, x: asymmetric, so that a transposed reading shows.
    const CYCLE: [f64; 9] = [0., 0., 1., 1., 0., 0., 0., 1., 0.];
    const IDENTITY: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];

    #[test]
    fn average_by_hand() {
        let mut accumulator = NormalAccumulator::new(4);
        // Two patches of two nodes with four channels; the last node is a repeat.
        let frames = [CYCLE, IDENTITY].concat();
        #[rustfmt::skip]
        let features = [
            0.0, 0.0, 0.0, 9.0,  0.5, 0.5, 0.0, 9.0,
            0.0, 0.0, 0.0, 9.0,  0.0, 0.0, 0.0, 9.0,
        ];
        let predicted = [1., 0., 0., 1., 0., 0., 0., 0., 3., 5., 5., 5.];
        accumulator.add(&[0, 1, 1, 2], &[1, 1, 1, 0], &predicted, &features, 4, &frames).expect("valid");
        // Face 0: CYCLE · x = y. Face 1: exp(−2 · 0.5) y + z, the 3 z scaled to unit length. Face 2: masked.
        // Face 3: never seen.
        let normals = accumulator.normals(&[DVec3::X; 4]).expect("valid");
        let weight = (-1.0f64).exp();
        let expected = DVec3::new(0.0, weight, 1.0).normalize();
        assert_eq!(normals[0], DVec3::Y);
        assert!((normals[1] - expected).length() < 1e-15);
        assert_eq!(normals[2..], [DVec3::X; 2]);
        assert_eq!(accumulator.weights(), [1.0, weight + 1.0, 0.0, 0.0]);
        let spread = accumulator.spread();
        let agreement = (1.0 + weight * weight).sqrt() / (1.0 + weight);
        assert!((spread[1] - (2.0 * (1.0 - agreement)).sqrt()).abs() < 1e-15);
        assert_eq!([spread[0], spread[2], spread[3]], [0.0; 3]);
    }

    #[test]
    fn cancelled_and_non_finite_predictions_fall_back() {
        let mut accumulator = NormalAccumulator::new(2);
        let frames = [IDENTITY, IDENTITY, IDENTITY].concat();
        let predicted = [0., 0., 1., 0., 0., -1., f32::NAN, 0., 0.];
        accumulator.add_centers(&[0, 0, 1], &predicted, &frames).expect("valid");
        assert_eq!(accumulator.normals(&[DVec3::X; 2]), Ok(vec![DVec3::X; 2]));
        assert_eq!(accumulator.weights(), [2.0, 0.0]);
    }

    #[test]
    fn guards_name_the_array() {
        let mut accumulator = NormalAccumulator::new(2);
        let error = |what, expected, got| Err(GeomError::LengthMismatch { what, expected, got });
        let f = IDENTITY;
        assert_eq!(
            accumulator.add(&[0], &[1], &[0.; 3], &[0.; 3], 3, &f[..8]),
            error("world_from_patch", 0, 8)
        );
        let two = [f, f].concat();
        assert_eq!(accumulator.add(&[0; 3], &[1; 3], &[0.; 9], &[0.; 9], 3, &two), error("face_ids", 2, 3));
        assert_eq!(accumulator.add(&[0], &[1; 2], &[0.; 3], &[0.; 3], 3, &f), error("mask", 1, 2));
        assert_eq!(accumulator.add(&[0], &[1], &[0.; 2], &[0.; 3], 3, &f), error("predicted", 3, 2));
        assert_eq!(accumulator.add(&[0], &[1], &[0.; 3], &[0.; 2], 3, &f), error("features", 3, 2));
        assert_eq!(accumulator.add_centers(&[0], &[0.; 2], &f), error("predicted", 3, 2));
        assert_eq!(accumulator.add_centers(&[0], &[0.; 3], &f[..8]), error("world_from_patch", 9, 8));
        assert_eq!(
            accumulator.normals(&[DVec3::X]),
            Err(GeomError::LengthMismatch { what: "fallback", expected: 2, got: 1 })
        );
        let parameter = |result: Result<()>| match result {
            Err(GeomError::InvalidParameter { name, value, .. }) => (name, value),
            other => panic!("{other:?}"),
        };
        let refused = parameter(accumulator.add(&[2], &[1], &[0.; 3], &[0.; 3], 3, &f));
        assert_eq!(refused, ("face_ids", "2".to_string()));
        let refused = parameter(accumulator.add_centers(&[5], &[0.; 3], &f));
        assert_eq!(refused, ("face_ids", "5".to_string()));
        let refused = parameter(accumulator.add(&[0], &[1], &[0.; 3], &[0.; 2], 2, &f));
        assert_eq!(refused, ("n_channels", "2".to_string()));
        assert_eq!(accumulator, NormalAccumulator::new(2), "nothing was added");
        assert_eq!(accumulator.add(&[], &[], &[], &[], 17, &[]), Ok(()));
    }
}
