//! Adjacency, vertex updating and normal refinement on noisy sheets of 20 thousand to 1 million faces.
//!
//! `cargo bench -p gcnd_geom --bench filters`

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use gcnd_geom::face_geometry::FaceGeometry;
use gcnd_geom::fixtures;
use gcnd_geom::normals::{Neighborhood, RefineParams, refine_normals};
use gcnd_geom::vertex_update::{Boundary, update_vertices};
use gcnd_geom::{DVec3, Face, Topology, Watch};
use std::hint::black_box;

const VERTEX_ITERATIONS: usize = 15;
/// Squares along a side; each is two faces.
const SIDES: [u32; 3] = [100, 224, 707];

/// A wavy sheet with noise of a tenth of a square.
fn noisy_sheet(side: u32) -> (Vec<DVec3>, Vec<Face>) {
    let (mut vertices, faces) = fixtures::grid(side, side);
    for v in &mut vertices {
        v.z = 3.0 * (0.2 * v.x).sin() * (0.15 * v.y).cos();
    }
    fixtures::jitter(&mut vertices, 0.1, 1);
    (vertices, faces)
}

fn adjacency(c: &mut Criterion) {
    let mut group = c.benchmark_group("adjacency");
    group.sample_size(10);
    for side in SIDES {
        let (vertices, faces) = noisy_sheet(side);
        group.throughput(Throughput::Elements(faces.len() as u64));
        group.bench_function(BenchmarkId::from_parameter(faces.len()), |b| {
            b.iter_with_setup(|| faces.clone(), |faces| Topology::new(faces, vertices.len()));
        });
    }
    group.finish();
}

/// Throughput in face-iterations.
fn vertex_update(c: &mut Criterion) {
    let mut group = c.benchmark_group("vertex_update");
    group.sample_size(10);
    for side in SIDES {
        let (vertices, faces) = noisy_sheet(side);
        let n_faces = faces.len();
        let normals = FaceGeometry::compute(&vertices, &faces).normals;
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        group.throughput(Throughput::Elements((n_faces * VERTEX_ITERATIONS) as u64));
        group.bench_function(BenchmarkId::from_parameter(n_faces), |b| {
            b.iter(|| {
                let (vertices, watch) = (black_box(&vertices), &mut Watch::silent());
                update_vertices(&topology, vertices, &normals, VERTEX_ITERATIONS, Boundary::Free, watch)
            });
        });
    }
    group.finish();
}

/// One iteration, where nothing is stored, and the paper's 12, where the weights are.
fn refine(c: &mut Criterion) {
    let mut group = c.benchmark_group("refine");
    group.sample_size(10);
    for side in SIDES {
        let (vertices, faces) = noisy_sheet(side);
        let n_faces = faces.len();
        let normals = FaceGeometry::compute(&vertices, &faces).normals;
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        for (name, iterations, neighborhood) in [
            ("shared_vertex_1", 1, Neighborhood::SharedVertex),
            ("shared_vertex_12", 12, Neighborhood::SharedVertex),
            ("radius_2_1", 1, Neighborhood::Radius { multiple: 2.0 }),
        ] {
            let params = RefineParams { iterations, neighborhood, ..RefineParams::default() };
            group.throughput(Throughput::Elements((n_faces * iterations) as u64));
            group.bench_function(BenchmarkId::new(name, n_faces), |b| {
                b.iter(|| {
                    let (vertices, watch) = (black_box(&vertices), &mut Watch::silent());
                    refine_normals(&topology, vertices, &normals, &params, watch)
                });
            });
        }
    }
    group.finish();
}

criterion_group!(filters, adjacency, vertex_update, refine);
criterion_main!(filters);
