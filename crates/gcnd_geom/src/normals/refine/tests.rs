use super::*;
use crate::face_geometry::FaceGeometry;
use crate::fixtures;
use crate::mesh::Face;
use crate::normals::neighborhood::NeighborScratch;

fn params(iterations: usize, neighborhood: Neighborhood) -> RefineParams {
    RefineParams { iterations, neighborhood, ..RefineParams::default() }
}

fn refined(mesh: &(Vec<DVec3>, Vec<Face>), normals: &[DVec3], params: &RefineParams) -> Result<Vec<DVec3>> {
    refine_normals(
        &Topology::new(mesh.1.clone(), mesh.0.len())?,
        &mesh.0,
        normals,
        params,
        &mut Watch::silent(),
    )
}

/// Ω of one face under a neighbourhood, without the face.
fn neighborhood_of(mesh: &(Vec<DVec3>, Vec<Face>), face_id: usize, neighborhood: Neighborhood) -> Vec<u32> {
    let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid");
    let filter = Filter::new(&topology, &mesh.0, &params(1, neighborhood), OwnNormal::Counts).expect("valid");
    filter.neighbors().of(face_id, &mut NeighborScratch::default()).to_vec()
}

#[test]
fn two_faces_by_hand() {
    // Equal areas; the only centroid distance is sigma_s, so W_s = exp(-1/2).
    let mesh = fixtures::two_triangles();
    let mut mesh = (mesh.0, mesh.1);
    mesh.0[3] = DVec3::new(1.0, 1.0, 0.0);
    let normals = [DVec3::Z, DVec3::new(0.6, 0.0, 0.8)];
    let weight = (-0.5f64).exp() * (-0.5 * (0.36 + 0.04) / 0.09f64).exp();
    let expected = (normals[0] + weight * normals[1]).normalize();
    for neighborhood in [Neighborhood::SharedVertex, Neighborhood::SharedEdge] {
        let result = refined(&mesh, &normals, &params(1, neighborhood)).expect("valid");
        assert!(result[0].distance(expected) < 1e-15, "{} {expected}", result[0]);
    }
}

#[test]
fn areas_weigh_the_sum() {
    // Face 1 is three times face 0; sigmas so wide that W_s = W_r = 1 to 1e-12.
    let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(2.0, 2.0, 0.0)];
    let mesh = (vertices, vec![[0, 1, 2], [2, 1, 3]]);
    let normals = [DVec3::Z, DVec3::X];
    let wide = RefineParams { sigma_s: Some(1e7), sigma_r: 1e7, ..RefineParams::default() };
    let result = refined(&mesh, &normals, &wide).expect("valid");
    assert!(result[0].distance(DVec3::new(3.0, 0.0, 1.0).normalize()) < 1e-12);
}

#[test]
fn an_unknown_normal_becomes_the_mean_of_its_neighbours() {
    let mesh = fixtures::grid(3, 3);
    let mut normals = vec![DVec3::Y; mesh.1.len()];
    normals[8] = DVec3::ZERO;
    let result = refined(&mesh, &normals, &params(1, Neighborhood::SharedEdge)).expect("valid");
    assert_eq!(result, vec![DVec3::Y; mesh.1.len()]);
}

#[test]
fn where_nothing_is_known_normals_stay_zero() {
    let mesh = fixtures::grid(3, 3);
    let zero = vec![DVec3::ZERO; mesh.1.len()];
    assert_eq!(refined(&mesh, &zero, &params(3, Neighborhood::SharedVertex)).expect("valid"), zero);
}

#[test]
fn radius_growth_stays_on_the_sheet() {
    // Two parallel sheets 0.01 apart: the other sheet is near but not connected.
    let (mut vertices, mut faces) = fixtures::grid(6, 6);
    let n = vertices.len() as u32;
    vertices.extend(vertices.clone().iter().map(|v| *v + DVec3::Z * 0.01));
    faces.extend(faces.clone().iter().map(|f| f.map(|v| v + n)));
    let sheet = faces.len() as u32 / 2;
    let mesh = (vertices, faces);
    let near = neighborhood_of(&mesh, 30, Neighborhood::Radius { multiple: 3.0 });
    assert!(near.len() > 12 && near.iter().all(|&f| f < sheet && f != 30));
    let geometry = FaceGeometry::compute(&mesh.0, &mesh.1);
    let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid");
    let radius = 3.0 * geometry.mean_centroid_distance(&topology).expect("same mesh");
    let center = geometry.centroids[30];
    let brute: Vec<u32> = (0..sheet)
        .filter(|&f| f != 30 && geometry.centroids[f as usize].distance(center) <= radius)
        .collect();
    assert_eq!(near, brute);
}

#[test]
fn neighbourhoods_of_an_interior_grid_face() {
    let mesh = fixtures::grid(6, 6);
    assert_eq!(neighborhood_of(&mesh, 30, Neighborhood::SharedVertex).len(), 12);
    assert_eq!(neighborhood_of(&mesh, 30, Neighborhood::SharedEdge).len(), 3);
}

#[test]
fn stored_and_recomputed_rows_agree_to_the_bit() {
    let (mut vertices, faces) = fixtures::icosphere(5);
    let normals = FaceGeometry::compute(&vertices, &faces).normals;
    fixtures::jitter(&mut vertices, 0.02, 5);
    let mesh = (vertices, faces);
    assert!(mesh.1.len() > CHUNK, "more than one chunk");
    for neighborhood in [Neighborhood::SharedVertex, Neighborhood::Radius { multiple: 2.0 }] {
        let at_once = refined(&mesh, &normals, &params(3, neighborhood)).expect("valid");
        let mut one_by_one = normals.clone();
        for _ in 0..3 {
            one_by_one = refined(&mesh, &one_by_one, &params(1, neighborhood)).expect("valid");
        }
        // Each call normalises its input anew, which may move the last bit.
        let worst = at_once.iter().zip(&one_by_one).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(worst < 1e-14, "{worst}");
    }
}

#[test]
fn tiny_and_huge_meshes_filter_alike() {
    let (mut vertices, faces) = fixtures::icosphere(2);
    fixtures::jitter(&mut vertices, 0.1, 9);
    let normals = FaceGeometry::compute(&vertices, &faces).normals;
    let at_scale = |scale: f64| {
        let mesh = (vertices.iter().map(|v| *v * scale).collect(), faces.clone());
        refined(&mesh, &normals, &params(4, Neighborhood::SharedVertex)).expect("valid")
    };
    let expected = at_scale(1.0);
    for scale in [1e-100, 1e-6, 1e6, 1e100] {
        let worst = at_scale(scale).iter().zip(&expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(worst < 1e-13, "scale {scale}: {worst}");
    }
}

#[test]
fn guards() {
    let mesh = fixtures::tetrahedron();
    let normals = [DVec3::Z; 4];
    let invalid = |params: RefineParams| match refined(&mesh, &normals, &params) {
        Err(GeomError::InvalidParameter { name, .. }) => name,
        other => panic!("{other:?}"),
    };
    let base = RefineParams::default();
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(invalid(RefineParams { sigma_s: Some(bad), ..base }), "sigma_s");
        assert_eq!(invalid(RefineParams { sigma_r: bad, ..base }), "sigma_r");
        assert_eq!(invalid(params(1, Neighborhood::Radius { multiple: bad })), "multiple");
    }
    assert_eq!(
        refined(&mesh, &normals[..3], &base),
        Err(GeomError::LengthMismatch { what: "normals", expected: 4, got: 3 })
    );
    assert!(matches!(
        refined(&mesh, &[DVec3::NAN; 4], &base),
        Err(GeomError::InvalidParameter { name: "normals", .. })
    ));
    let broken = (vec![DVec3::NAN; 4], mesh.1.clone());
    assert_eq!(refined(&broken, &normals, &base), Err(GeomError::NonFiniteVertex { vertex_id: 0 }));
}
