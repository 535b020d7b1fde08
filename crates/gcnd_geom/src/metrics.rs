//! Error metrics of a result against the truth: E_a over normals, E_v over positions (paper Sec. 7.2).

use crate::error::{GeomError, Result, check_len};
use crate::face_geometry::FaceGeometry;
use crate::mesh::{Face, validate};
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// Samples on each surface that [`vertex_error`] is published with.
pub const DEFAULT_SAMPLES: usize = 200_000;

/// Computes the angle between each result normal and its truth, in degrees (0 to 180):
/// acos(n_i · ñ_i), evaluated as atan2(|n_i × ñ_i|, n_i · ñ_i), which keeps small angles exact.
///
/// - `result_normals`, `truth_normals` (F), face by face, in one frame; their lengths do not matter.
///
/// Returns (F) degrees: 90 where the result normal is zero, NaN where the truth normal is, since no angle
/// exists there.
///
/// # Errors
/// [`GeomError::LengthMismatch`].
///
/// Paper: Sec. 7.2, Eq. 7. Choice: docs/choices.md#faces-without-normal.
///
/// ```
/// use gcnd_geom::{metrics::angles, DVec3};
/// let degrees = angles(&[DVec3::X, DVec3::ZERO], &[DVec3::Y, DVec3::Y])?;
/// assert_eq!(degrees, [90.0, 90.0]);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn angles(result_normals: &[DVec3], truth_normals: &[DVec3]) -> Result<Vec<f64>> {
    check_len("result normals", truth_normals.len(), result_normals.len())?;
    let angle = |(result, truth): (&DVec3, &DVec3)| {
        if *truth == DVec3::ZERO {
            f64::NAN
        } else if *result == DVec3::ZERO {
            90.0
        } else {
            result.cross(*truth).length().atan2(result.dot(*truth)).to_degrees()
        }
    };
    Ok(result_normals.par_iter().zip(truth_normals).with_min_len(4096).map(angle).collect())
}

/// Computes E_a, the mean angle between result and truth normals, in degrees:
/// E_a = 1/N_f · Σ_i acos(n_i · ñ_i).
///
/// Faces without a truth normal are left out of the mean; a face without a result normal counts 90 degrees.
/// Arguments as for [`angles`].
///
/// # Errors
/// [`GeomError::LengthMismatch`], or [`GeomError::InvalidParameter`] when no face has a truth normal.
///
/// Paper: Sec. 7.2, Eq. 7. Choice: docs/choices.md#faces-without-normal.
///
/// ```
/// use gcnd_geom::{metrics::normal_error, DVec3};
/// let error = normal_error(&[DVec3::X, DVec3::X], &[DVec3::X, DVec3::Y])?;
/// assert_eq!(error, 45.0);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn normal_error(result_normals: &[DVec3], truth_normals: &[DVec3]) -> Result<f64> {
    let degrees = angles(result_normals, truth_normals)?;
    let (sum, count) =
        degrees.iter().filter(|d| !d.is_nan()).fold((0.0, 0usize), |(sum, count), d| (sum + d, count + 1));
    if count == 0 {
        return Err(GeomError::InvalidParameter {
            name: "truth_normals",
            value: "zero at every face".into(),
            allowed: "at least one non-zero normal",
        });
    }
    Ok(sum / count as f64)
}

/// Estimates E_v, the mean distance from the result's surface to the truth's over the diagonal of the truth's
/// bounding box: E_v = 1 / (N · d) · Σ_i min_j |p_i − q_j|, with p on the result and q on the truth.
///
/// - `result_vertices` (V), `result_faces` (F), `truth_vertices` (V'), `truth_faces` (F'): two meshes in one
///   frame and unit; they need not correspond.
/// - `samples`: points N on each surface, spread evenly over its area; [`DEFAULT_SAMPLES`] in published figures.
/// - `seed`: of the samples; the same seed gives the same error to the bit.
///
/// Returns E_v, without a unit; papers print it times 1000. Since points are compared with points, two
/// equal surfaces do not give zero but about half the spacing of the samples, 0.5 · sqrt(area / N) / d.
/// Compare only errors taken with the same `samples`.
///
/// # Errors
/// Those of [`validate`] for either mesh, and [`GeomError::InvalidParameter`] when `samples` is 0 or the truth
/// has no extent.
///
/// Paper: Sec. 7.2, Eq. 8. Choice: docs/choices.md#vertex-error.
///
/// ```
/// use gcnd_geom::{fixtures, metrics::vertex_error};
/// let (truth, faces) = fixtures::grid(4, 4);
/// let lifted: Vec<_> = truth.iter().map(|v| *v + 0.5 * gcnd_geom::DVec3::Z).collect();
/// let error = vertex_error(&lifted, &faces, &truth, &faces, 10_000, 0)?;
/// assert!((error * 32f64.sqrt() - 0.5).abs() < 0.01);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn vertex_error(
    result_vertices: &[DVec3],
    result_faces: &[Face],
    truth_vertices: &[DVec3],
    truth_faces: &[Face],
    samples: usize,
    seed: u64,
) -> Result<f64> {
    validate(result_vertices, result_faces)?;
    validate(truth_vertices, truth_faces)?;
    check_samples(samples)?;
    let bbox_diagonal = bbox_diagonal(truth_vertices, truth_faces);
    if bbox_diagonal <= 0.0 {
        return Err(GeomError::InvalidParameter {
            name: "truth_vertices",
            value: "all in one point".into(),
            allowed: "a mesh with an extent",
        });
    }
    let points = surface_samples(result_vertices, result_faces, samples, hash64(seed, 0));
    let targets = surface_samples(truth_vertices, truth_faces, samples, hash64(seed, 1));
    let targets: Vec<[f64; 3]> = targets.into_iter().map(DVec3::into).collect();
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(&targets).map_err(|_| too_many_samples(samples))?;
    let distances: Vec<f64> = points
        .par_iter()
        .with_min_len(1024)
        .map(|p| tree.query(&p.to_array()).nearest_one::<SquaredEuclidean<f64>>().execute().distance.sqrt())
        .collect();
    Ok(distances.iter().sum::<f64>() / samples as f64 / bbox_diagonal)
}

fn check_samples(samples: usize) -> Result<()> {
    if samples == 0 {
        let (name, value, allowed) = ("samples", "0".into(), "1 or more");
        return Err(GeomError::InvalidParameter { name, value, allowed });
    }
    if samples > u32::MAX as usize { Err(too_many_samples(samples)) } else { Ok(()) }
}

fn too_many_samples(count: usize) -> GeomError {
    GeomError::TooLarge { what: "samples", count, limit: u32::MAX as usize }
}

/// Diagonal of the bounding box of the vertices that faces use, in mesh units.
fn bbox_diagonal(vertices: &[DVec3], faces: &[Face]) -> f64 {
    let used = || faces.iter().flatten().map(|&v| vertices[v as usize]);
    let low = used().fold(DVec3::INFINITY, DVec3::min);
    let high = used().fold(DVec3::NEG_INFINITY, DVec3::max);
    low.distance(high)
}

/// `count` points spread over the faces in proportion to their areas (over all faces alike if none has any).
fn surface_samples(vertices: &[DVec3], faces: &[Face], count: usize, seed: u64) -> Vec<DVec3> {
    let areas = FaceGeometry::compute(vertices, faces).areas;
    let mut total = 0.0;
    let mut cumulative: Vec<f64> = areas
        .iter()
        .map(|area| {
            total += area;
            total
        })
        .collect();
    if total <= 0.0 {
        total = faces.len() as f64;
        cumulative = (1..=faces.len()).map(|n| n as f64).collect();
    }
    let uniform = |sample: usize, axis: u64| unit_interval(hash64(seed, 3 * sample as u64 + axis));
    let mut places: Vec<f64> = (0..count).map(|sample| uniform(sample, 0) * total).collect();
    // Neighbours in this order lie close together, which makes looking them up in a tree several times faster.
    places.par_sort_unstable_by(f64::total_cmp);
    places
        .into_par_iter()
        .enumerate()
        .with_min_len(4096)
        .map(|(sample, at)| {
            let face_id = cumulative.partition_point(|&c| c <= at).min(faces.len() - 1);
            let [a, b, c] = faces[face_id].map(|v| vertices[v as usize]);
            let (s, t) = (uniform(sample, 1).sqrt(), uniform(sample, 2));
            a + s * ((b - a) + t * (c - b))
        })
        .collect()
}

/// 53 bits of a hash as a number in [0, 1).
fn unit_interval(hash: u64) -> f64 {
    (hash >> 11) as f64 / (1u64 << 53) as f64
}

/// The `index`-th output of splitmix64 started at `seed`.
fn hash64(seed: u64, index: u64) -> u64 {
    let mut z = seed.wrapping_add((index.wrapping_add(1)).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn angles_by_hand() {
        let truth = [DVec3::X; 5];
        let result = [DVec3::X, DVec3::Y, -DVec3::X, DVec3::new(3.0, 3.0, 0.0), DVec3::ZERO];
        let expected = [0.0, 90.0, 180.0, 45.0, 90.0];
        for (angle, expected) in angles(&result, &truth).expect("same length").iter().zip(expected) {
            assert!((angle - expected).abs() < 1e-13, "{angle} {expected}");
        }
    }

    #[test]
    fn small_angles_keep_their_digits() {
        let tilted = DVec3::new(1.0, 1e-10, 0.0);
        let angle = angles(&[tilted], &[DVec3::X]).expect("same length")[0];
        assert!((angle.to_radians() / 1e-10 - 1.0).abs() < 1e-12, "acos of a rounded dot would be 0");
    }

    #[test]
    fn faces_without_truth_are_left_out() {
        let truth = [DVec3::X, DVec3::ZERO, DVec3::X];
        let result = [DVec3::Y, DVec3::Y, DVec3::X];
        assert!(angles(&result, &truth).expect("same length")[1].is_nan());
        assert_eq!(normal_error(&result, &truth), Ok(45.0));
    }

    #[test]
    fn normal_error_guards() {
        let mismatch = GeomError::LengthMismatch { what: "result normals", expected: 1, got: 2 };
        assert_eq!(normal_error(&[DVec3::X; 2], &[DVec3::X]), Err(mismatch));
        assert!(matches!(
            normal_error(&[DVec3::X], &[DVec3::ZERO]),
            Err(GeomError::InvalidParameter { name: "truth_normals", .. })
        ));
        assert!(normal_error(&[], &[]).is_err());
    }

    #[test]
    fn samples_follow_area_and_lie_on_their_faces() {
        // Two triangles of area 0.5 and 1.5, in z = 0 and z = 1.
        let v = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        let vertices =
            [v(0., 0., 0.), v(1., 0., 0.), v(0., 1., 0.), v(0., 0., 1.), v(3., 0., 1.), v(0., 1., 1.)];
        let points = surface_samples(&vertices, &[[0, 1, 2], [3, 4, 5]], 40_000, 7);
        let (low, high): (Vec<DVec3>, Vec<DVec3>) = points.iter().partition(|p| p.z == 0.0);
        assert_eq!(low.len() + high.len(), 40_000);
        assert!(low.len().abs_diff(10_000) < 400, "over four standard deviations off: {}", low.len());
        assert!(low.iter().all(|p| p.x >= 0.0 && p.y >= 0.0 && p.x + p.y <= 1.0));
        let mean = low.iter().sum::<DVec3>() / low.len() as f64;
        assert!(mean.distance(v(1., 1., 0.) / 3.0) < 0.01, "uniform over the face: {mean}");
        // A quarter of the triangle lies in x + y < 1/2.
        let quarter = low.iter().filter(|p| p.x + p.y < 0.5).count() as f64 / low.len() as f64;
        assert!((quarter - 0.25).abs() < 0.02, "{quarter}");
    }

    #[test]
    fn equal_surfaces_give_half_the_sample_spacing() {
        let (vertices, faces) = fixtures::grid(10, 10);
        let error = vertex_error(&vertices, &faces, &vertices, &faces, 20_000, 1).expect("valid");
        let expected = 0.5 * (100.0f64 / 20_000.0).sqrt() / 200f64.sqrt();
        assert!((error / expected - 1.0).abs() < 0.05, "{error} {expected}");
    }

    #[test]
    fn vertex_error_is_the_same_each_time_and_at_each_scale() {
        let (truth, faces) = fixtures::icosphere(3);
        let mut noisy = truth.clone();
        fixtures::jitter(&mut noisy, 0.05, 2);
        let error = |scale: f64, seed| {
            let scaled = |v: &[DVec3]| v.iter().map(|v| *v * scale).collect::<Vec<_>>();
            vertex_error(&scaled(&noisy), &faces, &scaled(&truth), &faces, 5000, seed).expect("valid")
        };
        assert_eq!(error(1.0, 3), error(1.0, 3));
        assert_ne!(error(1.0, 3), error(1.0, 4));
        assert!((error(1.0, 3) / error(1024.0, 3) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_collapsed_result_is_measured() {
        let (truth, faces) = fixtures::grid(4, 4);
        let corner = vec![DVec3::ZERO; truth.len()];
        let error = vertex_error(&corner, &faces, &truth, &faces, 5000, 0).expect("valid");
        assert!(error < 0.02, "every sample lies on the truth's corner: {error}");
        let error = vertex_error(&truth, &faces, &truth, &[[0, 1, 1]], 5000, 0).expect("valid");
        assert!(error.is_finite());
    }

    #[test]
    fn vertex_error_guards() {
        let (v, f) = fixtures::tetrahedron();
        let call = |v1: &[DVec3], f1: &[Face], v2: &[DVec3], n| vertex_error(v1, f1, v2, &f, n, 0);
        assert!(matches!(call(&v, &f, &v, 0), Err(GeomError::InvalidParameter { name: "samples", .. })));
        assert_eq!(call(&v, &[], &v, 9), Err(GeomError::EmptyMesh));
        assert!(matches!(call(&v[..3], &f, &v, 9), Err(GeomError::IndexOutOfRange { .. })));
        let point = [DVec3::ONE; 4];
        let name = "truth_vertices";
        assert!(
            matches!(call(&v, &f, &point, 9), Err(GeomError::InvalidParameter { name: n, .. }) if n == name)
        );
        assert!(matches!(call(&v, &f, &v, 1 << 33), Err(GeomError::TooLarge { what: "samples", .. })));
    }
}
