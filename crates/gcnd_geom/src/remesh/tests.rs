//! Hand tests of remeshing: the cube's features, quality, locked edges, and refused parameters.

use std::collections::HashMap;

use glam::DVec3;

use super::{RemeshParams, remesh, remesh_with_sizes};
use crate::error::GeomError;
use crate::fixtures;
use crate::mesh::Face;

const CUBE_EDGE: f64 = 1.0;

fn params(target_edge_length: f64) -> RemeshParams {
    RemeshParams { target_edge_length, ..RemeshParams::default() }
}

/// How often each directed edge occurs.
fn directed_edges(faces: &[Face]) -> HashMap<(u32, u32), usize> {
    let mut count = HashMap::new();
    for face in faces {
        for i in 0..3 {
            *count.entry((face[i], face[(i + 1) % 3])).or_insert(0) += 1;
        }
    }
    count
}

fn euler_characteristic(n_vertices: usize, faces: &[Face]) -> i64 {
    let undirected: std::collections::HashSet<_> =
        directed_edges(faces).into_keys().map(|(a, b)| (a.min(b), a.max(b))).collect();
    n_vertices as i64 - undirected.len() as i64 + faces.len() as i64
}

fn cross(vertices: &[DVec3], face: &Face) -> DVec3 {
    let [a, b, c] = face.map(|v| vertices[v as usize]);
    (b - a).cross(c - a)
}

fn volume(vertices: &[DVec3], faces: &[Face]) -> f64 {
    faces.iter().map(|face| vertices[face[0] as usize].dot(cross(vertices, face)) / 6.0).sum()
}

/// The cube moved to [0, 1]³, whatever its fixture's place and size.
fn unit_cube() -> (Vec<DVec3>, Vec<Face>) {
    let (vertices, faces) = fixtures::cube();
    let lower = vertices.iter().copied().reduce(DVec3::min).unwrap();
    let upper = vertices.iter().copied().reduce(DVec3::max).unwrap();
    (vertices.iter().map(|v| (*v - lower) / (upper - lower) * CUBE_EDGE).collect(), faces)
}

#[test]
fn cube_keeps_corners_edges_planes_and_volume() {
    let (vertices, faces) = unit_cube();
    let (new_vertices, new_faces) = remesh(&vertices, &faces, &params(0.08)).unwrap();
    assert!(vertices.iter().all(|corner| new_vertices.contains(corner)));
    assert_eq!(euler_characteristic(new_vertices.len(), &new_faces), 2);
    assert!((volume(&new_vertices, &new_faces) - 1.0).abs() < 1e-12);
    for face in &new_faces {
        // Every face lies in one side of the cube and looks out of it.
        let normal = cross(&new_vertices, face).normalize();
        let centre = face.iter().map(|&v| new_vertices[v as usize]).sum::<DVec3>() / 3.0;
        assert!((normal.abs().max_element() - 1.0).abs() < 1e-9, "{normal}");
        assert!((centre - DVec3::splat(0.5)).dot(normal) > 0.5 - 1e-9);
    }
}

#[test]
fn cube_edges_are_sampled_along_themselves() {
    let (vertices, faces) = unit_cube();
    let (new_vertices, _) = remesh(&vertices, &faces, &params(0.1)).unwrap();
    let on_edge = |v: &&DVec3| v.to_array().iter().filter(|x| **x == 0.0 || **x == 1.0).count() == 2;
    let n_on_edges = new_vertices.iter().filter(on_edge).count();
    // Ten pieces on each of twelve edges, give or take the tolerance of the length.
    assert!((12 * 7..=12 * 12).contains(&n_on_edges), "{n_on_edges}");
}

#[test]
fn lengths_come_near_the_target() {
    for (mesh, angle) in [(unit_cube(), 30.0), (fixtures::icosphere(4), 180.0)] {
        let target = 0.11;
        let settings = RemeshParams { feature_angle_deg: angle, ..params(target) };
        let (vertices, faces) = remesh(&mesh.0, &mesh.1, &settings).unwrap();
        let lengths = directed_edges(&faces)
            .into_keys()
            .map(|(a, b)| vertices[a as usize].distance(vertices[b as usize]));
        let ratios: Vec<f64> = lengths.map(|length| length / target).collect();
        let n_good = ratios.iter().filter(|ratio| (0.5..=1.6).contains(*ratio)).count();
        assert!(n_good as f64 > 0.99 * ratios.len() as f64, "{n_good} of {}", ratios.len());
    }
}

#[test]
fn sphere_stays_on_the_input_surface() {
    let (vertices, faces) = fixtures::icosphere(4);
    let settings = RemeshParams { feature_angle_deg: 180.0, ..params(0.12) };
    let (new_vertices, new_faces) = remesh(&vertices, &faces, &settings).unwrap();
    // A level-4 icosphere's faces lie at most this deep under the unit sphere.
    let sagitta = faces
        .iter()
        .map(|f| 1.0 - (f.iter().map(|&v| vertices[v as usize]).sum::<DVec3>() / 3.0).length())
        .fold(0.0, f64::max);
    assert!(new_vertices.iter().all(|v| v.length() <= 1.0 + 1e-12 && v.length() >= 1.0 - sagitta - 1e-12));
    let (before, after) = (volume(&vertices, &faces), volume(&new_vertices, &new_faces));
    assert!((after / before - 1.0).abs() < 0.01);
}

#[test]
fn sizes_grade_the_mesh() {
    let (vertices, faces) = fixtures::icosphere(5);
    let sizes: Vec<f64> = vertices.iter().map(|v| if v.z > 0.0 { 0.06 } else { 0.18 }).collect();
    let settings = RemeshParams { feature_angle_deg: 180.0, ..params(1.0) };
    let (new_vertices, _) = remesh_with_sizes(&vertices, &faces, &sizes, &settings).unwrap();
    let n_above = new_vertices.iter().filter(|v| v.z > 0.0).count();
    // Nine times as dense, less what the transition takes.
    assert!(n_above > 4 * (new_vertices.len() - n_above));
}

#[test]
fn boundary_keeps_its_outline() {
    let (vertices, faces) = fixtures::grid(4, 4);
    let span = |points: &[DVec3]| {
        let lower = points.iter().copied().reduce(DVec3::min).unwrap();
        points.iter().copied().reduce(DVec3::max).unwrap() - lower
    };
    let (new_vertices, new_faces) = remesh(&vertices, &faces, &params(0.05 * span(&vertices).x)).unwrap();
    assert_eq!(span(&new_vertices), span(&vertices));
    let area = |v: &[DVec3], f: &[Face]| f.iter().map(|face| 0.5 * cross(v, face).length()).sum::<f64>();
    assert!((area(&new_vertices, &new_faces) / area(&vertices, &faces) - 1.0).abs() < 1e-9);
}

#[test]
fn non_manifold_edge_stays_untouched() {
    let (vertices, faces) = fixtures::three_on_an_edge();
    let (new_vertices, new_faces) = remesh(&vertices, &faces, &params(0.1)).unwrap();
    let id = |v: u32| new_vertices.iter().position(|p| *p == vertices[v as usize]).unwrap() as u32;
    let shared = *directed_edges(&faces)
        .keys()
        .find(|(a, b)| faces.iter().filter(|f| f.contains(a) && f.contains(b)).count() == 3)
        .unwrap();
    let (a, b) = (id(shared.0), id(shared.1));
    assert_eq!(new_faces.iter().filter(|f| f.contains(&a) && f.contains(&b)).count(), 3);
}

#[test]
fn odd_meshes_pass_through() {
    for (vertices, faces) in [
        fixtures::two_triangles(),
        fixtures::tetrahedron(),
        fixtures::open_fan(),
        fixtures::moebius(),
        fixtures::hourglass(),
    ] {
        for target in [0.07, 0.5, 10.0] {
            let (new_vertices, new_faces) = remesh(&vertices, &faces, &params(target)).unwrap();
            assert!(!new_faces.is_empty());
            assert!(new_faces.iter().flatten().all(|&v| (v as usize) < new_vertices.len()));
            assert!(new_vertices.iter().all(|v| v.is_finite()));
        }
    }
}

#[test]
fn repeated_vertices_in_a_face_are_dropped() {
    let (vertices, mut faces) = unit_cube();
    faces.push([0, 0, 1]);
    let (new_vertices, new_faces) = remesh(&vertices, &faces, &params(0.3)).unwrap();
    assert_eq!(euler_characteristic(new_vertices.len(), &new_faces), 2);
}

#[test]
fn no_iterations_return_the_input() {
    let (vertices, faces) = unit_cube();
    let settings = RemeshParams { iterations: 0, ..params(0.1) };
    assert_eq!(remesh(&vertices, &faces, &settings).unwrap(), (vertices, faces));
}

#[test]
fn same_input_gives_the_same_mesh() {
    let (vertices, faces) = fixtures::icosphere(3);
    assert_eq!(remesh(&vertices, &faces, &params(0.1)), remesh(&vertices, &faces, &params(0.1)));
}

#[test]
fn bad_parameters_are_refused() {
    let (vertices, faces) = unit_cube();
    for length in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = remesh(&vertices, &faces, &params(length)).unwrap_err();
        assert!(matches!(error, GeomError::InvalidParameter { name: "target_edge_length", .. }), "{error}");
    }
    let settings = RemeshParams { feature_angle_deg: 181.0, ..params(0.1) };
    let error = remesh(&vertices, &faces, &settings).unwrap_err();
    assert!(matches!(error, GeomError::InvalidParameter { name: "feature_angle_deg", .. }), "{error}");
    let error = remesh(&vertices, &faces, &params(1e-6)).unwrap_err();
    assert!(matches!(error, GeomError::TooLarge { what: "faces", .. }), "{error}");
    let error = remesh_with_sizes(&vertices, &faces, &[0.1], &params(0.1)).unwrap_err();
    assert!(matches!(error, GeomError::LengthMismatch { what: "sizes", expected: 8, got: 1 }), "{error}");
    assert_eq!(remesh(&vertices, &[], &params(0.1)), Err(GeomError::EmptyMesh));
}
