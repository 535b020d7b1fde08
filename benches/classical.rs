//! The classical filters at their defaults, one group each, on noisy sheets of 20 thousand to 1 million faces.
//!
//! `cargo bench -p gcnd_geom --bench classical`

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use gcnd_geom::normals::*;
use gcnd_geom::smoothing::*;
use gcnd_geom::{DVec3, Result, Topology, Watch, fixtures};
use std::hint::black_box;

/// Squares along a side; each is two faces.
const SIDES: [u32; 3] = [100, 224, 707];

type Run = fn(&Topology, &[DVec3], &mut Watch<'_>) -> Result<Vec<DVec3>>;

/// Each filter, and on how many of the sheets it is timed.
const FILTERS: [(&str, usize, Run); 11] = [
    ("bilateral_normal", 3, |t, v, w| bilateral_normal(t, v, &BilateralNormalParams::default(), w)),
    ("bilateral_normal_implicit", 2, |t, v, w| {
        bilateral_normal_implicit(t, v, &ImplicitNormalParams::default(), w)
    }),
    ("guided_normal", 2, |t, v, w| guided_normal(t, v, &GuidedNormalParams::default(), w)),
    ("fast_effective", 3, |t, v, w| fast_effective(t, v, &FastEffectiveParams::default(), w)),
    ("tgv", 2, |t, v, w| tgv(t, v, &TgvParams::default(), w)),
    ("low_rank", 1, |t, v, w| low_rank(t, v, &LowRankParams::default(), w)),
    ("bilateral_mesh", 3, |t, v, w| bilateral_mesh(t, v, &BilateralMeshParams::default(), w)),
    ("l0", 1, |t, v, w| l0(t, v, &L0Params::default(), w)),
    ("laplacian", 3, |t, v, w| laplacian(t, v, &LaplacianParams::default(), w)),
    ("taubin", 3, |t, v, w| taubin(t, v, &TaubinParams::default(), w)),
    ("hc_laplacian", 3, |t, v, w| hc_laplacian(t, v, &HcLaplacianParams::default(), w)),
];

/// A wavy sheet with noise of a tenth of a square.
fn noisy_sheet(side: u32) -> (Topology, Vec<DVec3>) {
    let (mut vertices, faces) = fixtures::grid(side, side);
    for v in &mut vertices {
        v.z = 3.0 * (0.2 * v.x).sin() * (0.15 * v.y).cos();
    }
    fixtures::jitter(&mut vertices, 0.1, 1);
    (Topology::new(faces, vertices.len()).expect("valid"), vertices)
}

fn classical(c: &mut Criterion) {
    for (name, n_sheets, run) in FILTERS {
        let mut group = c.benchmark_group(name);
        group.sample_size(10);
        for &side in &SIDES[..n_sheets] {
            let (topology, vertices) = noisy_sheet(side);
            group.throughput(Throughput::Elements(topology.n_faces() as u64));
            group.bench_function(BenchmarkId::from_parameter(topology.n_faces()), |b| {
                b.iter(|| run(&topology, black_box(&vertices), &mut Watch::silent()));
            });
        }
        group.finish();
    }
}

criterion_group!(benches, classical);
criterion_main!(benches);
