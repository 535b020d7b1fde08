//! Alignment by normal tensor voting (paper Sec. 4.2, Eqs. 2–3).

use super::symmetric_eigen::{Eigen3, Symmetric3, symmetric_eigen};
use glam::{DMat3, DVec3};

/// A face as its patch sees it, free of units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalFace {
    /// (c_j − c_i) / r, in the axes of the mesh.
    pub(crate) offset: DVec3,
    /// Unit normal, zero for a face without area.
    pub(crate) normal: DVec3,
    /// a_j over the mean area of the 2-ring.
    pub(crate) area: f64,
}

/// The voted normal n' = 2 (n·w) w − n with w = normalize([(c_j − c_i) × n] × (c_j − c_i)).
///
/// It is n after half a turn about w. With d = c_j − c_i, and w in the plane of d and n and perpendicular to d,
/// this is n mirrored at the plane perpendicular to d: n' = n − 2 (d·n)/(d·d) d. That form needs no square root
/// and stays defined where the cross product vanishes (d parallel to n: n' = −n, which casts the same vote).
#[inline]
fn voted_normal(offset: DVec3, normal: DVec3) -> DVec3 {
    let squared = offset.length_squared();
    if squared == 0.0 { normal } else { normal - (2.0 * offset.dot(normal) / squared) * offset }
}

/// Eq. 2: T = Σ_j μ_j n'_j n'_jᵀ with μ_j = (a_j/a_m) exp(−‖c_j − c_i‖/σ), and Σ_j μ_j.
pub(crate) fn voting_tensor(
    faces: impl Iterator<Item = LocalFace> + Clone,
    sigma_vote: f64,
) -> (Symmetric3, f64) {
    let max_area = faces.clone().fold(0.0, |max: f64, face| max.max(face.area));
    let (mut tensor, mut weight_sum) = (Symmetric3::default(), 0.0);
    if max_area > 0.0 {
        for face in faces {
            let weight = (face.area / max_area) * (-face.offset.length() / sigma_vote).exp();
            weight_sum += weight;
            tensor.add_outer(weight, voted_normal(face.offset, face.normal));
        }
    }
    (tensor, weight_sum)
}

/// Eq. 3: the eigenvalues of T / Σ μ in descending order, which then add up to 1 (to 0 without votes).
pub(crate) fn normalized_eigenvalues(tensor: &Symmetric3, weight_sum: f64) -> [f64; 3] {
    let scale = if weight_sum > 0.0 { weight_sum.recip() } else { 0.0 };
    symmetric_eigen(tensor).values.map(|value| value * scale)
}

/// Eq. 3: the patch frame, a rotation whose columns e1, e2, e3 are T's eigenvectors by descending eigenvalue.
///
/// Signs: e1 towards `area_normal`; e2 so that Σ_j a_j ((c_j − c_i)·e2)³ ≥ 0 over the patch; e3 = e1 × e2.
pub(crate) fn patch_frame(tensor: &Symmetric3, area_normal: DVec3, patch: &[LocalFace]) -> DMat3 {
    let Eigen3 { vectors: [mut e1, mut e2, _], .. } = symmetric_eigen(tensor);
    if e1.dot(area_normal) < 0.0 {
        e1 = -e1;
    }
    let third_moment: f64 = patch
        .iter()
        .map(|face| {
            let along = face.offset.dot(e2);
            face.area * along * along * along
        })
        .sum();
    if third_moment < 0.0 {
        e2 = -e2;
    }
    DMat3::from_cols(e1, e2, e1.cross(e2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn face(offset: [f64; 3], normal: [f64; 3], area: f64) -> LocalFace {
        LocalFace { offset: offset.into(), normal: normal.into(), area }
    }

    /// The vote as the paper writes it.
    fn voted_by_the_text(d: DVec3, n: DVec3) -> DVec3 {
        let w = d.cross(n).cross(d).normalize();
        2.0 * n.dot(w) * w - n
    }

    #[test]
    fn vote_equals_the_text() {
        for (d, n) in [
            (DVec3::new(0.3, 0.1, -0.2), DVec3::new(0.0, 0.6, 0.8)),
            (DVec3::new(-1e-9, 2e-9, 5e-10), DVec3::new(0.6, 0.0, -0.8)),
            (DVec3::X, DVec3::new(0.6, 0.8, 0.0)),
        ] {
            assert!((voted_normal(d, n) - voted_by_the_text(d, n)).length() < 1e-14);
        }
        assert_eq!(voted_normal(DVec3::ZERO, DVec3::Z), DVec3::Z);
        assert_eq!(voted_normal(2.0 * DVec3::Z, DVec3::Z), -DVec3::Z);
    }

    #[test]
    fn an_arc_votes_for_its_middle() {
        // On a circle the chord's mirror maps the normal at one end to the normal at the other.
        let (sine, cosine) = 0.4f64.sin_cos();
        let d = DVec3::new(sine, 0.0, cosine - 1.0);
        let vote = voted_normal(d, DVec3::new(sine, 0.0, cosine));
        assert!((vote - DVec3::Z).length() < 1e-15, "{vote}");
    }

    #[test]
    fn tensor_of_two_faces_by_hand() {
        // Centre: n = z, a = 1, d = 0, so μ = 1/2 and n' = z.
        // Other: n = (0, 0.6, 0.8), a = 2, d = (0, 0.5, 0): μ = exp(−0.5/0.25) = e⁻², w = z,
        // n' = 2·0.8·z − n = (0, −0.6, 0.8).
        let faces = [face([0.; 3], [0., 0., 1.], 1.0), face([0., 0.5, 0.], [0., 0.6, 0.8], 2.0)];
        let (tensor, weight_sum) = voting_tensor(faces.into_iter(), 0.25);
        let mu = (-2.0f64).exp();
        let expected = Symmetric3 {
            diagonal: DVec3::new(0.0, 0.36 * mu, 0.5 + 0.64 * mu),
            off_diagonal: DVec3::new(-0.48 * mu, 0.0, 0.0),
        };
        assert!((weight_sum - (0.5 + mu)).abs() < 1e-15);
        assert!((tensor.diagonal - expected.diagonal).length() < 1e-15);
        assert!((tensor.off_diagonal - expected.off_diagonal).length() < 1e-15);
        let values = normalized_eigenvalues(&tensor, weight_sum);
        // Trace and determinant of the 2×2 block, by hand.
        assert!((values.iter().sum::<f64>() - 1.0).abs() < 1e-15);
        assert!((values[0] * values[1] * weight_sum * weight_sum - 0.5 * 0.36 * mu).abs() < 1e-15);
        assert!(values[2].abs() < 1e-15);
    }

    #[test]
    fn frame_signs_follow_the_mean_normal_and_the_third_moment() {
        let faces = [
            face([0.; 3], [0., 0., -1.], 1.0),
            face([0., -0.8, 0.], [0., 0.6, -0.8], 1.0),
            face([0., 0.1, 0.], [0., -0.6, -0.8], 1.0),
        ];
        let (tensor, _) = voting_tensor(faces.into_iter(), 1.0 / 3.0);
        let frame = patch_frame(&tensor, -DVec3::Z, &faces);
        assert!((frame.determinant() - 1.0).abs() < 1e-15);
        assert!(frame.x_axis.z < -0.9, "e1 points along the mean normal");
        assert!(frame.y_axis.y < -0.9, "e2 points to the farther face");
    }

    #[test]
    fn no_votes_give_a_frame_all_the_same() {
        let faces = [face([0.; 3], [0.; 3], 0.0)];
        let (tensor, weight_sum) = voting_tensor(faces.into_iter(), 1.0 / 3.0);
        assert_eq!(normalized_eigenvalues(&tensor, weight_sum), [0.0; 3]);
        assert_eq!(patch_frame(&tensor, DVec3::ZERO, &faces), DMat3::IDENTITY);
    }
}
