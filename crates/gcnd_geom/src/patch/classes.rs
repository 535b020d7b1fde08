//! Four classes of faces by the shape around them, for balanced training (paper Sec. 5.2).

use super::{PatchExtractor, PatchParams, PatchScratch, voting};
use crate::error::Result;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;

/// What the surface around a face looks like.
///
/// Edge and corner faces are the feature group of balanced training, the other two the non-feature group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum FaceClass {
    /// λ2 < 0.01 and λ3 < 0.001.
    Flat = 0,
    /// λ2 > 0.01 and λ3 < 0.1.
    Edge = 1,
    /// λ3 > 0.1.
    Corner = 2,
    /// Everything else.
    Transitional = 3,
}

impl FaceClass {
    /// The class by the paper's thresholds on λ1 ≥ λ2 ≥ λ3, normalised to sum 1.
    ///
    /// ```
    /// use gcnd_geom::patch::FaceClass;
    /// assert_eq!(FaceClass::from_eigenvalues([1.0, 0.0, 0.0]), FaceClass::Flat);
    /// assert_eq!(FaceClass::from_eigenvalues([0.7, 0.3, 0.0]), FaceClass::Edge);
    /// ```
    ///
    /// Paper: Sec. 5.2. Choice: docs/choices.md#face-classes.
    pub fn from_eigenvalues([_, lambda2, lambda3]: [f64; 3]) -> Self {
        if lambda2 < 0.01 && lambda3 < 0.001 {
            Self::Flat
        } else if lambda2 > 0.01 && lambda3 < 0.1 {
            Self::Edge
        } else if lambda3 > 0.1 {
            Self::Corner
        } else {
            Self::Transitional
        }
    }

    /// Whether balanced training counts the face as a feature.
    pub fn is_feature(self) -> bool {
        matches!(self, Self::Edge | Self::Corner)
    }
}

/// Classifies every face by the eigenvalues of its voting tensor, T / Σ μ.
///
/// `vertices` (V) in mesh units, meant to be free of noise; of `params` the patch scale, voting region and σ
/// count. Returns one class per face (F).
///
/// # Errors
/// As [`PatchExtractor::new`].
///
/// ```
/// use gcnd_geom::{fixtures, patch::{classify_faces, FaceClass, PatchParams}, Topology};
/// let (vertices, faces) = fixtures::grid(9, 9);
/// let topology = Topology::new(faces, vertices.len())?;
/// let classes = classify_faces(&topology, &vertices, PatchParams::default())?;
/// assert!(classes.iter().all(|&class| class == FaceClass::Flat));
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
///
/// Paper: Sec. 5.2. Choice: docs/choices.md#face-classes.
pub fn classify_faces(
    topology: &Topology,
    vertices: &[DVec3],
    params: PatchParams,
) -> Result<Vec<FaceClass>> {
    let extractor = PatchExtractor::new(topology, vertices, params)?;
    let classes = (0..topology.n_faces() as u32).into_par_iter().with_min_len(16);
    let classify = |scratch: &mut PatchScratch, face_id: u32| {
        let scale = extractor.select_into(face_id, scratch);
        let (tensor, weight_sum) = extractor.voting_tensor(&scale, scratch);
        FaceClass::from_eigenvalues(voting::normalized_eigenvalues(&tensor, weight_sum))
    };
    Ok(classes.map_init(PatchScratch::new, classify).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_are_the_papers() {
        for (lambda2, lambda3, expected) in [
            (0.0, 0.0, FaceClass::Flat),
            (0.0099, 0.00099, FaceClass::Flat),
            (0.0099, 0.0011, FaceClass::Transitional),
            (0.01, 0.0, FaceClass::Transitional),
            (0.011, 0.0, FaceClass::Edge),
            (0.3, 0.099, FaceClass::Edge),
            (0.3, 0.1, FaceClass::Transitional),
            (0.3, 0.11, FaceClass::Corner),
        ] {
            let class = FaceClass::from_eigenvalues([1.0 - lambda2 - lambda3, lambda2, lambda3]);
            assert_eq!(class, expected, "{lambda2} {lambda3}");
            assert_eq!(class.is_feature(), matches!(expected, FaceClass::Edge | FaceClass::Corner));
        }
    }
}
