//! Properties of normal refinement, vertex updating and the error metrics.

use gcnd_geom::face_geometry::FaceGeometry;
use gcnd_geom::fixtures::{self, MeshParts};
use gcnd_geom::metrics::{angles, normal_error, vertex_error};
use gcnd_geom::normals::{Neighborhood, RefineParams, refine_normals};
use gcnd_geom::vertex_fit::{PULL, fit_vertices};
use gcnd_geom::vertex_update::{Boundary, update_vertices};
use gcnd_geom::{DMat3, DVec3, Face, GeomError, Topology, Watch};
use proptest::prelude::*;

fn neighborhoods() -> impl Strategy<Value = Neighborhood> {
    prop_oneof![
        Just(Neighborhood::SharedVertex),
        Just(Neighborhood::SharedEdge),
        (0.5..4.0).prop_map(|multiple| Neighborhood::Radius { multiple }),
    ]
}

prop_compose! {
    fn refine_params()(iterations in 1usize..6, sigma_r in 0.05..2.0, neighborhood in neighborhoods())
        -> RefineParams
    {
        RefineParams { iterations, sigma_s: None, sigma_r, neighborhood }
    }
}

/// Closed, open, non-manifold and non-orientable meshes, each jittered.
fn meshes() -> impl Strategy<Value = MeshParts> {
    let kinds: [fn() -> MeshParts; 8] = [
        fixtures::tetrahedron,
        fixtures::cube,
        fixtures::open_fan,
        fixtures::moebius,
        fixtures::three_on_an_edge,
        fixtures::hourglass,
        || fixtures::grid(5, 4),
        || fixtures::icosphere(2),
    ];
    (0..kinds.len(), 0.0..0.2, any::<u64>()).prop_map(move |(kind, amplitude, seed)| {
        let (mut vertices, faces) = kinds[kind]();
        fixtures::jitter(&mut vertices, amplitude, seed);
        (vertices, faces)
    })
}

/// Meshes of coincident points, collinear or repeated faces and isolated vertices.
fn degenerate_meshes() -> impl Strategy<Value = MeshParts> {
    let coordinate = prop_oneof![Just(0.0), Just(1.0), Just(-1.0), Just(1e-300), Just(1e100), -2.0..2.0];
    let vertex =
        (coordinate.clone(), coordinate.clone(), coordinate).prop_map(|(x, y, z)| DVec3::new(x, y, z));
    let face = (0u32..8, 0u32..8, 0u32..8).prop_map(|(a, b, c)| [a, b, c]);
    (prop::collection::vec(vertex, 8..12), prop::collection::vec(face, 1..20))
}

fn rotations() -> impl Strategy<Value = DMat3> {
    (-1.0..1.0, -1.0..1.0, -1.0..1.0, 0.1..3.0).prop_filter_map("an axis", |(x, y, z, angle)| {
        let axis = DVec3::new(x, y, z).try_normalize()?;
        Some(DMat3::from_axis_angle(axis, angle))
    })
}

fn topology((vertices, faces): &MeshParts) -> Topology {
    Topology::new(faces.clone(), vertices.len()).expect("generated faces are valid")
}

fn face_normals((vertices, faces): &MeshParts) -> Vec<DVec3> {
    FaceGeometry::compute(vertices, faces).normals
}

fn refined(mesh: &MeshParts, normals: &[DVec3], params: &RefineParams) -> Vec<DVec3> {
    refine_normals(&topology(mesh), &mesh.0, normals, params, &mut Watch::silent()).expect("valid")
}

fn updated(mesh: &MeshParts, normals: &[DVec3], iterations: usize) -> Vec<DVec3> {
    update_vertices(&topology(mesh), &mesh.0, normals, iterations, Boundary::Free, &mut Watch::silent())
        .expect("valid")
}

fn fitted(mesh: &MeshParts, normals: &[DVec3], first: &[DVec3]) -> Vec<DVec3> {
    fit_vertices(&topology(mesh), &mesh.0, normals, first, PULL, Boundary::Along, &mut Watch::silent())
        .expect("valid")
}

fn largest_distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

fn with_threads<T: Send>(n: usize, run: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads").install(run)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_clean_mesh_stays_under_its_own_normals(mesh in meshes(), iterations in 0usize..30) {
        let moved = updated(&mesh, &face_normals(&mesh), iterations);
        prop_assert!(largest_distance(&moved, &mesh.0) < 1e-13);
    }

    #[test]
    fn a_plane_is_a_fixed_point_of_refinement(
        (nx, ny) in (1u32..8, 1u32..8),
        rotation in rotations(),
        offset in -1e3..1e3,
        params in refine_params(),
    ) {
        let (mut vertices, faces) = fixtures::grid(nx, ny);
        fixtures::jitter(&mut vertices, 0.3, 11);
        for v in &mut vertices {
            *v = rotation * DVec3::new(v.x, v.y, 0.0) + DVec3::splat(offset);
        }
        let plane = rotation * DVec3::Z;
        let normals = vec![plane; faces.len()];
        let mesh = (vertices, faces);
        prop_assert!(largest_distance(&refined(&mesh, &normals, &params), &normals) < 1e-14);
    }

    #[test]
    fn refined_normals_are_unit(mesh in meshes(), params in refine_params(), scale in 1e-3..1e3) {
        let normals: Vec<DVec3> = face_normals(&mesh).iter().map(|n| *n * scale).collect();
        for n in refined(&mesh, &normals, &params) {
            prop_assert!((n.length() - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn rotating_before_or_after_is_the_same(
        mesh in meshes(),
        params in refine_params(),
        rotation in rotations(),
    ) {
        let turn = |vectors: &[DVec3]| vectors.iter().map(|v| rotation * *v).collect::<Vec<_>>();
        // A radius that passes exactly through a centroid may gain or lose it to rounding.
        let neighborhood = match params.neighborhood {
            Neighborhood::Radius { .. } => Neighborhood::SharedVertex,
            other => other,
        };
        let params = RefineParams { neighborhood, ..params };
        let normals = face_normals(&mesh);
        let turned = (turn(&mesh.0), mesh.1.clone());
        let target = refined(&mesh, &normals, &params);
        prop_assert!(largest_distance(&refined(&turned, &turn(&normals), &params), &turn(&target)) < 1e-12);
        let moved = updated(&mesh, &target, 10);
        prop_assert!(largest_distance(&updated(&turned, &turn(&target), 10), &turn(&moved)) < 1e-12);
        let at_moved = |vertices: &[DVec3]| (vertices.to_vec(), mesh.1.clone());
        let near = fitted(&at_moved(&moved), &target, &mesh.0);
        let turned_near = fitted(&at_moved(&turn(&moved)), &turn(&target), &turned.0);
        let off = largest_distance(&turned_near, &turn(&near));
        // The solver stops at 1e-12 of the first residual.
        prop_assert!(off < 1e-6, "{off}");
    }

    #[test]
    fn moving_the_mesh_moves_the_result(mesh in meshes(), shift in -100.0..100.0) {
        let shift = DVec3::new(shift, -shift, 0.5 * shift);
        let shifted = (mesh.0.iter().map(|v| *v + shift).collect::<Vec<_>>(), mesh.1.clone());
        let normals = vec![DVec3::Z; mesh.1.len()];
        let expected: Vec<DVec3> = updated(&mesh, &normals, 5).iter().map(|v| *v + shift).collect();
        prop_assert!(largest_distance(&updated(&shifted, &normals, 5), &expected) < 1e-11);
    }

    #[test]
    fn degenerate_meshes_stay_finite(mesh in degenerate_meshes(), params in refine_params()) {
        let result = refined(&mesh, &face_normals(&mesh), &params);
        for n in &result {
            let length = n.length();
            prop_assert!(*n == DVec3::ZERO || (length - 1.0).abs() < 1e-14, "{n}");
        }
        for v in updated(&mesh, &result, 15) {
            prop_assert!(v.is_finite());
        }
        for v in fitted(&mesh, &result, &mesh.0) {
            prop_assert!(v.is_finite());
        }
    }

    #[test]
    fn angles_are_symmetric_and_within_180_degrees(
        a in prop::array::uniform3(-1.0f64..1.0),
        b in prop::array::uniform3(-1.0f64..1.0),
    ) {
        let (a, b) = ([DVec3::from(a)], [DVec3::from(b)]);
        prop_assume!(a[0] != DVec3::ZERO && b[0] != DVec3::ZERO);
        let angle = angles(&a, &b).expect("same length")[0];
        prop_assert!((0.0..=180.0).contains(&angle));
        prop_assert!((angle - angles(&b, &a).expect("same length")[0]).abs() < 1e-12);
        prop_assert!((angle - a[0].angle_between(b[0]).to_degrees()).abs() < 1e-5);
        prop_assert_eq!(normal_error(&a, &a).expect("same length"), 0.0);
    }
}

#[test]
fn one_thread_and_many_agree_to_the_bit() {
    let (mut vertices, faces): (Vec<DVec3>, Vec<Face>) = fixtures::icosphere(6);
    let truth = vertices.clone();
    fixtures::jitter(&mut vertices, 0.01, 4);
    let mesh = (vertices, faces);
    let run = |neighborhood| {
        let params = RefineParams { iterations: 3, neighborhood, ..RefineParams::default() };
        let normals = refined(&mesh, &face_normals(&mesh), &params);
        let moved = updated(&mesh, &normals, 5);
        let error = vertex_error(&moved, &mesh.1, &truth, &mesh.1, 20_000, 1).expect("valid");
        (normals, moved, error.to_bits())
    };
    for neighborhood in
        [Neighborhood::SharedVertex, Neighborhood::SharedEdge, Neighborhood::Radius { multiple: 2.0 }]
    {
        let one = with_threads(1, || run(neighborhood));
        assert!(one == with_threads(3, || run(neighborhood)), "{neighborhood:?}");
        assert!(one == with_threads(8, || run(neighborhood)), "{neighborhood:?}");
    }
}

#[test]
fn refining_and_updating_denoise_a_cube() {
    // Eight steps along each edge of the cube, noise of an eighth of a step.
    let (mut vertices, faces) = fixtures::cube();
    let mut mesh = (std::mem::take(&mut vertices), faces);
    for _ in 0..4 {
        mesh = fixtures::split(&mesh);
    }
    let truth = face_normals(&mesh);
    let clean = mesh.0.clone();
    fixtures::jitter(&mut mesh.0, 0.01, 8);
    let noisy_error = normal_error(&face_normals(&mesh), &truth).expect("same mesh");
    let params = RefineParams { iterations: 20, sigma_r: 0.4, ..RefineParams::default() };
    let normals = refined(&mesh, &face_normals(&mesh), &params);
    let refined_error = normal_error(&normals, &truth).expect("same mesh");
    let moved = (updated(&mesh, &normals, 15), mesh.1.clone());
    let updated_error = normal_error(&face_normals(&moved), &truth).expect("same mesh");
    assert!(noisy_error > 9.0, "{noisy_error}");
    assert!(refined_error < 1.0 && updated_error < 1.5, "{refined_error} {updated_error}");
    let e_v = |v: &[DVec3]| vertex_error(v, &mesh.1, &clean, &mesh.1, 50_000, 0).expect("valid");
    assert!(e_v(&moved.0) < e_v(&mesh.0));
}

#[test]
fn normals_of_another_mesh_are_refused() {
    let mesh = fixtures::cube();
    let expected = GeomError::LengthMismatch { what: "normals", expected: 12, got: 11 };
    let normals = vec![DVec3::Z; 11];
    let params = RefineParams::default();
    let (topology, mut watch) = (topology(&mesh), Watch::silent());
    let refined = refine_normals(&topology, &mesh.0, &normals, &params, &mut watch);
    assert_eq!(refined, Err(expected.clone()));
    let updated = update_vertices(&topology, &mesh.0, &normals, 1, Boundary::Free, &mut watch);
    assert_eq!(updated, Err(expected));
}
