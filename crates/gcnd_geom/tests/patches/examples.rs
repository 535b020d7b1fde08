//! Patches of meshes on which every number or class is known.

use crate::support::{Mesh, Patches, bumpy_sphere, extract, extract_all};
use gcnd_geom::face_geometry::FaceGeometry;
use gcnd_geom::patch::*;
use gcnd_geom::{DMat3, DVec3, Topology, fixtures};
use std::collections::BTreeSet;

/// A right triangle with legs 3 and 6 around the origin has area 9, so r = 2 · 3 = 6 exactly; a second
/// triangle of area 9 hangs at x = `nearest`.
fn two_islands(nearest: f64) -> Mesh {
    let triangle = [DVec3::new(-1., -2., 0.), DVec3::new(2., -2., 0.), DVec3::new(-1., 4., 0.)];
    let other = [DVec3::X * nearest, DVec3::new(nearest + 3., 0., 0.), DVec3::new(nearest + 3., 6., 0.)];
    let unused = DVec3::new(0.0, 0.0, 0.5);
    ([&triangle[..], &other, &[unused]].concat(), vec![[0, 1, 2], [3, 4, 5]])
}

#[test]
fn a_vertex_at_exactly_r_is_outside() {
    let next_below = f64::from_bits(6f64.to_bits() - 1);
    for (nearest, expected) in [(6.0, vec![0]), (next_below, vec![0, 1]), (6.5, vec![0])] {
        let (vertices, faces) = two_islands(nearest);
        let topology = Topology::new(faces, vertices.len()).expect("valid mesh");
        let params = PatchParams { patch_scale: 2.0, ..PatchParams::default() };
        let extractor = PatchExtractor::new(&topology, &vertices, params).expect("valid mesh");
        assert_eq!(extractor.select(0), Ok((expected, 6.0)), "nearest vertex at {nearest}");
    }
}

#[test]
fn features_of_a_lone_triangle_by_hand() {
    // Legs 3 and 6, centroid at the origin, r = 6: the frame is e1 = z and, the other eigenvalues being equal,
    // the axes that the solver leaves: e2 = x, e3 = e1 × e2 = y.
    let (vertices, _) = two_islands(9.0);
    let mesh = (vertices[..3].to_vec(), vec![[0, 1, 2]]);
    let params = PatchParams { patch_scale: 2.0, n_nodes: 16, ..PatchParams::default() };
    let patches = extract(&mesh, &[0], params);
    assert_eq!(patches.frame(0), DMat3::from_cols(DVec3::Z, DVec3::X, DVec3::Y));
    assert_eq!(patches.world_from_patch, [0., 1., 0., 0., 0., 1., 1., 0., 0.], "rows as numpy reads them");
    let sixth = 1.0 / 6.0;
    // Vertex 0 at distance √5 is the nearest; then 1 and 2 in the face's order.
    #[rustfmt::skip]
    let expected: [f32; 17] = [
        0., 0., 0.,  1., 0., 0.,  1.,  0.,
        0., -sixth, -2. * sixth,  0., 2. * sixth, -2. * sixth,  0., -sixth, 4. * sixth,
    ];
    for (channel, (x, y)) in patches.features(0, 5).iter().zip(expected).enumerate() {
        assert!((x - y).abs() < 1e-7, "channel {channel}: {x} {y}");
    }
    assert_eq!(patches.mask(0), [[1].as_slice(), &[0; 15]].concat());
    assert_eq!(patches.neighbors, [0; 48]);
}

#[test]
fn eight_channels_are_the_first_eight_of_seventeen() {
    let mesh = bumpy_sphere(1);
    let with = extract_all(&mesh, PatchParams::default());
    let without = extract_all(&mesh, PatchParams { vertex_offsets: false, ..PatchParams::default() });
    assert_eq!((with.n_channels, without.n_channels), (17, 8));
    for node in 0..64 {
        assert_eq!(with.features(100, node)[..8], *without.features(100, node));
        let offsets = &with.features(100, node)[8..];
        let sums = [0, 1, 2].map(|axis| offsets[axis] + offsets[axis + 3] + offsets[axis + 6]);
        assert!(sums.iter().all(|s| s.abs() < 1e-6), "vertex offsets from a centroid add up to zero");
    }
    assert!(with.features.chunks(17).all(|f| f[7] == 1.0), "a closed mesh has three edge neighbours a face");
}

#[test]
fn far_away_and_tiny_meshes_keep_their_features() {
    let mesh = bumpy_sphere(5);
    let base = extract_all(&mesh, PatchParams::default());
    for (scale, offset, tolerance) in
        [(1e-6, 0.0, 1e-6), (1.0, 1e6, 1e-4), (1e-140, 0.0, 1e-6), (1e140, 0.0, 1e-6)]
    {
        let moved = mesh.0.iter().map(|&v| scale * v + DVec3::splat(offset)).collect();
        let patches = extract_all(&(moved, mesh.1.clone()), PatchParams::default());
        assert!(patches.is_finite());
        let same_nodes = patches.face_ids.iter().zip(&base.face_ids).filter(|(a, b)| a == b).count();
        assert!(same_nodes * 1000 >= base.face_ids.len() * 999, "scale {scale} offset {offset}");
        let node = |p: &Patches| p.features(17, 3).to_vec();
        for (x, y) in node(&patches).into_iter().zip(node(&base)) {
            assert!((x - y).abs() < tolerance, "scale {scale} offset {offset}: {x} {y}");
        }
    }
}

#[test]
fn degenerate_meshes_give_finite_patches() {
    let line: Vec<DVec3> = (0..6).map(|i| DVec3::X * f64::from(i)).collect();
    let (cube, cube_faces) = fixtures::cube();
    let hub = (0..400).map(|i| DVec3::new(f64::from(i).cos(), f64::from(i).sin(), 0.0));
    let meshes: Vec<(&str, Mesh)> = vec![
        ("collinear", (line.clone(), vec![[0, 1, 2], [2, 3, 4], [1, 3, 5]])),
        ("points", (vec![DVec3::ONE; 100], (0..98).map(|i| [i, i + 1, i + 2]).collect())),
        ("one vertex three times", (line, vec![[0, 0, 0]])),
        ("one face", (cube.clone(), vec![[0, 1, 2]])),
        ("repeated faces", (cube.clone(), vec![[0, 1, 2]; 40])),
        ("opposite faces", (cube.clone(), vec![[0, 1, 2], [2, 1, 0]])),
        ("far-off unused vertex", ([cube, vec![DVec3::splat(1e300)]].concat(), cube_faces)),
        ("three on an edge", fixtures::three_on_an_edge()),
        ("hourglass", fixtures::hourglass()),
        ("moebius", fixtures::moebius()),
        ("open fan", fixtures::open_fan()),
        (
            "hub",
            (std::iter::once(DVec3::ZERO).chain(hub).collect(), (1..400).map(|i| [0, i, i + 1]).collect()),
        ),
    ];
    for (name, mesh) in &meshes {
        for budget in [Budget::NearestFirst, Budget::Random { seed: 1 }] {
            for voting_region in [VotingRegion::Patch, VotingRegion::TwoRing] {
                let params = PatchParams { budget, voting_region, ..PatchParams::default() };
                let patches = extract_all(mesh, params);
                assert!(patches.is_finite(), "{name}");
                assert!(patches.face_ids.iter().all(|&f| (f as usize) < mesh.1.len()), "{name}");
                assert!(patches.features.iter().all(|x| x.abs() < 1e6), "{name}");
            }
        }
    }
    let collinear = extract_all(&meshes[0].1, PatchParams::default());
    assert_eq!(collinear.radii, [1.0; 3], "without area there is no radius");
    assert!(collinear.face_ids(2).iter().all(|&f| f == 2), "and the centre is alone");
    assert!(collinear.features.chunks(17).all(|f| f[8..] == [0.0; 9]), "with nothing to measure by");
    assert_eq!(extract_all(&meshes[4].1, PatchParams::default()).neighbors(5, 0), [1, 2, 3]);
}

#[test]
fn coordinates_whose_differences_overflow_give_finite_patches() {
    let (cube, faces) = fixtures::cube();
    for scale in [1e300, 5e307, 1.6e308] {
        let large: Vec<DVec3> = cube.iter().map(|&v| (2.0 * v - DVec3::ONE).signum() * scale).collect();
        let params = PatchParams { scale_space: true, first_normals: true, ..PatchParams::default() };
        assert!(extract_all(&(large, faces.clone()), params).is_finite(), "{scale}");
    }
}

#[test]
fn patch_normals_averaged_over_a_cover_are_the_mesh_normals() {
    let mesh = bumpy_sphere(8);
    let centers: Vec<u32> = (0..mesh.1.len() as u32).step_by(9).collect();
    let patches = extract(&mesh, &centers, PatchParams { n_nodes: 100, ..PatchParams::default() });
    let predicted: Vec<f32> = patches.features.chunks(17).flat_map(|f| [f[3], f[4], f[5]]).collect();
    let Patches { face_ids, mask, features, world_from_patch, .. } = &patches;
    let mut accumulator = NormalAccumulator::new(mesh.1.len());
    accumulator.add(face_ids, mask, &predicted, features, 17, world_from_patch).expect("valid arrays");
    let covered: BTreeSet<u32> = face_ids.iter().copied().collect();
    let weighted = (0u32..).zip(accumulator.weights()).filter(|(_, weight)| **weight > 0.0);
    assert_eq!(weighted.map(|(face_id, _)| face_id).collect::<BTreeSet<u32>>(), covered);
    let normals = FaceGeometry::compute(&mesh.0, &mesh.1).normals;
    for (normal, averaged) in normals.iter().zip(accumulator.normals(&normals).expect("valid length")) {
        assert!((*normal - averaged).length() < 1e-6);
    }
}

/// The unit cube with every side cut into 16 × 16 squares of two triangles.
fn subdivided_cube() -> Mesh {
    let (mut vertices, mut faces) = fixtures::cube();
    for _ in 0..4 {
        let midpoint = |vertices: &mut Vec<DVec3>, p: u32, q: u32| {
            let middle = (vertices[p as usize] + vertices[q as usize]) / 2.0;
            let known = vertices.iter().position(|&v| v == middle);
            known.unwrap_or_else(|| {
                vertices.push(middle);
                vertices.len() - 1
            }) as u32
        };
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| midpoint(&mut vertices, p, q));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    (vertices, faces)
}

#[test]
fn cube_faces_are_flat_edge_and_corner() {
    let (vertices, faces) = subdivided_cube();
    let topology = Topology::new(faces.clone(), vertices.len()).expect("valid mesh");
    let classes = classify_faces(&topology, &vertices, PatchParams::default()).expect("valid mesh");
    let radius = 4.0 * (0.5f64 / 256.0).sqrt();
    let mut counts = [0; 4];
    for (face, class) in faces.iter().zip(classes) {
        counts[class as usize] += 1;
        let corners = face.map(|v| vertices[v as usize]);
        let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
        // Distances to the planes of the cube; the face itself lies in one of them.
        let mut to_planes = centroid.min(1.0 - centroid).to_array();
        to_planes.sort_by(f64::total_cmp);
        let on_planes = |v: &DVec3| v.to_array().iter().filter(|&&x| x == 0.0 || x == 1.0).count();
        let on_an_edge = corners.iter().filter(|v| on_planes(v) >= 2).count();
        // No vertex of a face that the patch holds is farther away than r and the face's longest edge.
        let is_clear_of = |distance: f64| distance > radius + 2f64.sqrt() / 16.0;
        if is_clear_of(to_planes[1]) {
            assert_eq!(class, FaceClass::Flat, "{centroid}");
        } else if is_clear_of(to_planes[2]) {
            assert_ne!(class, FaceClass::Corner, "{centroid}");
        }
        if on_an_edge == 3 {
            assert_eq!(class, FaceClass::Corner, "{centroid}");
        } else if on_an_edge == 2 && is_clear_of(to_planes[2]) {
            assert_eq!(class, FaceClass::Edge, "{centroid}");
        }
    }
    assert!(counts[FaceClass::Flat as usize] == 1200 && counts[FaceClass::Corner as usize] == 84);
}
