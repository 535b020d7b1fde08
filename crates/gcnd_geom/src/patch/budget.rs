//! Fixing a patch to `n_nodes` nodes (paper Sec. 5: patches of one size for the network).

use super::Budget;

/// The splitmix64 generator: a few multiplications, and a full-period sequence for every seed.
#[derive(Debug, Clone)]
pub(crate) struct SplitMix64(u64);

impl SplitMix64 {
    /// A generator for the pair (seed, id), independent of every other id's.
    pub(crate) fn for_id(seed: u64, id: u32) -> Self {
        let mixed_seed = SplitMix64(seed).next_u64();
        Self(SplitMix64(mixed_seed ^ u64::from(id)).next_u64())
    }

    /// The next 64 random bits.
    pub(crate) fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A random index below `n`; the bias is at most n / 2⁶⁴.
    pub(crate) fn index_below(&mut self, n: usize) -> usize {
        ((u128::from(self.next_u64()) * n as u128) >> 64) as usize
    }
}

/// Chooses which of the `n_faces` faces of a patch become its `n_nodes` nodes; returns how many nodes are
/// real, the rest being repeats.
///
/// `picks` receives `n_nodes` indices into the patch. A repeat's index is also the number of the node that
/// it repeats, because a patch that needs repeats has all its faces as nodes, in order.
pub(crate) fn fix_to_budget(
    n_faces: usize,
    n_nodes: usize,
    budget: Budget,
    face_id: u32,
    picks: &mut Vec<u32>,
) -> usize {
    let n_real = n_faces.min(n_nodes);
    picks.clear();
    match budget {
        Budget::NearestFirst => picks.extend((0..n_nodes).map(|node| (node % n_real) as u32)),
        Budget::Random { seed } => {
            let mut random = SplitMix64::for_id(seed, face_id);
            picks.extend(0..n_faces as u32);
            if n_faces > n_nodes {
                // The first steps of a Fisher–Yates shuffle that leaves the centre in its place.
                for node in 1..n_nodes {
                    let other = node + random.index_below(n_faces - node);
                    picks.swap(node, other);
                }
                picks.truncate(n_nodes);
            } else {
                picks.extend((n_faces..n_nodes).map(|_| random.index_below(n_faces) as u32));
            }
        }
    }
    n_real
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picks(n_faces: usize, n_nodes: usize, budget: Budget, face_id: u32) -> (usize, Vec<u32>) {
        let mut picks = vec![7; 3];
        let n_real = fix_to_budget(n_faces, n_nodes, budget, face_id, &mut picks);
        (n_real, picks)
    }

    #[test]
    fn generator_matches_the_reference_sequence() {
        let mut random = SplitMix64(1234567);
        let expected = [6457827717110365317, 3203168211198807973, 9817491932198370423];
        assert_eq!([(); 3].map(|()| random.next_u64()), expected);
    }

    #[test]
    fn nearest_first_truncates_or_cycles() {
        assert_eq!(picks(9, 4, Budget::NearestFirst, 0), (4, vec![0, 1, 2, 3]));
        assert_eq!(picks(3, 8, Budget::NearestFirst, 0), (3, vec![0, 1, 2, 0, 1, 2, 0, 1]));
        assert_eq!(picks(1, 3, Budget::NearestFirst, 0), (1, vec![0, 0, 0]));
    }

    #[test]
    fn random_subset_keeps_the_centre_and_repeats_nothing() {
        let budget = Budget::Random { seed: 5 };
        let mut counts = [0; 40];
        for face_id in 0..400 {
            let (n_real, chosen) = picks(40, 16, budget, face_id);
            assert_eq!((n_real, chosen.len(), chosen[0]), (16, 16, 0));
            let mut sorted = chosen.clone();
            sorted.sort_unstable();
            sorted.dedup();
            assert_eq!(sorted.len(), 16);
            chosen.iter().for_each(|&pick| counts[pick as usize] += 1);
        }
        // Each other face is drawn with probability 15/39: 154 of 400, standard deviation 10.
        assert!(counts[1..].iter().all(|&count| (100..210).contains(&count)), "{counts:?}");
        assert_ne!(picks(40, 16, budget, 1), picks(40, 16, budget, 2));
        assert_ne!(picks(40, 16, budget, 1), picks(40, 16, Budget::Random { seed: 6 }, 1));
    }

    #[test]
    fn random_extension_keeps_every_face_first() {
        let (n_real, chosen) = picks(5, 16, Budget::Random { seed: 1 }, 3);
        assert_eq!((n_real, &chosen[..5]), (5, &[0, 1, 2, 3, 4][..]));
        assert!(chosen[5..].iter().all(|&pick| pick < 5));
        assert_ne!(chosen[5..10], [0, 1, 2, 3, 4]);
    }
}
