//! Patch extraction in faces per second: 64 nodes as the fast preset uses them, 256 as wide patches do, on
//! meshes from small to large.

use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use gcnd_geom::patch::{PatchBuffers, PatchExtractor, PatchParams};
use gcnd_geom::{DVec3, Face, Topology, fixtures};
use std::f64::consts::TAU;
use std::time::Duration;

/// Patches of one call, about what denoising streams at a time.
const N_PATCHES: usize = 4096;

/// A noisy torus with bumps of `side` × `side` squares, two triangles each.
fn bumpy_torus(side: u32) -> (Vec<DVec3>, Vec<Face>) {
    let angle = |i: u32| f64::from(i) / f64::from(side) * TAU;
    let mut vertices: Vec<DVec3> = (0..side * side)
        .map(|i| {
            let (around, across) = (angle(i / side), angle(i % side));
            let tube = 0.6 + 0.05 * (9.0 * around).sin() * (5.0 * across).cos();
            let ring = 1.0 + tube * across.cos();
            DVec3::new(ring * around.cos(), ring * around.sin(), tube * across.sin())
        })
        .collect();
    fixtures::jitter(&mut vertices, 0.6 / f64::from(side), 1);
    let id = |row: u32, column: u32| row % side * side + column % side;
    let faces = (0..side * side)
        .flat_map(|i| {
            let (row, column) = (i / side, i % side);
            let [a, b] = [id(row, column), id(row + 1, column)];
            let [c, d] = [id(row + 1, column + 1), id(row, column + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    (vertices, faces)
}

/// The arrays of a call.
struct Arrays {
    features: Vec<f32>,
    neighbors: Vec<i32>,
    face_ids: Vec<u32>,
    mask: Vec<u8>,
    world_from_patch: Vec<f64>,
    radii: Vec<f64>,
}

impl Arrays {
    fn new(params: &PatchParams) -> Self {
        let n = N_PATCHES * params.n_nodes;
        Self {
            features: vec![0.0; n * params.n_channels()],
            neighbors: vec![0; n * 3],
            face_ids: vec![0; n],
            mask: vec![0; n],
            world_from_patch: vec![0.0; N_PATCHES * 9],
            radii: vec![0.0; N_PATCHES],
        }
    }

    fn extract(&mut self, extractor: &PatchExtractor<'_>, centers: &[u32]) {
        let out = PatchBuffers {
            features: &mut self.features,
            neighbors: &mut self.neighbors,
            face_ids: &mut self.face_ids,
            mask: &mut self.mask,
            world_from_patch: &mut self.world_from_patch,
            radii: &mut self.radii,
        };
        extractor.extract(centers, out).expect("arrays of the right size");
    }
}

fn extraction(c: &mut Criterion) {
    for (n_nodes, patch_scale) in [(64, 4.0), (256, 8.0)] {
        let mut group = c.benchmark_group(format!("extract/{n_nodes}_nodes"));
        group
            .sample_size(10)
            .warm_up_time(Duration::from_millis(500))
            .measurement_time(Duration::from_secs(2));
        group.throughput(Throughput::Elements(N_PATCHES as u64));
        for side in [100, 224, 708] {
            let (vertices, faces) = bumpy_torus(side);
            let n_faces = faces.len();
            let topology = Topology::new(faces, vertices.len()).expect("valid mesh");
            let params = PatchParams { n_nodes, patch_scale, ..PatchParams::default() };
            let extractor = PatchExtractor::new(&topology, &vertices, params).expect("valid mesh");
            let mut arrays = Arrays::new(&params);
            // A fifth of the faces in order, as the cover of a mesh is streamed, from another place each time.
            let mut start = 0;
            group.bench_function(BenchmarkId::from_parameter(n_faces), |b| {
                b.iter_batched(
                    || {
                        start = (start + 7919) % n_faces;
                        (0..N_PATCHES).map(|i| ((start + 5 * i) % n_faces) as u32).collect::<Vec<_>>()
                    },
                    |centers| arrays.extract(&extractor, &centers),
                    BatchSize::SmallInput,
                );
            });
        }
        group.finish();
    }
}

fn preparation(c: &mut Criterion) {
    let mut group = c.benchmark_group("prepare");
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    for side in [100, 224, 708] {
        let (vertices, faces) = bumpy_torus(side);
        group.throughput(Throughput::Elements(faces.len() as u64));
        let topology = Topology::new(faces, vertices.len()).expect("valid mesh");
        group.bench_function(BenchmarkId::from_parameter(topology.n_faces()), |b| {
            b.iter(|| PatchExtractor::new(&topology, &vertices, PatchParams::default()).expect("valid mesh"));
        });
    }
    group.finish();
}

criterion_group!(benches, extraction, preparation);
criterion_main!(benches);
