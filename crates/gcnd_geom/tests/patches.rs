//! Properties of patch extraction, against brute force and under changes that must not matter.

#[path = "patches/examples.rs"]
mod examples;
#[path = "patches/guards.rs"]
mod guards;
#[path = "patches/support.rs"]
mod support;

use gcnd_geom::face_geometry::FaceGeometry;
use gcnd_geom::patch::*;
use gcnd_geom::{DMat3, DVec3, Face, Topology};
use proptest::prelude::*;
use std::collections::BTreeSet;
use support::{Mesh, bumpy_sphere, extract, extract_all};

/// Any faces over any vertices: non-manifold, repeated, degenerate, disconnected.
fn soup() -> impl Strategy<Value = Mesh> {
    (3usize..40).prop_flat_map(|n_vertices| {
        let coordinate = prop_oneof![3 => -1.0..1.0f64, 1 => (-2..3i32).prop_map(f64::from)];
        let vertices =
            prop::collection::vec(prop::array::uniform3(coordinate).prop_map(DVec3::from), n_vertices);
        let faces = prop::collection::vec(prop::array::uniform3(0..n_vertices as u32), 1..60);
        (vertices, faces)
    })
}

fn budget() -> impl Strategy<Value = Budget> {
    prop_oneof![Just(Budget::NearestFirst), any::<u64>().prop_map(|seed| Budget::Random { seed })]
}

fn params() -> impl Strategy<Value = PatchParams> {
    let region = prop_oneof![Just(VotingRegion::Patch), Just(VotingRegion::TwoRing)];
    (2.0..10.0f64, 16usize..80, budget(), region, 0.05..3.0f64, any::<[bool; 4]>()).prop_map(
        |(patch_scale, n_nodes, budget, voting_region, sigma_vote, flags)| {
            let [vertex_offsets, scale_space, first_normals, is_one] = flags;
            PatchParams {
                patch_scale,
                sheets: if is_one { Sheets::One } else { Sheets::All },
                n_nodes,
                budget,
                voting_region,
                sigma_vote,
                vertex_offsets,
                scale_space,
                first_normals,
                roughness: scale_space.then_some([0.0, 1e-3, 0.02, 7.0]),
            }
        },
    )
}

fn rotation() -> impl Strategy<Value = DMat3> {
    (prop::array::uniform3(-1.0..1.0f64), 0.0..std::f64::consts::TAU)
        .prop_filter_map("an axis has a length", |(axis, angle)| {
            DVec3::from(axis).try_normalize().map(|axis| DMat3::from_axis_angle(axis, angle))
        })
}

/// Eq. 1's faces without the parts that the centre does not reach over shared vertices and that face away from it, more
/// than a tenth of their area; nothing where an angle is too close to 120°, or a share to that, to tell.
fn of_one_sheet((vertices, faces): &Mesh, center_id: usize, inside: &BTreeSet<u32>) -> Option<BTreeSet<u32>> {
    let geometry = FaceGeometry::compute(vertices, faces);
    let mean = |of: &BTreeSet<u32>| -> DVec3 {
        of.iter().map(|&f| geometry.normals[f as usize] * geometry.areas[f as usize]).sum()
    };
    let touching = |of: &BTreeSet<u32>, from: &BTreeSet<u32>| -> BTreeSet<u32> {
        let corners: BTreeSet<u32> = of.iter().flat_map(|&f| faces[f as usize]).collect();
        from.iter().copied().filter(|&f| faces[f as usize].iter().any(|v| corners.contains(v))).collect()
    };
    let every: BTreeSet<u32> = (0..faces.len() as u32).collect();
    let center = BTreeSet::from([center_id as u32]);
    let own_normal = mean(&touching(&touching(&center, &every), &every));
    let cosine = |n: DVec3| n.normalize_or_zero().dot(own_normal.normalize_or_zero());
    let alone = |f: &u32| cosine(geometry.normals[*f as usize]);
    if inside.iter().any(|f| (alone(f) + 0.5).abs() < 1e-9) {
        return None;
    }
    if inside.iter().all(|f| alone(f) > -0.5) {
        return Some(inside.clone());
    }
    let (mut left, mut kept) = (inside.clone(), BTreeSet::new());
    let mut start = center_id as u32;
    loop {
        let mut part = BTreeSet::from([start]);
        loop {
            let grown = touching(&part, &left);
            if grown.len() == part.len() {
                break;
            }
            part = grown;
        }
        left = left.difference(&part).copied().collect();
        let of_part = cosine(mean(&part));
        let area: f64 = part.iter().map(|&f| geometry.areas[f as usize]).sum();
        let facing = mean(&part).length() / area;
        if (of_part + 0.5).abs() < 1e-9 || (facing - 0.1).abs() < 1e-9 {
            return None;
        }
        if start == center_id as u32 || of_part > -0.5 || facing < 0.1 {
            kept.append(&mut part);
        }
        match left.first() {
            Some(&next) => start = next,
            None => return Some(kept),
        }
    }
}

/// Eq. 1 word by word: (faces with a vertex strictly inside, and the centre), r.
fn select_by_the_text((vertices, faces): &Mesh, center_id: usize, patch_scale: f64) -> (BTreeSet<u32>, f64) {
    let geometry = FaceGeometry::compute(vertices, faces);
    let mut ring = BTreeSet::from([center_id]);
    for _ in 0..2 {
        let touched: BTreeSet<u32> = ring.iter().flat_map(|&face_id| faces[face_id]).collect();
        ring = (0..faces.len()).filter(|&f| faces[f].iter().any(|v| touched.contains(v))).collect();
    }
    let mean_area = ring.iter().map(|&f| geometry.areas[f]).sum::<f64>() / ring.len() as f64;
    let radius = patch_scale * mean_area.sqrt();
    let center = geometry.centroids[center_id];
    let is_inside = |face: &Face| face.iter().any(|&v| vertices[v as usize].distance(center) < radius);
    let inside = (0..faces.len()).filter(|&f| f == center_id || is_inside(&faces[f]));
    (inside.map(|f| f as u32).collect(), radius)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn selection_equals_brute_force(mesh in soup(), patch_scale in 2.0..10.0f64) {
        let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid mesh");
        let params = PatchParams { patch_scale, ..PatchParams::default() };
        let extractor = PatchExtractor::new(&topology, &mesh.0, params).expect("valid mesh");
        let centroids = &extractor.geometry().centroids;
        for face_id in 0..mesh.1.len() {
            let (selected, radius) = extractor.select(face_id as u32).expect("valid id");
            let (expected, expected_radius) = select_by_the_text(&mesh, face_id, patch_scale);
            if expected_radius > 0.0 {
                prop_assert!((radius - expected_radius).abs() <= 1e-14 * expected_radius);
                prop_assert_eq!(selected.iter().copied().collect::<BTreeSet<_>>(), expected);
            } else {
                prop_assert_eq!((&selected[..], radius), (&[face_id as u32][..], 1.0));
            }
            prop_assert_eq!(selected[0], face_id as u32);
            let key = |f: u32| centroids[f as usize].distance_squared(centroids[face_id]);
            for pair in selected[1..].windows(2) {
                prop_assert!((key(pair[0]), pair[0]) < (key(pair[1]), pair[1]));
            }
        }
    }

    #[test]
    fn one_sheet_equals_brute_force(mesh in soup(), patch_scale in 2.0..10.0f64) {
        let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid mesh");
        let params = PatchParams { patch_scale, sheets: Sheets::One, ..PatchParams::default() };
        let extractor = PatchExtractor::new(&topology, &mesh.0, params).expect("valid mesh");
        for face_id in 0..mesh.1.len() {
            let selected = extractor.select(face_id as u32).expect("valid id").0;
            let (inside, radius) = select_by_the_text(&mesh, face_id, patch_scale);
            prop_assert_eq!(selected[0], face_id as u32);
            let expected = of_one_sheet(&mesh, face_id, &inside);
            if let Some(expected) = expected.filter(|_| radius > 0.0) {
                prop_assert_eq!(selected.iter().copied().collect::<BTreeSet<_>>(), expected);
            }
        }
    }

    #[test]
    fn any_mesh_gives_a_well_formed_graph(mesh in soup(), params in params()) {
        let patches = extract_all(&mesh, params);
        prop_assert!(patches.is_finite());
        let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid mesh");
        let extractor = PatchExtractor::new(&topology, &mesh.0, params).expect("valid mesh");
        for patch in 0..mesh.1.len() {
            let (selected, radius) = extractor.select(patch as u32).expect("valid id");
            let n_real = selected.len().min(params.n_nodes);
            let face_ids = patches.face_ids(patch);
            prop_assert_eq!(patches.radii[patch], radius);
            prop_assert_eq!(face_ids[0], patch as u32, "node 0 is the centre");
            prop_assert!(patches.mask(patch).iter().enumerate().all(|(i, &m)| m == u8::from(i < n_real)));
            let real: BTreeSet<u32> = face_ids[..n_real].iter().copied().collect();
            prop_assert_eq!(real.len(), n_real, "real nodes are distinct faces");
            prop_assert!(real.iter().all(|face_id| selected.contains(face_id)));
            if params.budget == Budget::NearestFirst {
                prop_assert!((0..params.n_nodes).all(|node| face_ids[node] == selected[node % n_real]));
            }
            for node in 0..params.n_nodes {
                let original = face_ids.iter().position(|&f| f == face_ids[node]).expect("present");
                prop_assert!(original < n_real, "a repeat copies a real node");
                prop_assert_eq!(patches.features(patch, node), patches.features(patch, original));
                prop_assert_eq!(patches.neighbors(patch, node), patches.neighbors(patch, original));
            }
            let frame = patches.frame(patch);
            prop_assert!((frame.determinant() - 1.0).abs() < 1e-12);
            let unit = frame.transpose() * frame;
            prop_assert!(unit.abs_diff_eq(DMat3::IDENTITY, 1e-12));
        }
    }

    #[test]
    fn neighbors_equal_brute_force(mesh in soup(), params in params()) {
        let patches = extract_all(&mesh, params);
        let edges = |f: u32| {
            let [a, b, c] = mesh.1[f as usize];
            [(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q))).into_iter().filter(|(p, q)| p != q)
        };
        for patch in 0..mesh.1.len() {
            let n_real = patches.mask(patch).iter().filter(|&&m| m == 1).count();
            let nodes = &patches.face_ids(patch)[..n_real];
            for (node, &face_id) in nodes.iter().enumerate() {
                let own: BTreeSet<_> = edges(face_id).collect();
                let adjacent: BTreeSet<usize> = (0..n_real)
                    .filter(|&other| other != node && edges(nodes[other]).any(|e| own.contains(&e)))
                    .collect();
                let got = patches.neighbors(patch, node);
                let linked: BTreeSet<usize> = got.iter().map(|&n| n as usize).filter(|&n| n != node).collect();
                prop_assert_eq!(linked.len(), adjacent.len().min(3), "{:?} {:?}", got, adjacent);
                prop_assert!(linked.is_subset(&adjacent));
                let n_self = got.iter().filter(|&&n| n as usize == node).count();
                prop_assert_eq!(n_self, 3 - linked.len(), "free places point to the node itself");
            }
        }
    }

    #[test]
    fn features_do_not_depend_on_position_scale_or_naming(
        seed in 0..1000u64, turn in rotation(), shift in prop::array::uniform3(-5.0..5.0f64),
        exponent in -6..7i32, shuffle_seed in any::<u64>(), region in 0..2usize,
    ) {
        let mesh = bumpy_sphere(seed);
        let n_faces = mesh.1.len();
        let voting_region = [VotingRegion::Patch, VotingRegion::TwoRing][region];
        let params = PatchParams { voting_region, ..PatchParams::default() };
        let base = extract_all(&mesh, params);
        let scale = 10f64.powi(exponent);
        let moved_vertices = mesh.0.iter().map(|&v| scale * (turn * v + DVec3::from(shift))).collect();
        // Face i of the original becomes face new_id[i], named from another of its vertices.
        let mut old_id: Vec<usize> = (0..n_faces).collect();
        old_id.sort_by_key(|&i| (i as u64 ^ shuffle_seed).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let mut new_id = vec![0u32; n_faces];
        old_id.iter().enumerate().for_each(|(new, &old)| new_id[old] = new as u32);
        let renamed = old_id.iter().map(|&i| { let mut f = mesh.1[i]; f.rotate_left(i % 3); f }).collect();
        let moved = extract(&(moved_vertices, renamed), &new_id, params);
        for patch in 0..n_faces {
            let same: Vec<u32> = base.face_ids(patch).iter().map(|&f| new_id[f as usize]).collect();
            prop_assert_eq!(&same[..], moved.face_ids(patch));
            prop_assert!((moved.radii[patch] / scale - base.radii[patch]).abs() < 1e-9);
            prop_assert!(moved.frame(patch).abs_diff_eq(turn * base.frame(patch), 1e-6));
            for node in 0..params.n_nodes {
                for (x, y) in base.features(patch, node).iter().zip(moved.features(patch, node)) {
                    prop_assert!((x - y).abs() < 1e-5, "patch {} node {}: {} {}", patch, node, x, y);
                }
                let sorted = |n: &[i32]| { let mut n = n.to_vec(); n.sort_unstable(); n };
                prop_assert_eq!(sorted(base.neighbors(patch, node)), sorted(moved.neighbors(patch, node)));
            }
        }
    }

    #[test]
    fn a_patch_does_not_depend_on_its_batch(seed in 0..100u64, budget in budget(), rotate in 0..512usize) {
        let mesh = bumpy_sphere(seed);
        let params = PatchParams { n_nodes: 40, budget, ..PatchParams::default() };
        let base = extract_all(&mesh, params);
        let mut order: Vec<u32> = (0..512).rev().collect();
        order.rotate_left(rotate);
        let other = extract(&mesh, &order, params);
        for (patch, &face_id) in order.iter().enumerate() {
            prop_assert_eq!(other.face_ids(patch), base.face_ids(face_id as usize));
            prop_assert_eq!(other.features(patch, 39), base.features(face_id as usize, 39));
            prop_assert_eq!(other.frame(patch), base.frame(face_id as usize));
        }
    }
}

#[test]
fn one_thread_and_many_agree_to_the_bit() {
    let mesh = bumpy_sphere(3);
    for budget in [Budget::NearestFirst, Budget::Random { seed: 11 }] {
        let params = PatchParams { budget, ..PatchParams::default() };
        let with_threads = |n: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
            pool.install(|| {
                let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid mesh");
                let classes = classify_faces(&topology, &mesh.0, params).expect("valid mesh");
                (extract_all(&mesh, params), classes)
            })
        };
        let one = with_threads(1);
        assert!(with_threads(2) == one && with_threads(7) == one);
    }
}
