//! Properties of remeshing on random boxes, spheres and triangle soups.

use std::collections::HashMap;

use gcnd_geom::remesh::{RemeshParams, remesh, remesh_with_sizes};
use gcnd_geom::{DMat3, DVec3, Face, GeomError, fixtures};
use proptest::prelude::*;

fn directed_edges(faces: &[Face]) -> HashMap<(u32, u32), usize> {
    let mut count = HashMap::new();
    for face in faces {
        for i in 0..3 {
            *count.entry((face[i], face[(i + 1) % 3])).or_insert(0) += 1;
        }
    }
    count
}

/// Every edge has one face on each side.
fn is_closed_and_oriented(faces: &[Face]) -> bool {
    let edges = directed_edges(faces);
    edges.iter().all(|(&(a, b), &n)| n == 1 && edges.get(&(b, a)) == Some(&1))
}

fn euler_characteristic(n_vertices: usize, faces: &[Face]) -> i64 {
    n_vertices as i64 - directed_edges(faces).len() as i64 / 2 + faces.len() as i64
}

fn cross(vertices: &[DVec3], face: &Face) -> DVec3 {
    let [a, b, c] = face.map(|v| vertices[v as usize]);
    (b - a).cross(c - a)
}

fn volume(vertices: &[DVec3], faces: &[Face]) -> f64 {
    faces.iter().map(|face| vertices[face[0] as usize].dot(cross(vertices, face)) / 6.0).sum()
}

fn turn(angles: [f64; 3]) -> DMat3 {
    DMat3::from_rotation_x(angles[0]) * DMat3::from_rotation_y(angles[1]) * DMat3::from_rotation_z(angles[2])
}

/// Coordinates that meet each other often, and a few that overflow or underflow when squared.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -1.0f64..1.0,
        4 => Just(0.0),
        2 => Just(1.0),
        1 => Just(1e-300),
        1 => Just(1e-9),
        1 => prop_oneof![9 => Just(0.5), 1 => Just(1e200)],
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn turned_boxes_stay_boxes(
        size in prop::array::uniform3(0.3f64..2.0),
        angles in prop::array::uniform3(-3.0f64..3.0),
        target in 0.08f64..0.6,
    ) {
        let (cube, faces) = fixtures::cube();
        let world_from_box = turn(angles);
        let vertices: Vec<DVec3> = cube.iter().map(|v| world_from_box * (*v * DVec3::from(size))).collect();
        let params = RemeshParams { target_edge_length: target, ..RemeshParams::default() };
        let (new_vertices, new_faces) = remesh(&vertices, &faces, &params).unwrap();
        prop_assert!(is_closed_and_oriented(&new_faces));
        prop_assert_eq!(euler_characteristic(new_vertices.len(), &new_faces), 2);
        prop_assert!(vertices.iter().all(|corner| new_vertices.contains(corner)));
        let (before, after) = (volume(&vertices, &faces), volume(&new_vertices, &new_faces));
        prop_assert!((after / before - 1.0).abs() < 1e-6);
        for face in &new_faces {
            // No face is turned over or bridges an edge of the box.
            let normal = world_from_box.transpose() * cross(&new_vertices, face).normalize();
            prop_assert!(normal.abs().max_element() > 1.0 - 1e-6, "{}", normal);
        }
    }

    #[test]
    fn bumpy_spheres_keep_genus_and_volume(
        bump in 0.0f64..0.15,
        waves in prop::array::uniform3(1.0f64..5.0),
        target in 0.06f64..0.12,
        grading in 1.0f64..1.8,
        iterations in 1usize..8,
    ) {
        let (sphere, faces) = fixtures::icosphere(4);
        let vertices: Vec<DVec3> = sphere
            .iter()
            .map(|v| *v * (1.0 + bump * (v.x * waves[0]).sin() * (v.y * waves[1]).cos() * (v.z * waves[2]).cos()))
            .collect();
        let sizes: Vec<f64> = sphere.iter().map(|v| target * grading.powf(v.z)).collect();
        let params = RemeshParams { target_edge_length: target, feature_angle_deg: 180.0, iterations };
        let (new_vertices, new_faces) = remesh_with_sizes(&vertices, &faces, &sizes, &params).unwrap();
        prop_assert!(is_closed_and_oriented(&new_faces));
        prop_assert_eq!(euler_characteristic(new_vertices.len(), &new_faces), 2);
        let (before, after) = (volume(&vertices, &faces), volume(&new_vertices, &new_faces));
        // Chords under arcs: larger triangles lose a little volume.
        prop_assert!((after / before - 1.0).abs() < 0.02, "{} {}", before, after);
        // The body is star-shaped around the origin, so a turned-over face looks at it.
        for face in &new_faces {
            prop_assert!(cross(&new_vertices, face).dot(new_vertices[face[0] as usize]) > 0.0);
        }
    }

    #[test]
    fn triangle_soup_never_panics(
        points in prop::collection::vec(prop::array::uniform3(coordinate()), 3..12),
        picks in prop::collection::vec(prop::array::uniform3(0usize..12), 1..24),
        flatten in any::<bool>(),
        target in 0.1f64..1.0,
        angle in 0.0f64..180.0,
    ) {
        let vertices: Vec<DVec3> =
            points.iter().map(|p| DVec3::new(p[0], p[1], if flatten { 0.0 } else { p[2] })).collect();
        let faces: Vec<Face> = picks.iter().map(|face| face.map(|v| (v % vertices.len()) as u32)).collect();
        let params = RemeshParams { target_edge_length: target, feature_angle_deg: angle, iterations: 3 };
        let (new_vertices, new_faces) = match remesh(&vertices, &faces, &params) {
            Ok(mesh) => mesh,
            Err(error) => {
                prop_assert!(matches!(error, GeomError::TooLarge { .. }), "{}", error);
                return Ok(());
            }
        };
        prop_assert!(new_vertices.iter().all(|v| v.is_finite()));
        prop_assert!(new_faces.iter().flatten().all(|&v| (v as usize) < new_vertices.len()));
        // Edges of more than two faces are those that the input had, untouched.
        let undirected = |faces: &[Face]| {
            let mut count: HashMap<(u32, u32), usize> = HashMap::new();
            for ((a, b), n) in directed_edges(faces) {
                *count.entry((a.min(b), a.max(b))).or_insert(0) += n;
            }
            count.into_values().filter(|n| *n > 2).count()
        };
        let proper: Vec<Face> =
            faces.iter().copied().filter(|f| f[0] != f[1] && f[1] != f[2] && f[2] != f[0]).collect();
        prop_assert!(undirected(&new_faces) <= undirected(&proper));
    }
}
