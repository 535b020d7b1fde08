//! Every guard, tripped.

use crate::support::{Patches, extract_all};
use gcnd_geom::patch::*;
use gcnd_geom::{DVec3, GeomError, Topology, fixtures};

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
    type Shorten = fn(&mut Patches);
    let shorten: [(&str, Shorten); 6] = [
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
