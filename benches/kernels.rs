//! The network's CPU kernels on the patches of 20 thousand to 1 million faces at 0.2 patches a face.
//!
//! `cargo bench -p gcnd_geom --bench kernels`; throughput in faces/s.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use gcnd_geom::kernels::{GatherShape, gather_max_values, knn};
use std::hint::black_box;

const N_NODES: usize = 64;
const N_CHANNELS: usize = 64;
const KNN_K: usize = 8;
const FACES: [usize; 3] = [20_000, 100_000, 1_000_000];
/// Patches whose values are in memory at a time, as at run time.
const BATCH: usize = 1024;

/// Features that differ everywhere, without a generator's cost.
fn features(n_patches: usize) -> Vec<f32> {
    (0..n_patches * N_NODES * N_CHANNELS).map(|i| ((i as f32) * 0.618_034).fract() - 0.5).collect()
}

fn network_kernels(c: &mut Criterion) {
    let values = features(BATCH);
    let mut neighbors = vec![0i32; BATCH * N_NODES * KNN_K];
    let mut out = vec![0f32; values.len()];
    let shape =
        GatherShape { n_patches: BATCH, n_nodes: N_NODES, n_channels: N_CHANNELS, n_neighbors: KNN_K };
    for n_faces in FACES {
        let batches = (n_faces / 5).div_ceil(BATCH);
        let mut group = c.benchmark_group("knn");
        group.sample_size(10).throughput(Throughput::Elements(n_faces as u64));
        group.bench_function(BenchmarkId::from_parameter(n_faces), |b| {
            b.iter(|| {
                for _ in 0..batches {
                    knn(black_box(&values), BATCH, N_NODES, N_CHANNELS, KNN_K, &mut neighbors)
                        .expect("valid");
                }
            });
        });
        group.finish();
        let mut group = c.benchmark_group("gather_max");
        group.sample_size(10).throughput(Throughput::Elements(n_faces as u64));
        group.bench_function(BenchmarkId::from_parameter(n_faces), |b| {
            b.iter(|| {
                for _ in 0..batches {
                    gather_max_values(black_box(&values), &neighbors, shape, &mut out).expect("valid");
                }
            });
        });
        group.finish();
    }
}

criterion_group!(benches, network_kernels);
criterion_main!(benches);
