//! The operators against hand values, and the solver's promises.

use super::operator::Operators;
use super::*;
use crate::fixtures::{self, MeshParts};
use crate::metrics::normal_error;
use crate::{GeomError, Topology};
use std::f64::consts::FRAC_PI_2;

fn operators((vertices, faces): &MeshParts) -> (Operators, FaceGeometry) {
    let topology = Topology::new(faces.clone(), vertices.len()).expect("valid");
    let geometry = FaceGeometry::compute(vertices, faces);
    (Operators::new(&topology, vertices, &geometry), geometry)
}

fn solver<'a>(operators: &'a Operators, params: &'a TgvParams, given: &'a [DVec3]) -> Solver<'a> {
    let (vertices, faces) = fixtures::tetrahedron();
    let topology = Topology::new(faces, vertices.len()).expect("valid");
    let mut watch = Watch::silent();
    let (mut run, _) = Run::start(&topology, &vertices, 4, &mut watch).expect("valid");
    Solver::new(operators, params, given, &mut run).expect("positive definite")
}

fn solved(mesh: &MeshParts, params: &TgvParams) -> Vec<DVec3> {
    let (operators, geometry) = operators(mesh);
    let mut solver = solver(&operators, params, &geometry.normals);
    for _ in 0..params.normal_iterations {
        assert!(solver.step());
    }
    solver.into_normals()
}

/// Equilateral triangles of edge length 1.
fn equilateral(nx: u32, ny: u32) -> MeshParts {
    let (vertices, faces) = fixtures::grid(nx, ny);
    let height = 0.75f64.sqrt();
    (vertices.into_iter().map(|v| DVec3::new(v.x - 0.5 * v.y, height * v.y, 0.0)).collect(), faces)
}

/// A grid rolled around the y axis, `bend` radians in all; its quads are flat.
fn rolled(nx: u32, ny: u32, bend: f64) -> MeshParts {
    let (vertices, faces) = fixtures::grid(nx, ny);
    let radius = f64::from(nx) / bend;
    let roll = |v: DVec3| DVec3::new(radius * (v.x / radius).sin(), v.y, radius * (v.x / radius).cos());
    (vertices.into_iter().map(roll).collect(), faces)
}

fn noisy_sphere() -> MeshParts {
    let (mut vertices, faces) = fixtures::icosphere(3);
    fixtures::jitter(&mut vertices, 0.02, 2);
    (vertices, faces)
}

#[test]
fn jumps_by_hand() {
    let (operators, geometry) = operators(&fixtures::two_triangles());
    let [edge] = operators.edges[..] else { panic!("one edge") };
    // Six half-edges, five edges: three of length 1, two of √2 and the shared one, √2 too.
    let mean = (2.0 + 3.0 * 2f64.sqrt()) / 5.0;
    assert!((edge.length - 2f64.sqrt() / mean).abs() < 1e-15);
    assert!((operators.areas[0] - 0.5 / mean / mean).abs() < 1e-15);
    let [first, second] = [geometry.normals[0], geometry.normals[1]];
    assert_eq!(operators.jump(&edge, &geometry.normals), second - first);
    assert_eq!(operators.jump_adjoint(0, |_| DVec3::X), -DVec3::X);
    assert_eq!(operators.jump_adjoint(1, |_| DVec3::X), DVec3::X);
}

#[test]
fn a_face_that_is_turned_over_bends_no_more() {
    let corners = fixtures::grid(1, 1).0;
    for (second, turn) in [([1, 3, 2], 1.0), ([1, 2, 3], -1.0)] {
        let (operators, geometry) = operators(&(corners.clone(), vec![[0, 1, 2], second]));
        assert_eq!(operators.edges[0].turn, turn);
        assert_eq!(geometry.normals[1], turn * geometry.normals[0]);
        assert_eq!(operators.jump(&operators.edges[0], &geometry.normals), DVec3::ZERO);
    }
}

#[test]
fn slope_jumps_by_hand() {
    // Between equilateral triangles |d| = 1/√3 and every edge adds 2/√3 · d/|d| to a gradient. An edge's own V cancels;
    // those of the four around it lie at 120 degrees: ½ · 2/√3 across and √¾ · 2/√3 along.
    let (operators, _) = operators(&equilateral(4, 4));
    let mut n_inner = 0;
    for e in 0..operators.edges.len() {
        let row: Vec<_> = operators.slope_jumps.row(e).collect();
        if row.len() < 5 {
            continue;
        }
        n_inner += 1;
        for (id, weight) in row {
            let expected = if id == e { (0.0, 0.0) } else { (1.0, 1.0 / 3f64.sqrt()) };
            let found = weight.abs();
            assert!((found.x - expected.0).abs() + (found.y - expected.1).abs() < 1e-12, "{e} {id} {found}");
        }
    }
    assert!(n_inner >= 12, "{n_inner}");
}

#[test]
fn even_bends_have_no_slope_jumps_and_others_do() {
    // A quantity over the unfolded plane, sheared so that no triangle is regular.
    let (vertices, faces) = fixtures::grid(6, 5);
    let sheared: Vec<DVec3> = vertices.iter().map(|v| DVec3::new(v.x + 0.3 * v.y, 0.8 * v.y, 0.0)).collect();
    let (operators, geometry) = operators(&(sheared, faces));
    let slope_jumps = |quantity: &dyn Fn(DVec3) -> f64| -> f64 {
        let at: Vec<DVec3> = geometry.centroids.iter().map(|c| DVec3::splat(quantity(*c))).collect();
        let v: Vec<DVec3> = operators.edges.iter().map(|edge| operators.jump(edge, &at)).collect();
        let size = |e| operators.slope_jump(e, &v).iter().map(|x| x.length()).fold(0.0, f64::max);
        (0..v.len()).map(size).fold(0.0, f64::max)
    };
    assert!(slope_jumps(&|c| 3.0 + 2.0 * c.x - c.y) < 1e-12);
    assert!(slope_jumps(&|c| c.x * c.x) > 0.5);
}

#[test]
fn folding_does_not_change_what_is_even() {
    let rows = |mesh: &MeshParts| -> Vec<(usize, glam::DVec2)> {
        let operators = operators(mesh).0;
        (0..operators.edges.len()).flat_map(|e| operators.slope_jumps.row(e).collect::<Vec<_>>()).collect()
    };
    let (vertices, faces) = fixtures::grid(6, 4);
    let fold = |v: &DVec3| if v.x > 3.0 { DVec3::new(3.0, v.y, v.x - 3.0) } else { *v };
    let folded = rows(&(vertices.iter().map(fold).collect(), faces.clone()));
    let flat = rows(&(vertices, faces));
    assert_eq!(flat.len(), folded.len());
    for ((i, a), (j, b)) in flat.iter().zip(&folded) {
        assert!(i == j && a.distance(*b) < 1e-12, "{i} {a} {j} {b}");
    }
}

#[test]
fn the_adjoints_are_adjoint() {
    for mesh in [noisy_sphere(), fixtures::moebius(), fixtures::three_on_an_edge(), rolled(7, 5, 1.0)] {
        let (operators, geometry) = operators(&mesh);
        let (n_edges, n_faces) = (operators.edges.len(), geometry.areas.len());
        let some = |i: usize| DVec3::new((i as f64).sin(), (1.7 * i as f64).cos(), (0.3 * i as f64).sin());
        let faces: Vec<DVec3> = (0..n_faces).map(some).collect();
        let edges: Vec<DVec3> = (0..n_edges).map(|e| some(e + 5)).collect();
        let pairs = |e: usize| [some(2 * e + 1), some(3 * e + 2)];
        let left: f64 =
            operators.edges.iter().zip(&edges).map(|(e, y)| operators.jump(e, &faces).dot(*y)).sum();
        let right: f64 =
            faces.iter().enumerate().map(|(f, x)| x.dot(operators.jump_adjoint(f, |e| edges[e]))).sum();
        assert!((left - right).abs() < 1e-11, "D: {left} {right}");
        let dot = |[a, b]: [DVec3; 2], [c, d]: [DVec3; 2]| a.dot(c) + b.dot(d);
        let left: f64 = (0..n_edges).map(|e| dot(operators.slope_jump(e, &edges), pairs(e))).sum();
        let adjoint = |e: usize| operators.slope_jump_adjoint(e, pairs);
        let right: f64 = edges.iter().enumerate().map(|(e, x)| x.dot(adjoint(e))).sum();
        assert!((left - right).abs() < 1e-9 * left.abs().max(1.0), "S: {left} {right}");
    }
}

#[test]
fn the_energy_falls_and_then_stays() {
    // Not in every step: an augmented Lagrangian meets its constraints only in the limit.
    let (operators, geometry) = operators(&noisy_sphere());
    for (alpha1, alpha0, beta) in [(1.0, 0.5, 2.0), (0.3, 3.0, 1.0), (3.0, 0.2, 5.0)] {
        let params = TgvParams { alpha1, alpha0, beta, ..TgvParams::default() };
        let mut solver = solver(&operators, &params, &geometry.normals);
        let mut energies = vec![solver.energy()];
        for n_steps in [50, 200] {
            assert!((0..n_steps).all(|_| solver.step()));
            energies.push(solver.energy());
        }
        let is_settled = (energies[2] - energies[1]).abs() < 0.02 * energies[1];
        assert!(energies[1] < 0.95 * energies[0] && is_settled, "{energies:?}");
    }
}

#[test]
fn an_even_bend_makes_no_stairs() {
    // A quarter of a cylinder. With V = 0, which a large α₀ enforces, the model is that of first order.
    let clean = rolled(40, 24, FRAC_PI_2);
    let truth = FaceGeometry::compute(&clean.0, &clean.1).normals;
    let mut mesh = clean;
    fixtures::jitter(&mut mesh.0, 0.15, 6);
    let first_order = TgvParams { alpha0: 1e6, ..TgvParams::default() };
    let [first, second] = [first_order, TgvParams::default()].map(|params| solved(&mesh, &params));
    let errors = [&first, &second].map(|normals| normal_error(normals, &truth).expect("same mesh"));
    assert!(errors[1] < 0.6 * errors[0], "{errors:?}");
    // Stairs: the bends from column to column along the middle of the strip, which should all be π/2/40.
    let even = FRAC_PI_2 / 40.0;
    let unevenness = |normals: &[DVec3]| {
        let column = |x: usize| -> DVec3 { (8..16).map(|y| normals[2 * (40 * y + x)]).sum::<DVec3>() };
        let bends = (4..35).map(|x| column(x).angle_between(column(x + 1)));
        bends.map(|bend| (bend - even).abs()).sum::<f64>() / 31.0 / even
    };
    assert!(unevenness(&second) < 0.5 * unevenness(&first), "{} {}", unevenness(&second), unevenness(&first));
}

#[test]
fn a_crease_stays() {
    let (mut vertices, faces) = fixtures::grid(16, 10);
    for v in &mut vertices {
        *v = if v.x > 8.0 { DVec3::new(8.0, v.y, v.x - 8.0) } else { *v };
    }
    let truth = FaceGeometry::compute(&vertices, &faces).normals;
    fixtures::jitter(&mut vertices, 0.1, 9);
    let noisy = FaceGeometry::compute(&vertices, &faces).normals;
    let mesh = (vertices, faces);
    let result = solved(&mesh, &TgvParams::default());
    let worst = |normals: &[DVec3]| {
        normals.iter().zip(&truth).map(|(a, b)| a.angle_between(*b).to_degrees()).fold(0.0, f64::max)
    };
    assert!(worst(&noisy) > 15.0 && worst(&result) < 6.0, "{} {}", worst(&noisy), worst(&result));
}

#[test]
fn orientation_does_not_matter() {
    let (vertices, faces) = noisy_sphere();
    let mut flipped = faces.clone();
    flipped.iter_mut().step_by(5).for_each(|face| face.swap(0, 1));
    let params = TgvParams::default();
    let denoised = |faces: Vec<crate::Face>| {
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        tgv(&topology, &vertices, &params, &mut Watch::silent()).expect("valid")
    };
    for (a, b) in denoised(faces).iter().zip(denoised(flipped)) {
        assert!(a.distance(b) < 1e-9, "{a} {b}");
    }
}

#[test]
fn a_face_without_area_takes_what_its_neighbours_agree_on() {
    let (mut vertices, faces) = fixtures::grid(4, 4);
    // Face 12, [6, 7, 12], collapses: vertex 7 goes onto the edge 6–12.
    vertices[7] = vertices[6].lerp(vertices[12], 0.4);
    let given = FaceGeometry::compute(&vertices, &faces).normals;
    let flat: Vec<usize> = (0..faces.len()).filter(|f| given[*f] == DVec3::ZERO).collect();
    let result = solved(&(vertices, faces), &TgvParams::default());
    assert_eq!(flat.len(), 1);
    assert!(result[flat[0]].distance(DVec3::Z) < 1e-6, "{}", result[flat[0]]);
}

#[test]
fn what_cannot_be_solved_is_told() {
    let (vertices, faces) = noisy_sphere();
    let topology = Topology::new(faces, vertices.len()).expect("valid");
    let params = TgvParams { alpha1: f64::MAX, ..TgvParams::default() };
    let result = tgv(&topology, &vertices, &params, &mut Watch::silent());
    assert_eq!(result, Err(GeomError::Diverged { iteration: 1 }));
    let geometry = FaceGeometry::compute(&vertices, topology.faces());
    let operators = Operators::new(&topology, &vertices, &geometry);
    let mut given = geometry.normals.clone();
    given[3].y = f64::NAN;
    let params = TgvParams::default();
    assert!(!solver(&operators, &params, &given).step());
}

#[test]
fn parameters_out_of_range_name_themselves() {
    let default = TgvParams::default();
    let cases = [
        ("alpha1", TgvParams { alpha1: 0.0, ..default }),
        ("alpha0", TgvParams { alpha0: -1.0, ..default }),
        ("beta", TgvParams { beta: f64::NAN, ..default }),
        ("beta", TgvParams { beta: f64::INFINITY, ..default }),
    ];
    for (expected, params) in cases {
        match params.validate() {
            Err(GeomError::InvalidParameter { name, .. }) => assert_eq!(name, expected),
            other => panic!("{expected}: {other:?}"),
        }
    }
}
