//! What all classical filters have in common: planes stay, any mesh is handled, threads and units do not matter.

use gcnd_geom::face_geometry::FaceGeometry;
use gcnd_geom::fixtures::{self, MeshParts};
use gcnd_geom::metrics::normal_error;
use gcnd_geom::normals::*;
use gcnd_geom::smoothing::*;
use gcnd_geom::{DMat3, DVec3, Face, GeomError, Result, Topology, Watch};
use proptest::prelude::*;
use std::ops::ControlFlow;

type Run = fn(&Topology, &[DVec3], &mut Watch<'_>) -> Result<Vec<DVec3>>;

/// One filter at its defaults.
struct Filter {
    name: &'static str,
    run: Run,
    /// Whether vertices slide along a plane towards the mean of their neighbours.
    slides: bool,
    /// E_a, in degrees, that it must reach on the noisy cube and the noisy sphere: what was measured, and 20 %.
    /// None on the cube for the one that rounds its edges as much as it smooths its sides.
    limits: (f64, f64),
}

const FILTERS: [Filter; 11] = [
    Filter {
        name: "bilateral_normal",
        run: |t, v, w| bilateral_normal(t, v, &BilateralNormalParams::default(), w),
        slides: false,
        limits: (0.6, 1.3),
    },
    Filter {
        name: "bilateral_normal_implicit",
        run: |t, v, w| bilateral_normal_implicit(t, v, &ImplicitNormalParams::default(), w),
        slides: false,
        limits: (1.3, 1.5),
    },
    Filter {
        name: "guided_normal",
        run: |t, v, w| guided_normal(t, v, &GuidedNormalParams::default(), w),
        slides: false,
        limits: (1.0, 1.5),
    },
    Filter {
        name: "fast_effective",
        run: |t, v, w| fast_effective(t, v, &FastEffectiveParams::default(), w),
        slides: false,
        limits: (0.5, 2.1),
    },
    Filter {
        name: "tgv",
        run: |t, v, w| tgv(t, v, &TgvParams::default(), w),
        slides: false,
        limits: (0.8, 0.8),
    },
    Filter {
        name: "low_rank",
        run: |t, v, w| low_rank(t, v, &LowRankParams::default(), w),
        slides: false,
        limits: (8.1, 1.15),
    },
    Filter {
        name: "bilateral_mesh",
        run: |t, v, w| bilateral_mesh(t, v, &BilateralMeshParams::default(), w),
        slides: false,
        limits: (7.2, 4.3),
    },
    Filter {
        name: "l0",
        run: |t, v, w| l0(t, v, &L0Params::default(), w),
        slides: false,
        limits: (0.4, 5.8),
    },
    Filter {
        name: "laplacian",
        run: |t, v, w| laplacian(t, v, &LaplacianParams::default(), w),
        slides: true,
        limits: (f64::INFINITY, 1.9),
    },
    Filter {
        name: "taubin",
        run: |t, v, w| taubin(t, v, &TaubinParams::default(), w),
        slides: true,
        limits: (8.0, 1.9),
    },
    Filter {
        name: "hc_laplacian",
        run: |t, v, w| hc_laplacian(t, v, &HcLaplacianParams::default(), w),
        slides: true,
        limits: (8.0, 1.8),
    },
];

impl Filter {
    fn apply(&self, (vertices, faces): &MeshParts) -> Result<Vec<DVec3>> {
        let topology = Topology::new(faces.clone(), vertices.len())?;
        (self.run)(&topology, vertices, &mut Watch::silent())
    }
}

fn largest_distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

fn face_normals((vertices, faces): &MeshParts) -> Vec<DVec3> {
    FaceGeometry::compute(vertices, faces).normals
}

fn noisy_sphere() -> MeshParts {
    let (mut vertices, faces) = fixtures::icosphere(3);
    fixtures::jitter(&mut vertices, 0.015, 5);
    (vertices, faces)
}

/// The cube's faces, each split into `4^levels`.
fn split_cube(levels: u32) -> MeshParts {
    let mut mesh = fixtures::cube();
    for _ in 0..levels {
        mesh = fixtures::split(&mesh);
    }
    mesh
}

/// Two meshes as one, the second moved.
fn joined(one: &MeshParts, other: &MeshParts, shift: DVec3) -> MeshParts {
    let first = one.0.len() as u32;
    let vertices = one.0.iter().copied().chain(other.0.iter().map(|v| *v + shift)).collect();
    let faces = one.1.iter().copied().chain(other.1.iter().map(|f| f.map(|v| v + first))).collect();
    (vertices, faces)
}

/// Everything that a mesh may come with, by name.
fn difficult_meshes() -> Vec<(&'static str, MeshParts)> {
    let sphere = noisy_sphere();
    let mut meshes = vec![
        ("boundary", fixtures::open_fan()),
        ("non-manifold edge", fixtures::three_on_an_edge()),
        ("non-manifold vertex", fixtures::hourglass()),
        ("not orientable", fixtures::moebius()),
        ("several components", joined(&sphere, &fixtures::cube(), DVec3::X * 4.0)),
        ("one face", (vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]])),
        ("one point", (vec![DVec3::ONE; 3], vec![[0, 1, 2], [2, 1, 0]])),
        ("no faces", (vec![DVec3::ONE, DVec3::X], vec![])),
        ("nothing", (vec![], vec![])),
    ];
    let mut zero_area = sphere.clone();
    let [a, b, c] = zero_area.1[7];
    zero_area.0[a as usize] = zero_area.0[b as usize].lerp(zero_area.0[c as usize], 0.3);
    let [a, b, _] = zero_area.1[90];
    zero_area.0[a as usize] = zero_area.0[b as usize];
    zero_area.1.extend([[3, 3, 9], [5, 5, 5]]);
    meshes.push(("zero-area faces", zero_area));
    let mut unreferenced = sphere.clone();
    unreferenced.0.extend([DVec3::splat(0.3), DVec3::splat(-1.0)]);
    meshes.push(("unreferenced vertices", unreferenced));
    let mut flipped = sphere.clone();
    flipped.1.iter_mut().step_by(5).for_each(|face| face.swap(0, 1));
    meshes.push(("flipped faces", flipped));
    let mut repeated = sphere;
    repeated.1.extend_from_within(10..20);
    meshes.push(("repeated faces", repeated));
    meshes
}

#[test]
fn a_plane_is_a_fixed_point() {
    let (mut vertices, faces) = fixtures::grid(7, 6);
    fixtures::jitter(&mut vertices, 0.3, 11);
    let rotation = DMat3::from_rotation_x(0.7) * DMat3::from_rotation_z(1.9);
    for v in &mut vertices {
        *v = rotation * DVec3::new(v.x, v.y, 2.0);
    }
    let normal = rotation * DVec3::Z;
    let mesh = (vertices, faces);
    for filter in &FILTERS {
        let moved = filter.apply(&mesh).expect("valid");
        let off_plane = moved.iter().map(|v| (v.dot(normal) - 2.0).abs()).fold(0.0, f64::max);
        assert!(off_plane < 1e-12, "{}: {off_plane}", filter.name);
        let slid = largest_distance(&moved, &mesh.0);
        assert!(filter.slides || slid < 1e-7, "{}: {slid}", filter.name);
    }
}

#[test]
fn difficult_meshes_are_handled() {
    for (kind, mesh) in difficult_meshes() {
        let mut is_used = vec![false; mesh.0.len()];
        mesh.1.iter().flatten().for_each(|v| is_used[*v as usize] = true);
        for filter in &FILTERS {
            let moved =
                filter.apply(&mesh).unwrap_or_else(|error| panic!("{}, {kind}: {error}", filter.name));
            assert_eq!(moved.len(), mesh.0.len());
            for (v, (moved, given)) in moved.iter().zip(&mesh.0).enumerate() {
                let way = moved.distance(*given);
                assert!(way < 1.5, "{}, {kind}: vertex {v} went {way}", filter.name);
                assert!(is_used[v] || way < 1e-15, "{}, {kind}: unused vertex {v} went {way}", filter.name);
            }
        }
    }
}

#[test]
fn a_copy_far_away_changes_nothing() {
    let sphere = noisy_sphere();
    let both = joined(&sphere, &sphere, DVec3::X * 8.0);
    for filter in &FILTERS {
        let alone = filter.apply(&sphere).expect("valid");
        let moved = filter.apply(&both).expect("valid");
        let worst = largest_distance(&moved[..alone.len()], &alone);
        assert!(worst < 1e-9, "{}: {worst}", filter.name);
    }
}

#[test]
fn noise_is_removed() {
    let (mut vertices, faces) = split_cube(4);
    let truth = face_normals(&(vertices.clone(), faces.clone()));
    fixtures::jitter(&mut vertices, 0.012, 8);
    let cube = (vertices, faces);
    let (mut vertices, faces) = fixtures::icosphere(4);
    let sphere_truth = face_normals(&(vertices.clone(), faces.clone()));
    fixtures::jitter(&mut vertices, 0.015, 5);
    let sphere = (vertices, faces);
    let error = |mesh: &MeshParts, vertices: Vec<DVec3>, truth: &[DVec3]| {
        normal_error(&face_normals(&(vertices, mesh.1.clone())), truth).expect("same mesh")
    };
    let noise = (error(&cube, cube.0.clone(), &truth), error(&sphere, sphere.0.clone(), &sphere_truth));
    assert!(noise.0 > 11.5 && noise.1 > 8.0, "{noise:?}");
    for filter in &FILTERS {
        let on_cube = error(&cube, filter.apply(&cube).expect("valid"), &truth);
        let on_sphere = error(&sphere, filter.apply(&sphere).expect("valid"), &sphere_truth);
        assert!(on_cube < filter.limits.0, "{}: {on_cube} on the cube", filter.name);
        assert!(on_sphere < filter.limits.1, "{}: {on_sphere} on the sphere", filter.name);
    }
}

#[test]
fn one_thread_and_many_agree_to_the_bit() {
    let (mut vertices, faces) = fixtures::icosphere(5);
    fixtures::jitter(&mut vertices, 0.01, 4);
    let mesh = (vertices, faces);
    let with_threads = |n, filter: &Filter| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads");
        pool.install(|| filter.apply(&mesh).expect("valid"))
    };
    for filter in &FILTERS {
        let one = with_threads(1, filter);
        assert!(one == with_threads(3, filter), "{}", filter.name);
        assert!(one == with_threads(8, filter), "{}", filter.name);
    }
}

#[test]
fn units_do_not_matter() {
    // Powers of two are exact, so the results are, too.
    let mesh = noisy_sphere();
    for filter in &FILTERS {
        let expected = filter.apply(&mesh).expect("valid");
        for exponent in [-500, -3, 10, 500] {
            let scale = f64::exp2(f64::from(exponent));
            let scaled = (mesh.0.iter().map(|v| *v * scale).collect(), mesh.1.clone());
            let moved: Vec<DVec3> =
                filter.apply(&scaled).expect("valid").iter().map(|v| *v / scale).collect();
            assert!(moved == expected, "{} at 2^{exponent}", filter.name);
        }
    }
}

#[test]
fn every_iteration_can_be_the_last() {
    let mesh = fixtures::icosphere(1);
    let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid");
    for filter in &FILTERS {
        let mut seen = Vec::new();
        let mut report = |iteration, total| {
            seen.push((iteration, total));
            ControlFlow::Continue(())
        };
        (filter.run)(&topology, &mesh.0, &mut Watch::new(&mut report)).expect("valid");
        // Within a long iteration it may be asked as well, with the number of the last one that is done.
        seen.dedup();
        seen.retain(|(iteration, _)| *iteration > 0);
        let total = seen.len();
        let expected: Vec<_> = (1..=total).map(|iteration| (iteration, total)).collect();
        assert_eq!(seen, expected, "{}", filter.name);
        for last in [1, total / 2, total] {
            let mut stop = |iteration, _| {
                if iteration < last { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            };
            let result = (filter.run)(&topology, &mesh.0, &mut Watch::new(&mut stop));
            assert_eq!(result, Err(GeomError::Cancelled { iteration: last }), "{}", filter.name);
        }
    }
}

#[test]
fn meshes_that_cannot_be_worked_on_are_refused() {
    let (vertices, faces) = fixtures::tetrahedron();
    let topology = Topology::new(faces, 4).expect("valid");
    for filter in &FILTERS {
        let error = (filter.run)(&topology, &vertices[..3], &mut Watch::silent()).unwrap_err();
        assert_eq!(error, GeomError::LengthMismatch { what: "vertices", expected: 4, got: 3 });
        let mut broken = vertices.clone();
        broken[2].y = f64::NAN;
        let error = (filter.run)(&topology, &broken, &mut Watch::silent()).unwrap_err();
        assert_eq!(error, GeomError::NonFiniteVertex { vertex_id: 2 });
    }
}

#[test]
fn parameters_out_of_range_name_themselves() {
    let bnf = BilateralNormalParams::default();
    let gnf = GuidedNormalParams::default();
    let cases = [
        ("sigma_r", BilateralNormalParams { sigma_r: 0.0, ..bnf }.validate()),
        ("sigma_s", BilateralNormalParams { sigma_s: Some(-1.0), ..bnf }.validate()),
        ("sigma_r", GuidedNormalParams { sigma_r: f64::NAN, ..gnf }.validate()),
        ("sigma_s", GuidedNormalParams { sigma_s: Some(f64::INFINITY), ..gnf }.validate()),
        ("sigma_s", ImplicitNormalParams { sigma_s: Some(0.0), ..Default::default() }.validate()),
        ("smoothness", ImplicitNormalParams { smoothness: 0.0, ..Default::default() }.validate()),
        ("radius", GuidedNormalParams { radius: -2.0, ..gnf }.validate()),
        ("threshold", FastEffectiveParams { threshold: 1.0, ..Default::default() }.validate()),
        ("alpha1", TgvParams { alpha1: 0.0, ..Default::default() }.validate()),
        ("alpha0", TgvParams { alpha0: -1.0, ..Default::default() }.validate()),
        ("beta", TgvParams { beta: f64::NAN, ..Default::default() }.validate()),
        ("sigma_m", LowRankParams { sigma_m: 0.0, ..Default::default() }.validate()),
        ("similar_patches", LowRankParams { similar_patches: 65, ..Default::default() }.validate()),
        ("patch_size", LowRankParams { patch_size: 1, ..Default::default() }.validate()),
        ("search_rings", LowRankParams { search_rings: 0, ..Default::default() }.validate()),
        ("lambda", LaplacianParams { lambda: 1.5, ..Default::default() }.validate()),
        ("lambda", TaubinParams { lambda: 0.0, ..Default::default() }.validate()),
        ("mu", TaubinParams { mu: -0.5, ..Default::default() }.validate()),
        ("alpha", HcLaplacianParams { alpha: -0.1, ..Default::default() }.validate()),
        ("beta", HcLaplacianParams { beta: f64::NAN, ..Default::default() }.validate()),
    ];
    for (expected, result) in cases {
        match result {
            Err(GeomError::InvalidParameter { name, .. }) => assert_eq!(name, expected),
            other => panic!("{expected}: {other:?}"),
        }
    }
}

/// Meshes of coincident points, collinear or repeated faces and isolated vertices.
fn degenerate_meshes() -> impl Strategy<Value = MeshParts> {
    let coordinate = prop_oneof![Just(0.0), Just(1.0), Just(-1.0), Just(1e-300), -2.0..2.0];
    let vertex =
        (coordinate.clone(), coordinate.clone(), coordinate).prop_map(|(x, y, z)| DVec3::new(x, y, z));
    let face = (0u32..8, 0u32..8, 0u32..8).prop_map(|(a, b, c)| -> Face { [a, b, c] });
    (prop::collection::vec(vertex, 8..12), prop::collection::vec(face, 1..20))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn degenerate_meshes_stay_finite(mesh in degenerate_meshes()) {
        for filter in &FILTERS {
            match filter.apply(&mesh) {
                Ok(moved) => prop_assert!(moved.iter().all(|v| v.is_finite()), "{}", filter.name),
                Err(GeomError::Diverged { .. }) => {}
                Err(error) => prop_assert!(false, "{}: {error}", filter.name),
            }
        }
    }
}
