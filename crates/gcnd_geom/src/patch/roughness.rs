//! How rough a whole mesh is: what tells noise from detail, which a patch alone cannot.

use super::scale_space::{average, place_centroids};
use crate::error::{GeomError, Result, check_len};
use crate::face_geometry::FaceGeometry;
use crate::mesh::check_vertices;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Shares of the vertices that are smoother than what the channels say.
pub const ROUGHNESS_QUANTILES: [f64; 4] = [0.1, 0.25, 0.5, 0.9];

/// Smallest and largest roughness that is told apart, in √ā.
const RANGE: (f64, f64) = (1e-4, 10.0);

/// Sums and squares of coordinates within it stay in the range of numbers.
const COORDINATES: RangeInclusive<f64> = 1e-100..=1e100;

/// Quantiles of |n_i · (M − 1)² v_i| over the vertices in mesh units, for the shares in [`ROUGHNESS_QUANTILES`].
///
/// M is the mean over a vertex's faces of their centroids, n_i the mean normal of its faces weighted by area. (M − 1)²
/// takes away what is linear, and most of what is curved, and leaves noise: with Gaussian noise of a given size along
/// the normals the lower quantiles are nearly the same on any surface. A mesh that has no vertex with faces is as smooth
/// as can be.
///
/// # Errors
/// [`GeomError::EmptyMesh`], [`GeomError::LengthMismatch`] when `topology` counts other vertices,
/// [`GeomError::NonFiniteVertex`].
///
/// Choice: docs/choices.md#mesh-roughness.
///
/// ```
/// use gcnd_geom::{fixtures, patch::mesh_roughness, Topology};
/// let (vertices, faces) = fixtures::grid(8, 8);
/// let topology = Topology::new(faces, vertices.len())?;
/// assert_eq!(mesh_roughness(&topology, &vertices)?, [0.0; 4], "nothing is flatter than a plane");
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn mesh_roughness(topology: &Topology, vertices: &[DVec3]) -> Result<[f64; ROUGHNESS_QUANTILES.len()]> {
    check_len("vertices", topology.n_vertices(), vertices.len())?;
    if topology.n_faces() == 0 {
        return Err(GeomError::EmptyMesh);
    }
    check_vertices(vertices)?;
    let largest = vertices.iter().fold(0.0_f64, |most, v| most.max(v.abs().max_element()));
    if largest > 0.0 && !COORDINATES.contains(&largest) {
        let near: Vec<DVec3> = vertices.iter().map(|&v| v / largest).collect();
        return Ok(mesh_roughness(topology, &near)?.map(|roughness| roughness * largest));
    }
    let mut sizes = deviations(topology, vertices);
    Ok(ROUGHNESS_QUANTILES.map(|share| if sizes.is_empty() { 0.0 } else { quantile(&mut sizes, share) }))
}

/// What the nodes of a patch carry: log₁₀ of a roughness in units of √ā, ā the mean area of the patch's middle; −4 to 1.
pub(crate) fn roughness_channel(roughness: f64, mean_area: f64) -> f32 {
    let size = mean_area.sqrt();
    let relative = if size > 0.0 { roughness / size } else { 0.0 };
    relative.clamp(RANGE.0, RANGE.1).log10() as f32
}

/// |n_i · (M − 1)² v_i| of every vertex that has faces, in mesh units.
fn deviations(topology: &Topology, vertices: &[DVec3]) -> Vec<f64> {
    let mut centroids = vec![DVec3::ZERO; topology.n_faces()];
    let mut offset_from_mean = |values: &[DVec3]| -> Vec<DVec3> {
        let mut means = values.to_vec();
        place_centroids(topology, values, &mut centroids);
        average(topology, values, &centroids, &mut means);
        means.par_iter_mut().zip(values).for_each(|(mean, &value)| *mean -= value);
        means
    };
    let once = offset_from_mean(vertices);
    let twice = offset_from_mean(&once);
    let geometry = FaceGeometry::compute(vertices, topology.faces());
    let deviation = |vertex_id: usize| {
        let faces = topology.vertex_faces().row(vertex_id).iter().map(|&face_id| face_id as usize);
        let normal: DVec3 = faces.map(|f| geometry.normals[f] * geometry.areas[f]).sum();
        normal.normalize_or_zero().dot(twice[vertex_id]).abs()
    };
    let has_faces = |&vertex_id: &usize| !topology.vertex_faces().row(vertex_id).is_empty();
    (0..vertices.len()).into_par_iter().filter(has_faces).map(deviation).collect()
}

/// The value that a share of all values lie below; there is at least one.
pub(crate) fn quantile(values: &mut [f64], share: f64) -> f64 {
    let rank = ((values.len() - 1) as f64 * share) as usize;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face_geometry::mean_edge_length;
    use crate::fixtures;

    #[test]
    fn one_raised_vertex_by_hand() {
        // Corners of a square of two triangles each: M at the middle of a fan of n triangles is 1/3 of the middle and
        // 2/3 of the mean of the rim.
        let (mut vertices, faces) = fixtures::grid(20, 20);
        let middle = 21 * 10 + 10;
        vertices[middle].z = 1e-3;
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let sizes = deviations(&topology, &vertices);
        // (M − 1) z is −2/3 at the middle and 1/9 at each of its six neighbours, which share two of their six triangles
        // with it: 2 · 1/3 / 6. Then 1/3 · (−2/3) + 2/3 · 1/9 + 2/3 there.
        let expected = 1e-3 * (-2.0 / 9.0 + 2.0 / 27.0 + 2.0 / 3.0);
        assert!((sizes[middle] - expected).abs() < 1e-8, "{} {expected}", sizes[middle]);
        assert!(sizes[0] < 1e-12);
    }

    #[test]
    fn coordinates_near_the_ends_of_the_range_of_numbers() {
        let (mut vertices, faces) = fixtures::icosphere(3);
        fixtures::jitter(&mut vertices, 0.02, 5);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let expected = mesh_roughness(&topology, &vertices).expect("valid");
        for scale in [8e307, 1e-300] {
            let scaled: Vec<DVec3> = vertices.iter().map(|&v| v * scale).collect();
            let found = mesh_roughness(&topology, &scaled).expect("valid");
            for k in 0..4 {
                assert!((found[k] / scale / expected[k] - 1.0).abs() < 1e-9, "{found:?} {expected:?}");
            }
        }
    }

    #[test]
    fn it_tells_the_size_of_noise_whatever_the_surface() {
        // In mean edge lengths, with noise of such a length.
        let relative = |(mut vertices, faces): fixtures::MeshParts, level: f64| {
            let edge = mean_edge_length(&vertices, &faces);
            fixtures::jitter(&mut vertices, level * edge, 3);
            let topology = Topology::new(faces, vertices.len()).expect("valid");
            mesh_roughness(&topology, &vertices).expect("valid").map(|roughness| roughness / edge)
        };
        for level in [0.1, 0.2] {
            let on_sphere = relative(fixtures::icosphere(5), level);
            let [on_plane, doubled] = [level, 2.0 * level].map(|l| relative(fixtures::grid(60, 60), l));
            for k in 0..4 {
                assert!((on_sphere[k] / on_plane[k]).log10().abs() < 0.1, "{on_sphere:?} {on_plane:?}");
                assert!((doubled[k] / on_plane[k] - 2.0).abs() < 0.25, "{on_plane:?} {doubled:?}");
            }
        }
    }

    #[test]
    fn it_grows_with_the_mesh_and_does_not_depend_on_position_or_loose_vertices() {
        let (mut vertices, faces) = fixtures::icosphere(3);
        vertices.iter_mut().enumerate().for_each(|(i, v)| *v *= 1.0 + 0.01 * ((i * i) % 17) as f64);
        let of = |vertices: &[DVec3]| {
            mesh_roughness(&Topology::new(faces.clone(), vertices.len()).expect("valid"), vertices)
        };
        let base = of(&vertices).expect("valid");
        assert!(base[0] > 1e-4 && base[0] < base[1] && base[2] < base[3], "{base:?}");
        let mut moved: Vec<DVec3> =
            vertices.iter().map(|&v| 250.0 * DVec3::new(v.z, v.x, v.y) + DVec3::splat(30.0)).collect();
        moved.push(DVec3::splat(1e6));
        let moved = of(&moved).expect("valid");
        for (a, b) in base.iter().zip(&moved) {
            assert!((b / a / 250.0 - 1.0).abs() < 1e-9, "{base:?} {moved:?}");
        }
    }

    #[test]
    fn channels_are_logarithms_in_units_of_the_triangles() {
        assert_eq!(roughness_channel(0.3, 9.0), -1.0);
        assert_eq!([0.0, 1e-9, 1e9].map(|roughness| roughness_channel(roughness, 4.0)), [-4.0, -4.0, 1.0]);
        assert_eq!(roughness_channel(0.3, 0.0), -4.0, "a patch without area");
    }

    #[test]
    fn what_has_no_size_is_smooth_and_bad_input_is_named() {
        let point = vec![DVec3::ONE; 3];
        let topology = Topology::new(vec![[0, 1, 2]], 3).expect("valid");
        assert_eq!(mesh_roughness(&topology, &point).expect("valid"), [0.0; 4]);
        let broken = [DVec3::ONE, DVec3::NAN, DVec3::ZERO];
        assert_eq!(mesh_roughness(&topology, &broken), Err(GeomError::NonFiniteVertex { vertex_id: 1 }));
        let empty = Topology::new(vec![], 3).expect("valid");
        assert_eq!(mesh_roughness(&empty, &point), Err(GeomError::EmptyMesh));
    }
}
