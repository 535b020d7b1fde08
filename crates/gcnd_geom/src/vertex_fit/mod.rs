//! After vertex updating: positions between what the normals ask for and where the input was, whatever shape the
//! triangles have.

use crate::error::{GeomError, Result, check_len};
use crate::face_geometry::mean_edge_length;
use crate::mesh::check_vertices;
use crate::normals::refine::unit_normals;
use crate::rim::Boundary;
use crate::topology::Topology;
use crate::watch::{Ticks, Watch};
use glam::DVec3;
use rayon::prelude::*;

mod energy;
use energy::{CHUNK, Energy};

/// Steps of the solver; each costs about as much as an iteration of Eq. 6.
pub const ITERATIONS: usize = 30;

/// λ₁ that serves noise of each vertex's own.
pub const PULL: f64 = 0.0026;

/// Moves vertices to where the sum of two squares is least: of the angles between faces and given normals, and of the
/// ways from the vertices' first positions.
///
/// E(v) = Σ_f Σ_{edges ij of f} ½ cot α_ij (n_f · (v_i − v_j))² + Σ_i (λ_i (m_i · (v_i − r_i))² + μ |(v_i − r_i)_t|²)
///
/// The first sum is Eq. 6's, Σ (n_f · (v_i − v_j))², with the weight of an edge that makes it independent of the
/// triangle's shape: for one face it is A_f sin² of its angle to n_f, where Eq. 6 lets the longest edges of a sliver
/// decide. α_ij is the corner opposite ij. The second sum holds low waves, which noise of each vertex's own hardly has
/// and normals hardly tell: r are the positions before denoising, m_i the mean of the normals around i, weighted by
/// area, and t is what is across m_i. With d_i = m_i · (r_i − v_i) at the start, σ = 1.4826 median |d_i| and ē the mean
/// edge length, λ_i = λ / (1 + (d_i / 3σ)²), λ = λ₁ ē / max(σ, 0.02 ē), μ = 0.13.
///
/// - `topology`, `vertices` (V), in mesh units: the result of [`crate::vertex_update::update_vertices`].
/// - `normals` (F): as given to it; a face whose normal is zero asks for nothing.
/// - `first` (V): r, in mesh units.
/// - `pull`: λ₁, such as [`PULL`]; 0 and more.
/// - `boundary`: as for Eq. 6, with the rim of `vertices`.
/// - `watch`: hears of each of [`ITERATIONS`] steps of conjugate gradients, from `vertices` on, preconditioned by the
///   3 × 3 blocks of the diagonal.
///
/// Returns (V) positions, in mesh units. Vertices without faces stay.
///
/// # Errors
/// [`crate::GeomError::LengthMismatch`], [`crate::GeomError::NonFiniteVertex`],
/// [`crate::GeomError::InvalidParameter`] for a normal that is NaN or infinite or a pull out of range, or
/// [`crate::GeomError::Cancelled`].
///
/// Paper: Sec. 6.2, Eq. 6; cotangent weights: `pinkall1993`.
/// Choice: docs/choices.md#vertex-fit.
///
/// ```
/// use gcnd_geom::vertex_fit::{PULL, fit_vertices};
/// use gcnd_geom::vertex_update::{Boundary, update_vertices};
/// use gcnd_geom::{DVec3, Topology, Watch, fixtures};
/// let (flat, faces) = fixtures::grid(6, 6);
/// let mut noisy = flat.clone();
/// fixtures::jitter(&mut noisy, 0.2, 1);
/// let normals = vec![DVec3::Z; faces.len()];
/// let topology = Topology::new(faces, flat.len())?;
/// let watch = &mut Watch::silent();
/// let updated = update_vertices(&topology, &noisy, &normals, 15, Boundary::Free, watch)?;
/// let fitted = fit_vertices(&topology, &updated, &normals, &noisy, PULL, Boundary::Free, watch)?;
/// let middle = fitted.iter().map(|v| v.z).sum::<f64>() / fitted.len() as f64;
/// assert!(fitted.iter().all(|v| (v.z - middle).abs() < 0.02), "flat, as the normals are");
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn fit_vertices(
    topology: &Topology,
    vertices: &[DVec3],
    normals: &[DVec3],
    first: &[DVec3],
    pull: f64,
    boundary: Boundary,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    if !(pull.is_finite() && pull >= 0.0) {
        return Err(GeomError::InvalidParameter {
            name: "pull",
            value: pull.to_string(),
            allowed: "a finite number, 0 or more",
        });
    }
    for (name, positions) in [("vertices", vertices), ("first", first)] {
        check_len(name, topology.n_vertices(), positions.len())?;
        check_vertices(positions)?;
    }
    let normals = unit_normals(normals, topology.n_faces())?;
    let edge = mean_edge_length(vertices, topology.faces());
    let mut ticks = Ticks::new(ITERATIONS, watch);
    if !edge.is_normal() {
        return Ok(vertices.to_vec());
    }
    let energy = Energy::new(topology, vertices, normals, first, edge, pull, boundary);
    let ways = energy.minimize(|| ticks.tick())?;
    let moved = |(&v, way): (&DVec3, DVec3)| Some(v + way * edge).filter(|v| v.is_finite()).unwrap_or(v);
    Ok(vertices.par_iter().zip(ways).with_min_len(CHUNK).map(moved).collect())
}

#[cfg(test)]
mod tests {
    use super::energy::half_cotangents;
    use super::*;
    use crate::face_geometry::FaceGeometry;
    use crate::fixtures;

    fn fitted(
        (vertices, faces): &fixtures::MeshParts,
        normals: &[DVec3],
        first: &[DVec3],
        boundary: Boundary,
    ) -> Result<Vec<DVec3>> {
        let topology = Topology::new(faces.clone(), vertices.len())?;
        fit_vertices(&topology, vertices, normals, first, PULL, boundary, &mut Watch::silent())
    }

    /// A sheet of 12 × 12 with noise across it, its normals all z.
    fn noisy_sheet() -> (fixtures::MeshParts, Vec<DVec3>) {
        let (mut vertices, faces) = fixtures::grid(12, 12);
        let mut shifts = vec![DVec3::ZERO; vertices.len()];
        fixtures::jitter(&mut shifts, 0.2, 3);
        vertices.iter_mut().zip(shifts).for_each(|(v, shift)| v.z += shift.z);
        let normals = vec![DVec3::Z; faces.len()];
        ((vertices, faces), normals)
    }

    fn roughness(vertices: &[DVec3]) -> f64 {
        let mean = vertices.iter().map(|v| v.z).sum::<f64>() / vertices.len() as f64;
        (vertices.iter().map(|v| (v.z - mean).powi(2)).sum::<f64>() / vertices.len() as f64).sqrt()
    }

    #[test]
    fn a_noisy_sheet_becomes_flat_and_keeps_its_height_and_its_outline() {
        let (mesh, normals) = noisy_sheet();
        let moved = fitted(&mesh, &normals, &mesh.0, Boundary::Free).expect("valid");
        assert!(roughness(&moved) < 0.1 * roughness(&mesh.0), "{}", roughness(&moved));
        let height = |v: &[DVec3]| v.iter().map(|v| v.z).sum::<f64>() / v.len() as f64;
        assert!((height(&moved) - height(&mesh.0)).abs() < 0.01);
        assert!(moved.iter().zip(&mesh.0).all(|(a, b)| (*a - *b).truncate().length() < 1e-12));
    }

    #[test]
    fn half_cotangents_of_three_triangles() {
        let right = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let cotangents = half_cotangents(right, 0.5, 0.1);
        assert!((DVec3::from(cotangents) - DVec3::new(0.0, 0.5, 0.5)).length() < 1e-15);
        // A tenth of the area below which faces count less: a hundredth of the weight.
        let less = half_cotangents(right, 0.5, 5.0);
        assert!((DVec3::from(less) - DVec3::new(0.0, 0.005, 0.005)).length() < 1e-15);
        assert_eq!(half_cotangents([DVec3::ZERO, DVec3::X, DVec3::X * 2.0], 0.0, 0.1), [0.0; 3]);
        assert_eq!(half_cotangents([DVec3::ZERO; 3], 0.0, 0.0), [0.0; 3]);
    }

    #[test]
    fn the_angle_of_a_face_counts_whatever_its_shape() {
        // Over a tilt of slope s across the normal, one face has A s² in the first sum.
        for apex in [DVec3::new(0.3, 2.0, 0.0), DVec3::new(0.9, 0.02, 0.0), DVec3::new(-4.0, 0.5, 0.0)] {
            let corners = [DVec3::ZERO, DVec3::X, apex];
            let area = (corners[1] - corners[0]).cross(corners[2] - corners[0]).length() / 2.0;
            let [a, b, c] = half_cotangents(corners, area, 0.0);
            let slope = DVec3::new(0.3, -0.2, 0.0);
            let difference = |i: usize, j: usize| slope.dot(corners[i] - corners[j]).powi(2);
            let sum = a * difference(1, 2) + b * difference(2, 0) + c * difference(0, 1);
            assert!((sum - area * slope.length_squared()).abs() < 1e-12, "{apex}");
        }
    }

    #[test]
    fn where_a_vertex_that_flew_off_was_hardly_counts() {
        let (mesh, normals) = noisy_sheet();
        let flat: Vec<DVec3> = mesh.0.iter().map(|v| DVec3::new(v.x, v.y, 0.0)).collect();
        let sheet = (flat, mesh.1.clone());
        let pulled = |height: f64| {
            let mut first = mesh.0.clone();
            first[84].z = height;
            fitted(&sheet, &normals, &first, Boundary::Free).expect("valid")[84].z
        };
        let [near, far] = [pulled(0.2), pulled(50.0)];
        assert!(near > pulled(0.0) + 1e-4, "a vertex within the noise does: {near}");
        assert!((far - pulled(0.0)).abs() < 0.01, "{far}");
    }

    #[test]
    fn a_clean_mesh_stays_under_its_own_normals_and_so_does_what_has_no_faces() {
        let (mut vertices, faces) = fixtures::icosphere(2);
        vertices.push(DVec3::splat(7.0));
        let normals = FaceGeometry::compute(&vertices, &faces).normals;
        let mesh = (vertices, faces);
        let mut first = mesh.0.clone();
        *first.last_mut().expect("a vertex") = DVec3::ZERO;
        let moved = fitted(&mesh, &normals, &first, Boundary::Free).expect("valid");
        assert!(moved.iter().zip(&mesh.0).all(|(a, b)| a.distance(*b) < 1e-13));
    }

    #[test]
    fn rims_stay_where_they_are_held() {
        let (mesh, mut normals) = noisy_sheet();
        fixtures::jitter(&mut normals, 0.3, 6);
        let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid");
        let is_rim = topology.boundary_vertices();
        let after = |boundary| fitted(&mesh, &normals, &mesh.0, boundary).expect("valid");
        let (free, along, fixed) = (after(Boundary::Free), after(Boundary::Along), after(Boundary::Fixed));
        let outwards = |moved: &[DVec3]| {
            // The left rim, without its corners, may only leave its outline along x.
            let left = (1..12).map(|row| 13 * row);
            left.map(|i| (moved[i] - mesh.0[i]).x.abs()).fold(0.0, f64::max)
        };
        assert!(outwards(&free) > 3.0 * outwards(&along), "{} {}", outwards(&free), outwards(&along));
        for (i, &is_rim) in is_rim.iter().enumerate() {
            assert_eq!(fixed[i] == mesh.0[i], is_rim, "vertex {i}");
            assert!(along[i] != mesh.0[i]);
        }
    }

    #[test]
    fn one_thread_and_many_agree_to_the_bit_at_any_scale() {
        let (mut vertices, faces) = fixtures::icosphere(5);
        let normals = FaceGeometry::compute(&vertices, &faces).normals;
        fixtures::jitter(&mut vertices, 0.01, 4);
        let run = |threads: usize, scale: f64| {
            let scaled: Vec<DVec3> = vertices.iter().map(|v| *v * scale).collect();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let mesh = (scaled.clone(), faces.clone());
            pool.install(|| fitted(&mesh, &normals, &scaled, Boundary::Along)).expect("valid")
        };
        let one = run(1, 1.0);
        assert!(one == run(3, 1.0) && one == run(8, 1.0));
        for scale in [2f64.powi(-400), 2f64.powi(400)] {
            let back: Vec<DVec3> = run(2, scale).iter().map(|v| *v / scale).collect();
            assert!(back.iter().zip(&one).all(|(a, b)| a.distance(*b) < 1e-12));
        }
    }

    #[test]
    fn guards() {
        let mesh = fixtures::tetrahedron();
        let up = [DVec3::Z; 4];
        let error = fitted(&mesh, &up[..3], &mesh.0, Boundary::Free).unwrap_err();
        assert_eq!(error, GeomError::LengthMismatch { what: "normals", expected: 4, got: 3 });
        let error = fitted(&mesh, &up, &mesh.0[..3], Boundary::Free).unwrap_err();
        assert_eq!(error, GeomError::LengthMismatch { what: "first", expected: 4, got: 3 });
        let mut broken = mesh.0.clone();
        broken[1].x = f64::NAN;
        let error = fitted(&mesh, &up, &broken, Boundary::Free).unwrap_err();
        assert_eq!(error, GeomError::NonFiniteVertex { vertex_id: 1 });
        let error = fitted(&mesh, &[DVec3::NAN; 4], &mesh.0, Boundary::Free).unwrap_err();
        assert!(matches!(error, GeomError::InvalidParameter { name: "normals", .. }), "{error}");
        let topology = Topology::new(mesh.1.clone(), 4).expect("valid");
        for pull in [-1.0, f64::NAN, f64::INFINITY] {
            let watch = &mut Watch::silent();
            let error =
                fit_vertices(&topology, &mesh.0, &up, &mesh.0, pull, Boundary::Free, watch).unwrap_err();
            assert!(matches!(error, GeomError::InvalidParameter { name: "pull", .. }), "{error}");
        }
        let nothing = (vec![DVec3::ONE], Vec::new());
        assert_eq!(fitted(&nothing, &[], &[DVec3::ZERO], Boundary::Free).expect("valid"), [DVec3::ONE]);
    }
}
