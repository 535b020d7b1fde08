//! Properties of patch extraction, against brute force and under changes that must not matter.

use gcnd_geom::face_geometry::FaceGeometry;
use gcnd_geom::patch::*;
use gcnd_geom::{DMat3, DVec3, Face, GeomError, Topology, fixtures};
use proptest::prelude::*;
use std::collections::BTreeSet;

type Mesh = (Vec<DVec3>, Vec<Face>);

/// The arrays of some patches.
#[derive(Debug, Clone, PartialEq)]
struct Patches {
    n_nodes: usize,
    n_channels: usize,
    features: Vec<f32>,
    neighbors: Vec<i32>,
    face_ids: Vec<u32>,
    mask: Vec<u8>,
    world_from_patch: Vec<f64>,
    radii: Vec<f64>,
}

impl Patches {
    fn empty(n_patches: usize, params: &PatchParams) -> Self {
        let (n_nodes, n_channels) = (params.n_nodes, params.n_channels());
        let n = n_patches * n_nodes;
        Self {
            n_nodes,
            n_channels,
            // Values that a forgotten write would leave behind.
            features: vec![f32::NAN; n * n_channels],
            neighbors: vec![-1; n * 3],
            face_ids: vec![u32::MAX; n],
            mask: vec![7; n],
            world_from_patch: vec![f64::NAN; n_patches * 9],
            radii: vec![f64::NAN; n_patches],
        }
    }

    fn buffers(&mut self) -> PatchBuffers<'_> {
        PatchBuffers {
            features: &mut self.features,
            neighbors: &mut self.neighbors,
            face_ids: &mut self.face_ids,
            mask: &mut self.mask,
            world_from_patch: &mut self.world_from_patch,
            radii: &mut self.radii,
        }
    }

    fn face_ids(&self, patch: usize) -> &[u32] {
        &self.face_ids[patch * self.n_nodes..(patch + 1) * self.n_nodes]
    }

    fn mask(&self, patch: usize) -> &[u8] {
        &self.mask[patch * self.n_nodes..(patch + 1) * self.n_nodes]
    }

    fn neighbors(&self, patch: usize, node: usize) -> &[i32] {
        let start = (patch * self.n_nodes + node) * 3;
        &self.neighbors[start..start + 3]
    }

    fn features(&self, patch: usize, node: usize) -> &[f32] {
        let start = (patch * self.n_nodes + node) * self.n_channels;
        &self.features[start..start + self.n_channels]
    }

    fn frame(&self, patch: usize) -> DMat3 {
        DMat3::from_cols_slice(&self.world_from_patch[patch * 9..patch * 9 + 9]).transpose()
    }

    fn is_finite(&self) -> bool {
        self.features.iter().all(|x| x.is_finite())
            && self.world_from_patch.iter().chain(&self.radii).all(|x| x.is_finite())
    }
}

fn extract(mesh: &Mesh, face_ids: &[u32], params: PatchParams) -> Patches {
    let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid mesh");
    let extractor = PatchExtractor::new(&topology, &mesh.0, params).expect("valid mesh");
    let mut patches = Patches::empty(face_ids.len(), &params);
    extractor.extract(face_ids, patches.buffers()).expect("valid face ids");
    patches
}

fn extract_all(mesh: &Mesh, params: PatchParams) -> Patches {
    extract(mesh, &(0..mesh.1.len() as u32).collect::<Vec<_>>(), params)
}

/// A closed surface without symmetry, 512 faces.
fn bumpy_sphere(seed: u64) -> Mesh {
    let (mut vertices, faces) = fixtures::icosphere(3);
    fixtures::jitter(&mut vertices, 0.03, seed);
    for v in &mut vertices {
        *v *= 1.0 + 0.1 * (3.0 * v.x + 1.0).sin() + 0.07 * (4.0 * v.y - 2.0 * v.z + seed as f64).cos();
    }
    (vertices, faces)
}

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
    (2.0..10.0f64, 16usize..80, budget(), region, 0.05..3.0f64, any::<bool>()).prop_map(
        |(patch_scale, n_nodes, budget, voting_region, sigma_vote, vertex_offsets)| PatchParams {
            patch_scale,
            n_nodes,
            budget,
            voting_region,
            sigma_vote,
            vertex_offsets,
        },
    )
}

fn rotation() -> impl Strategy<Value = DMat3> {
    (prop::array::uniform3(-1.0..1.0f64), 0.0..6.28f64)
        .prop_filter_map("an axis has a length", |(axis, angle)| {
            DVec3::from(axis).try_normalize().map(|axis| DMat3::from_axis_angle(axis, angle))
        })
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
fn patch_normals_averaged_over_a_cover_are_the_mesh_normals() {
    let mesh = bumpy_sphere(8);
    let centers = cover_centers(mesh.1.len(), 0.2, 4);
    let patches = extract(&mesh, &centers, PatchParams { n_nodes: 100, ..PatchParams::default() });
    let predicted: Vec<f32> = patches.features.chunks(17).flat_map(|f| [f[3], f[4], f[5]]).collect();
    let Patches { face_ids, mask, features, world_from_patch, .. } = &patches;
    let mut accumulator = NormalAccumulator::new(mesh.1.len());
    accumulator.add(face_ids, mask, &predicted, features, 17, world_from_patch).expect("valid arrays");
    let covered: BTreeSet<u32> = face_ids.iter().copied().collect();
    let expected: Vec<u32> = (0..mesh.1.len() as u32).filter(|f| !covered.contains(f)).collect();
    assert_eq!(accumulator.uncovered(), expected);
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

#[test]
fn every_parameter_guard_trips() {
    let ok = PatchParams::default();
    let cases = [
        (PatchParams { patch_scale: 1.99, ..ok }, "patch_scale"),
        (PatchParams { patch_scale: 10.01, ..ok }, "patch_scale"),
        (PatchParams { patch_scale: f64::NAN, ..ok }, "patch_scale"),
        (PatchParams { n_nodes: 15, ..ok }, "n_nodes"),
        (PatchParams { n_nodes: 513, ..ok }, "n_nodes"),
        (PatchParams { sigma_vote: 0.0, ..ok }, "sigma_vote"),
        (PatchParams { sigma_vote: -1.0, ..ok }, "sigma_vote"),
        (PatchParams { sigma_vote: f64::INFINITY, ..ok }, "sigma_vote"),
        (PatchParams { sigma_vote: f64::NAN, ..ok }, "sigma_vote"),
    ];
    let (vertices, faces) = fixtures::cube();
    let topology = Topology::new(faces, vertices.len()).expect("valid mesh");
    for (params, expected) in cases {
        let is_expected =
            |e: GeomError| matches!(e, GeomError::InvalidParameter { name, .. } if name == expected);
        assert!(params.validate().is_err_and(is_expected), "{params:?}");
        assert!(PatchExtractor::new(&topology, &vertices, params).is_err_and(is_expected));
        assert!(classify_faces(&topology, &vertices, params).is_err_and(is_expected));
    }
    for params in [
        PatchParams { patch_scale: 2.0, n_nodes: 16, sigma_vote: 1e-300, ..ok },
        PatchParams { patch_scale: 10.0, n_nodes: 512, sigma_vote: 1e300, ..ok },
    ] {
        assert!(extract_all(&(vertices.clone(), topology.faces().to_vec()), params).is_finite());
    }
}

#[test]
fn mesh_and_buffer_guards_trip() {
    let params = PatchParams::default();
    let (vertices, faces) = fixtures::cube();
    let topology = Topology::new(faces, vertices.len()).expect("valid mesh");
    let none = Topology::new(vec![], 8).expect("valid mesh");
    let refused = |topology: &Topology, vertices: &[DVec3]| {
        PatchExtractor::new(topology, vertices, params).map(|_| ()).expect_err("refused")
    };
    assert_eq!(refused(&none, &vertices), GeomError::EmptyMesh);
    assert_eq!(
        refused(&topology, &vertices[..7]),
        GeomError::LengthMismatch { what: "vertices", expected: 8, got: 7 }
    );
    let mut broken = vertices.clone();
    broken[4].y = f64::NAN;
    assert_eq!(refused(&topology, &broken), GeomError::NonFiniteVertex { vertex_id: 4 });

    let extractor = PatchExtractor::new(&topology, &vertices, params).expect("valid mesh");
    let shorten: [(&str, fn(&mut Patches)); 6] = [
        ("features", |p| p.features.truncate(5)),
        ("neighbors", |p| p.neighbors.truncate(5)),
        ("face_ids", |p| p.face_ids.truncate(5)),
        ("mask", |p| p.mask.truncate(5)),
        ("world_from_patch", |p| p.world_from_patch.truncate(5)),
        ("radii", |p| p.radii.push(0.0)),
    ];
    for (array, shorten) in shorten {
        let mut patches = Patches::empty(2, &params);
        shorten(&mut patches);
        let error = extractor.extract(&[0, 1], patches.buffers()).expect_err("refused");
        assert!(matches!(error, GeomError::LengthMismatch { what, .. } if what == array), "{error}");
    }
    let mut patches = Patches::empty(2, &params);
    let error = extractor.extract(&[0, 12], patches.buffers()).expect_err("refused");
    assert!(matches!(&error, GeomError::InvalidParameter { name: "face_ids", value, .. } if value == "12"));
    assert!(extractor.select(12).is_err());
    assert!(patches.mask.iter().all(|&m| m == 7), "an error leaves the arrays as they were");
    assert_eq!(extractor.extract(&[], Patches::empty(0, &params).buffers()), Ok(()));
}
