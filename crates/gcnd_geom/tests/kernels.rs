//! The network's CPU kernels against explicit loops, on hand tables and on random arrays.

use gcnd_geom::kernels::{
    Bf16, GatherShape, edge_max_leaky, gather_max, gather_max_backward, gather_max_values, knn, pool_nodes,
    pool_nodes_backward,
};
use gcnd_geom::{GeomError, Result};
use proptest::collection::vec;
use proptest::prelude::*;

/// For each node its row of `a` and then its row of `b`.
fn side_by_side(a: &[f32], b: &[f32], n_channels: usize) -> Vec<f32> {
    let rows = a.chunks_exact(n_channels).zip(b.chunks_exact(n_channels));
    rows.flat_map(|(a, b)| [a, b].concat()).collect()
}

/// A gather: values, neighbours and their shape.
#[derive(Debug, Clone)]
struct Gather {
    shape: GatherShape,
    values: Vec<f32>,
    neighbors: Vec<i32>,
}

/// Shapes on both sides of every block size; values with many ties, all of them exact in bfloat16.
fn gathers() -> impl Strategy<Value = Gather> {
    let channels = prop_oneof![1usize..20, 60usize..70, Just(128), 143usize..146];
    (0usize..4, 1usize..20, channels, 1usize..20).prop_flat_map(|(n_patches, n_nodes, n_channels, n_neighbors)| {
        let shape = GatherShape { n_patches, n_nodes, n_channels, n_neighbors };
        let rows = n_patches * n_nodes;
        let value = prop_oneof![8 => (-9i8..10).prop_map(f32::from), 1 => Just(-0.0), 1 => Just(f32::NEG_INFINITY)];
        (vec(value, rows * n_channels), vec(0..n_nodes as i32, rows * n_neighbors))
            .prop_map(move |(values, neighbors)| Gather { shape, values, neighbors })
    })
}

fn to_bf16(values: &[f32]) -> Vec<Bf16> {
    values.iter().map(|&value| Bf16::from_f32(value)).collect()
}

/// (maximum, winner) of every entry, by the definition.
fn naive_gather_max(gather: &Gather) -> (Vec<f32>, Vec<u16>) {
    let GatherShape { n_patches, n_nodes, n_channels, n_neighbors } = gather.shape;
    let (mut out, mut argmax) = (Vec::new(), Vec::new());
    for row in 0..n_patches * n_nodes {
        let first_row = row / n_nodes * n_nodes;
        for channel in 0..n_channels {
            let ids = &gather.neighbors[row * n_neighbors..][..n_neighbors];
            let value = |id: i32| gather.values[(first_row + id as usize) * n_channels + channel];
            let winner = ids.iter().fold(ids[0], |best, &id| if value(id) > value(best) { id } else { best });
            out.push(value(winner));
            argmax.push(winner as u16);
        }
    }
    (out, argmax)
}

/// Features on a coarse grid, whose squared distances are exact in f32, so that ties are real.
fn grid_features() -> impl Strategy<Value = (usize, usize, usize, usize, Vec<f32>)> {
    (0usize..3, 1usize..80, 1usize..9).prop_flat_map(|(n_patches, n_nodes, n_channels)| {
        let features = vec((-3i8..4).prop_map(f32::from), n_patches * n_nodes * n_channels);
        (Just(n_patches), Just(n_nodes), Just(n_channels), 1..=n_nodes, features)
    })
}

fn squared_distance(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum()
}

/// The neighbours of every node of one patch: itself, then all others by (distance, id).
fn naive_knn(features: &[f32], n_channels: usize, k: usize) -> Vec<i32> {
    let nodes: Vec<&[f32]> = features.chunks_exact(n_channels).collect();
    let mut out = Vec::new();
    for (i, own) in nodes.iter().enumerate() {
        let mut others: Vec<usize> = (0..nodes.len()).filter(|&j| j != i).collect();
        others.sort_by(|&j, &l| squared_distance(own, nodes[j]).total_cmp(&squared_distance(own, nodes[l])));
        out.push(i as i32);
        out.extend(others.iter().take(k - 1).map(|&j| j as i32));
    }
    out
}

fn run_knn(features: &[f32], n_patches: usize, n_nodes: usize, n_channels: usize, k: usize) -> Vec<i32> {
    let mut out = vec![-1; n_patches * n_nodes * k];
    knn(features, n_patches, n_nodes, n_channels, k, &mut out).unwrap();
    out
}

/// Reproducible numbers in (−1, 1) with full mantissas.
fn noise(len: usize) -> Vec<f32> {
    let mut state = 0x9e37_79b9_u32;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state as i32 as f32 / i32::MAX as f32
    };
    (0..len).map(|_| next()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn gather_max_equals_the_loop(gather in gathers()) {
        let (expected, winners) = naive_gather_max(&gather);
        let Gather { shape, values, neighbors } = gather;
        let (mut out, mut argmax) = (vec![7.0; values.len()], vec![9; values.len()]);
        gather_max(&values, &neighbors, shape, &mut out, &mut argmax).unwrap();
        prop_assert_eq!(&out, &expected);
        prop_assert_eq!(&argmax, &winners);
        out.fill(7.0);
        gather_max_values(&values, &neighbors, shape, &mut out).unwrap();
        prop_assert_eq!(&out, &expected);

        let (values, expected) = (to_bf16(&values), to_bf16(&expected));
        let mut out = vec![Bf16::from_f32(7.0); values.len()];
        argmax.fill(9);
        gather_max(&values, &neighbors, shape, &mut out, &mut argmax).unwrap();
        prop_assert_eq!(&out, &expected);
        prop_assert_eq!(&argmax, &winners);
        out.fill(Bf16::from_f32(7.0));
        gather_max_values(&values, &neighbors, shape, &mut out).unwrap();
        prop_assert_eq!(&out, &expected);
    }

    #[test]
    fn backward_equals_the_scatter(gather in gathers()) {
        let (_, winners) = naive_gather_max(&gather);
        let GatherShape { n_nodes, n_channels, .. } = gather.shape;
        let grad_out: Vec<f32> = (0..winners.len()).map(|i| (i * 5 % 17) as f32 - 8.0).collect();
        let mut expected = vec![0.0; winners.len()];
        for (entry, &winner) in winners.iter().enumerate() {
            let (row, channel) = (entry / n_channels, entry % n_channels);
            expected[(row / n_nodes * n_nodes + usize::from(winner)) * n_channels + channel] += grad_out[entry];
        }
        let mut grad_in = vec![7.0; winners.len()];
        gather_max_backward(&grad_out, &winners, gather.shape, &mut grad_in).unwrap();
        prop_assert_eq!(&grad_in, &expected);
        let mut grad_in = vec![Bf16::from_f32(7.0); winners.len()];
        gather_max_backward(&to_bf16(&grad_out), &winners, gather.shape, &mut grad_in).unwrap();
        prop_assert_eq!(grad_in, to_bf16(&expected));
    }

    #[test]
    fn edge_max_leaky_equals_the_loop(gather in gathers(), slope in 0.0f32..=1.0) {
        let (best, _) = naive_gather_max(&gather);
        let n_channels = gather.shape.n_channels;
        let a: Vec<f32> = (0..best.len()).map(|i| (i * 7 % 13) as f32 * 0.5 - 2.0).collect();
        let scale: Vec<f32> = (0..n_channels).map(|c| (c % 5) as f32 * 0.5 - 1.0).collect();
        let leaky = |x: f32| if x > 0.0 { x } else { slope * x };
        let response = |(i, (a, b)): (usize, (&f32, &f32))| leaky(a + scale[i % n_channels] * b);
        let expected: Vec<f32> = a.iter().zip(&best).enumerate().map(response).collect();
        let parts = side_by_side(&a, &gather.values, n_channels);
        let mut out = vec![7.0; best.len()];
        edge_max_leaky(&parts, &scale, &gather.neighbors, gather.shape, slope, &mut out).unwrap();
        // −inf · 0 is NaN on both sides.
        let bits = |values: &[f32]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&out), bits(&expected));
        let mut out = vec![Bf16::from_f32(7.0); best.len()];
        edge_max_leaky(&to_bf16(&parts), &scale, &gather.neighbors, gather.shape, slope, &mut out).unwrap();
        let bits = |values: &[Bf16]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&out), bits(&to_bf16(&expected)));
    }

    #[test]
    fn pooling_equals_the_loop(gather in gathers()) {
        let GatherShape { n_patches, n_nodes, n_channels, .. } = gather.shape;
        // Whole numbers: sums are exact, and ties happen.
        let values: Vec<f32> = gather.values.iter().map(|x| x.clamp(-9.0, 9.0)).collect();
        let (mut expected, mut winners) = (Vec::new(), Vec::new());
        for patch in values.chunks_exact(n_nodes * n_channels) {
            let column = |c: usize| patch.iter().skip(c).step_by(n_channels).copied();
            expected.extend((0..n_channels).map(|c| column(c).sum::<f32>() / n_nodes as f32));
            let best = |c: usize| column(c).fold(f32::NEG_INFINITY, f32::max);
            expected.extend((0..n_channels).map(best));
            winners.extend((0..n_channels).map(|c| column(c).position(|x| x == best(c)).unwrap() as u16));
        }
        let (mut out, mut argmax) = (vec![7.0; expected.len()], vec![9; winners.len()]);
        pool_nodes(&values, gather.shape, &mut out, &mut argmax).unwrap();
        prop_assert_eq!(&out, &expected);
        prop_assert_eq!(&argmax, &winners);
        let mut narrow = vec![Bf16::default(); expected.len()];
        pool_nodes(&to_bf16(&values), gather.shape, &mut narrow, &mut argmax).unwrap();
        prop_assert_eq!(narrow, to_bf16(&expected));

        let grad_out: Vec<f32> = (0..expected.len()).map(|i| (i * 5 % 11) as f32 - 4.0).collect();
        let mut expected = vec![0.0; values.len()];
        for (slot, grad) in expected.iter_mut().enumerate() {
            let (patch, node, channel) =
                (slot / (n_nodes * n_channels), slot / n_channels % n_nodes, slot % n_channels);
            let pooled = 2 * patch * n_channels + channel;
            *grad = grad_out[pooled] / n_nodes as f32;
            if usize::from(winners[patch * n_channels + channel]) == node {
                *grad += grad_out[pooled + n_channels];
            }
        }
        let mut grad_in = vec![7.0; values.len()];
        pool_nodes_backward(&grad_out, &winners, gather.shape, &mut grad_in).unwrap();
        prop_assert_eq!(&grad_in, &expected);
        let mut narrow = vec![Bf16::default(); values.len()];
        pool_nodes_backward(&to_bf16(&grad_out), &winners, gather.shape, &mut narrow).unwrap();
        prop_assert_eq!(narrow, to_bf16(&expected));
        prop_assert_eq!(n_patches * n_channels, winners.len());
    }

    #[test]
    fn knn_equals_the_sorted_distances((n_patches, n_nodes, n_channels, k, features) in grid_features()) {
        let patch = n_nodes * n_channels;
        let expected: Vec<i32> = features.chunks_exact(patch).flat_map(|f| naive_knn(f, n_channels, k)).collect();
        prop_assert_eq!(&run_knn(&features, n_patches, n_nodes, n_channels, k), &expected);
        let mut out = vec![-1; expected.len()];
        knn(&to_bf16(&features), n_patches, n_nodes, n_channels, k, &mut out).unwrap();
        prop_assert_eq!(&out, &expected);
    }
}

#[test]
fn gather_max_of_a_hand_table() {
    // Two patches of three nodes with two channels: the same ids mean other rows in the second patch.
    let shape = GatherShape { n_patches: 2, n_nodes: 3, n_channels: 2, n_neighbors: 2 };
    let values = [1.0, 9.0, 5.0, 2.0, 3.0, 9.0, -1.0, -2.0, -3.0, -1.0, -2.0, -3.0];
    let neighbors = [0, 1, 2, 0, 1, 1, 2, 1, 0, 0, 1, 2];
    let (mut out, mut argmax) = ([0.0f32; 12], [0; 12]);
    gather_max(&values, &neighbors, shape, &mut out, &mut argmax).unwrap();
    assert_eq!(out, [5.0, 9.0, 3.0, 9.0, 5.0, 2.0, -2.0, -1.0, -1.0, -2.0, -2.0, -1.0]);
    assert_eq!(argmax, [1, 0, 2, 2, 1, 1, 2, 1, 0, 0, 2, 1]);
    let mut grad_in = [0.0f32; 12];
    let grad_out = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
    gather_max_backward(&grad_out, &argmax, shape, &mut grad_in).unwrap();
    assert_eq!(grad_in, [0.0, 2.0, 17.0, 32.0, 4.0, 8.0, 4.0, 8.0, 0.0, 34.0, 17.0, 0.0]);
}

#[test]
fn backward_sums_bfloat16_in_f32() {
    // 256 + 1 is not a bfloat16 number: rounding after every addition would leave 256.
    let shape = GatherShape { n_patches: 1, n_nodes: 9, n_channels: 1, n_neighbors: 1 };
    let mut grad_out = [1.0; 9];
    grad_out[0] = 256.0;
    let mut grad_in = [Bf16::default(); 9];
    gather_max_backward(&to_bf16(&grad_out), &[4; 9], shape, &mut grad_in).unwrap();
    assert_eq!(grad_in[4].to_f32(), 264.0);
}

#[test]
fn knn_of_random_features_is_right_up_to_rounding() {
    for (n_nodes, n_channels, k) in [(64, 64, 8), (64, 128, 8), (100, 17, 20), (33, 40, 33), (512, 3, 16)] {
        let features = noise(2 * n_nodes * n_channels);
        let patch = n_nodes * n_channels;
        let found = run_knn(&features, 2, n_nodes, n_channels, k);
        for (features, found) in features.chunks_exact(patch).zip(found.chunks_exact(n_nodes * k)) {
            let expected = naive_knn(features, n_channels, k);
            let node = |id: i32| &features[id as usize * n_channels..][..n_channels];
            for (found, expected) in found.chunks_exact(k).zip(expected.chunks_exact(k)) {
                assert_eq!(found[0], expected[0]);
                let mut distinct = found.to_vec();
                distinct.sort_unstable();
                distinct.dedup();
                assert_eq!(distinct.len(), k);
                for (&j, &best) in found.iter().zip(expected) {
                    let (d, best) = (
                        squared_distance(node(found[0]), node(j)),
                        squared_distance(node(found[0]), node(best)),
                    );
                    assert!((d - best).abs() <= 1e-5 * n_channels as f64, "{d} for {best}");
                }
            }
        }
    }
}

#[test]
fn knn_ignores_a_common_offset() {
    let grid: Vec<f32> = (0..64 * 3).map(|i| (i * i % 23) as f32).collect();
    let shifted: Vec<f32> = grid.iter().map(|x| x + 1e6).collect();
    assert_eq!(run_knn(&grid, 1, 64, 3, 8), run_knn(&shifted, 1, 64, 3, 8));
}

#[test]
fn repeated_nodes_are_exact_ties() {
    // 16 nodes, each four times, with features whose products round.
    let once = noise(16 * 30);
    let features: Vec<f32> = (0..64).flat_map(|i| &once[i % 16 * 30..][..30]).copied().collect();
    for (i, ids) in run_knn(&features, 1, 64, 30, 4).chunks_exact(4).enumerate() {
        let twins: Vec<i32> = (0..64).filter(|j| j % 16 == i % 16 && *j != i).map(|j| j as i32).collect();
        assert_eq!((ids[0], &ids[1..]), (i as i32, twins.as_slice()));
    }
}

#[test]
fn nan_and_overflow_are_never_chosen() {
    for (bad, bad_node) in [(f32::NAN, 0), (f32::NAN, 2), (f32::INFINITY, 0), (f32::INFINITY, 39), (1e30, 2)]
    {
        for k in [3, 40] {
            let mut features: Vec<f32> = (0..40).map(|i| i as f32).collect();
            features[bad_node] = bad;
            for (i, ids) in run_knn(&features, 1, 40, 1, k).chunks_exact(k).enumerate() {
                let own = i as i32;
                assert_eq!(ids[0], own);
                if i != bad_node {
                    assert!(!ids.contains(&(bad_node as i32)), "{bad} at {bad_node}: {ids:?}");
                } else if !bad.is_finite() {
                    assert!(ids.iter().all(|&id| id == own), "{bad} at {bad_node}: {ids:?}");
                }
                assert!(ids.iter().all(|id| (0..40).contains(id)));
            }
        }
    }
    let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 1, n_neighbors: 2 };
    let (mut out, mut argmax) = ([0.0; 2], [7; 2]);
    gather_max(&[f32::NAN, f32::NAN], &[0, 1, 1, 0], shape, &mut out, &mut argmax).unwrap();
    assert_eq!(argmax, [0, 1]);
}

#[test]
fn wrong_lengths_and_ids_are_errors_and_write_nothing() {
    let shape = GatherShape { n_patches: 1, n_nodes: 2, n_channels: 2, n_neighbors: 1 };
    let gather = |values: &[f32], neighbors: &[i32], n_out: usize, n_argmax: usize| {
        let (mut out, mut argmax) = (vec![7.0; n_out], vec![9; n_argmax]);
        let result = gather_max(values, neighbors, shape, &mut out, &mut argmax);
        assert!(out.iter().all(|&x| x == 7.0) && argmax.iter().all(|&x| x == 9));
        result
    };
    let mismatch = |what, expected, got| Err(GeomError::LengthMismatch { what, expected, got });
    assert_eq!(gather(&[0.0; 3], &[0, 1], 4, 4), mismatch("values", 4, 3));
    assert_eq!(gather(&[0.0; 4], &[0], 4, 4), mismatch("neighbors", 2, 1));
    assert_eq!(gather(&[0.0; 4], &[0, 1], 5, 4), mismatch("out", 4, 5));
    assert_eq!(gather(&[0.0; 4], &[0, 1], 4, 0), mismatch("argmax", 4, 0));
    let is_parameter = |result: Result<()>, wrong: &str| match result {
        Err(GeomError::InvalidParameter { name, .. }) => assert_eq!(name, wrong),
        other => panic!("{other:?} instead of {wrong}"),
    };
    is_parameter(gather(&[0.0; 4], &[0, 2], 4, 4), "neighbors");
    is_parameter(gather(&[0.0; 4], &[-1, 0], 4, 4), "neighbors");
    let mut out = [0.0f32; 4];
    is_parameter(gather_max_values(&[0.0; 4], &[0, 2], shape, &mut out), "neighbors");
    is_parameter(edge_max_leaky(&[0.0; 8], &[1.0; 2], &[2, 0], shape, 0.2, &mut out), "neighbors");
    is_parameter(edge_max_leaky(&[0.0; 8], &[1.0; 2], &[1, 0], shape, -0.1, &mut out), "slope");
    is_parameter(edge_max_leaky(&[0.0; 8], &[1.0; 2], &[1, 0], shape, f32::NAN, &mut out), "slope");
    is_parameter(gather_max_backward(&[0.0; 4], &[0, 1, 2, 1], shape, &mut out), "argmax");
    let argmax = [0, 1, 1, 1];
    assert_eq!(gather_max_backward(&[0.0; 5], &argmax, shape, &mut out), mismatch("grad_out", 4, 5));
    assert_eq!(gather_max_backward(&[0.0; 4], &argmax[..3], shape, &mut out), mismatch("argmax", 4, 3));
    assert_eq!(gather_max_backward(&[0.0; 4], &argmax, shape, &mut out[..1]), mismatch("grad_in", 4, 1));
    let edge = |n_parts: usize, n_scales: usize, n_out: usize| {
        let (parts, scale) = (vec![0.0f32; n_parts], vec![1.0; n_scales]);
        edge_max_leaky(&parts, &scale, &[1, 0], shape, 0.2, &mut vec![0.0; n_out])
    };
    assert_eq!(edge(7, 2, 4), mismatch("parts", 8, 7));
    assert_eq!(edge(8, 1, 4), mismatch("scale", 2, 1));
    assert_eq!(edge(8, 2, 3), mismatch("out", 4, 3));

    let pool = |n_values: usize, n_out: usize, n_argmax: usize| {
        pool_nodes(&vec![0.0f32; n_values], shape, &mut vec![0.0; n_out], &mut vec![0; n_argmax])
    };
    assert_eq!(pool(3, 4, 2), mismatch("values", 4, 3));
    assert_eq!(pool(4, 3, 2), mismatch("pooled", 4, 3));
    assert_eq!(pool(4, 4, 1), mismatch("argmax", 2, 1));
    let mut grad = [7.0f32; 4];
    assert_eq!(pool_nodes_backward(&[0.0; 3], &[0; 2], shape, &mut grad), mismatch("pooled", 4, 3));
    assert_eq!(pool_nodes_backward(&[0.0; 4], &[0; 2], shape, &mut grad[..3]), mismatch("grad_in", 4, 3));
    is_parameter(pool_nodes_backward(&[0.0; 4], &[0, 2], shape, &mut grad), "argmax");
    assert_eq!(grad, [7.0; 4]);

    let mut ids = [7; 4];
    assert_eq!(knn(&[0.0f32; 3], 1, 2, 2, 2, &mut ids), mismatch("features", 4, 3));
    assert_eq!(knn(&[0.0f32; 4], 1, 2, 2, 1, &mut ids), mismatch("out", 2, 4));
    is_parameter(knn(&[0.0f32; 4], 1, 2, 2, 0, &mut ids), "k");
    is_parameter(knn(&[0.0f32; 4], 1, 2, 2, 3, &mut ids), "k");
    is_parameter(knn(&[0.0f32; 0], 1, 0, 2, 1, &mut ids), "n_nodes");
    is_parameter(knn(&[0.0f32; 0], 1, 2, 0, 2, &mut ids), "n_channels");
    assert!(matches!(knn(&[0.0f32; 4], usize::MAX, 2, 2, 2, &mut ids), Err(GeomError::TooLarge { .. })));
    assert_eq!(ids, [7; 4]);
}

#[test]
fn one_thread_and_many_are_bit_identical() {
    let (n_patches, n_nodes, n_channels, n_neighbors) = (67, 40, 33, 8);
    let shape = GatherShape { n_patches, n_nodes, n_channels, n_neighbors };
    let features = noise(n_patches * n_nodes * n_channels);
    let run = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let neighbors = run_knn(&features, n_patches, n_nodes, n_channels, n_neighbors);
            let (mut out, mut argmax) = (vec![0.0; features.len()], vec![0; features.len()]);
            gather_max(&features, &neighbors, shape, &mut out, &mut argmax).unwrap();
            let mut grad_in = vec![0.0; features.len()];
            gather_max_backward(&features, &argmax, shape, &mut grad_in).unwrap();
            let mut edge = vec![0.0; features.len()];
            let parts = side_by_side(&features, &grad_in, n_channels);
            edge_max_leaky(&parts, &vec![-0.7; n_channels], &neighbors, shape, 0.2, &mut edge).unwrap();
            let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            (neighbors, bits(out), argmax, bits(grad_in), bits(edge))
        })
    };
    let expected = run(1);
    for n_threads in [2, 5] {
        assert!(run(n_threads) == expected, "{n_threads} threads differ from one");
    }
}
