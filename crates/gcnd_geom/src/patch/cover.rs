//! Covering a mesh with overlapping patches.
//!
//! Choice: docs/choices.md#cover.

use super::accumulator::NormalAccumulator;
use super::budget::SplitMix64;
use crate::error::{Result, check_len, check_positive};

/// Chooses patch centres where predictions are missing.
///
/// Faces come up once each, in an order that the seed shuffles; one that earlier patches have predicted with
/// `least_weight` in sum is passed over, every other becomes a centre, where a prediction weighs 1. Up to a
/// `least_weight` of 1 every face reaches it; above, a face that few patches reach may stay below.
///
/// ```
/// use gcnd_geom::patch::{Cover, NormalAccumulator};
/// let mut predictions = NormalAccumulator::new(100);
/// let mut cover = Cover::new(100, 1.0, 0)?;
/// let first = cover.next_centers(&predictions, 10)?;
/// assert_eq!(first.len(), 10);
/// // ... patches around them are predicted and added to `predictions` ...
/// # let frames = [1., 0., 0., 0., 1., 0., 0., 0., 1.].repeat(100);
/// # let all: Vec<u32> = (0..100).collect();
/// # predictions.add_centers(&all, &[0.0, 0.0, 1.0].repeat(100), &frames)?;
/// assert!(cover.next_centers(&predictions, 10)?.is_empty(), "every face has its weight");
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
///
/// Choice: docs/choices.md#cover.
#[derive(Debug, Clone, PartialEq)]
pub struct Cover {
    order: Vec<u32>,
    next: usize,
    least_weight: f64,
}

impl Cover {
    /// Shuffles the faces.
    ///
    /// # Errors
    /// [`GeomError::InvalidParameter`](crate::GeomError::InvalidParameter) unless `least_weight` is positive and finite.
    pub fn new(n_faces: usize, least_weight: f64, seed: u64) -> Result<Self> {
        check_positive("least_weight", least_weight)?;
        let mut order: Vec<u32> = (0..n_faces as u32).collect();
        order.sort_by_cached_key(|&face_id| SplitMix64::for_id(seed, face_id).next_u64());
        Ok(Self { order, next: 0, least_weight })
    }

    /// The next centres, at most `at_most` of them and ascending; empty when every face has come up.
    ///
    /// # Errors
    /// [`GeomError::LengthMismatch`](crate::GeomError::LengthMismatch) when `predictions` are of another number of faces.
    pub fn next_centers(&mut self, predictions: &NormalAccumulator, at_most: usize) -> Result<Vec<u32>> {
        let weights = predictions.weights();
        check_len("predictions", self.order.len(), weights.len())?;
        let mut centers = Vec::with_capacity(at_most.min(self.order.len()));
        while centers.len() < at_most && self.next < self.order.len() {
            let face_id = self.order[self.next];
            self.next += 1;
            if weights[face_id as usize] < self.least_weight {
                centers.push(face_id);
            }
        }
        centers.sort_unstable();
        Ok(centers)
    }

    /// The fraction of the faces that have come up, 1 for a mesh without faces.
    pub fn progress(&self) -> f64 {
        if self.order.is_empty() { 1.0 } else { self.next as f64 / self.order.len() as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::GeomError;

    /// Runs a cover where the patch around a face predicts it and the next four, all with weight 1.
    fn run(n_faces: u32, least_weight: f64, seed: u64) -> (Vec<u32>, NormalAccumulator) {
        let mut predictions = NormalAccumulator::new(n_faces as usize);
        let mut cover = Cover::new(n_faces as usize, least_weight, seed).expect("valid");
        let mut all = Vec::new();
        loop {
            let centers = cover.next_centers(&predictions, 7).expect("same mesh");
            if centers.is_empty() {
                break;
            }
            assert!(centers.len() <= 7 && centers.is_sorted());
            let reached: Vec<u32> = centers.iter().flat_map(|&c| (c..c + 5).map(|f| f % n_faces)).collect();
            let frames = [1., 0., 0., 0., 1., 0., 0., 0., 1.].repeat(reached.len());
            predictions
                .add_centers(&reached, &[0.0, 0.0, 1.0].repeat(reached.len()), &frames)
                .expect("valid");
            all.extend(centers);
        }
        assert_eq!(cover.progress(), 1.0);
        (all, predictions)
    }

    #[test]
    fn every_face_is_predicted_and_few_are_centers() {
        let (centers, predictions) = run(1000, 1.0, 3);
        assert!(predictions.weights().iter().all(|&weight| weight >= 1.0));
        assert!((200..400).contains(&centers.len()), "{}", centers.len());
        // Twice the weight takes about twice the patches, and a face is a centre at most once.
        let (mut twice, predictions) = run(1000, 2.0, 3);
        let short = predictions.weights().iter().filter(|&&weight| weight < 2.0).count();
        assert!(short < 20, "a centre that nothing else reaches: {short}");
        assert!((400..700).contains(&twice.len()), "{}", twice.len());
        twice.sort_unstable();
        twice.dedup();
        assert_eq!(twice.len(), run(1000, 2.0, 3).0.len());
    }

    #[test]
    fn the_seed_decides() {
        assert_eq!(run(300, 1.0, 5).0, run(300, 1.0, 5).0);
        assert_ne!(run(300, 1.0, 5).0, run(300, 1.0, 6).0);
    }

    #[test]
    fn what_is_never_predicted_comes_up_once() {
        let nothing = NormalAccumulator::new(5);
        let mut cover = Cover::new(5, 1.0, 0).expect("valid");
        assert_eq!(cover.progress(), 0.0);
        assert_eq!(cover.next_centers(&nothing, 9), Ok(vec![0, 1, 2, 3, 4]));
        assert_eq!(cover.next_centers(&nothing, 9), Ok(vec![]));
        assert_eq!(Cover::new(0, 1.0, 0).expect("valid").progress(), 1.0);
    }

    #[test]
    fn guards() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(
                Cover::new(3, bad, 0),
                Err(GeomError::InvalidParameter { name: "least_weight", .. })
            ));
        }
        let mut cover = Cover::new(3, 1.0, 0).expect("valid");
        let error = GeomError::LengthMismatch { what: "predictions", expected: 3, got: 2 };
        assert_eq!(cover.next_centers(&NormalAccumulator::new(2), 1), Err(error));
    }
}
