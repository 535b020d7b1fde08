//! Weak noise: what was taken away where there is detail is mostly detail, and comes back.

use crate::error::{Result, check_len};
use crate::face_geometry::mean_edge_length;
use crate::mesh::check_vertices;
use crate::patch::quantile;
use crate::topology::Topology;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Rounds of averaging after which steps are told by their size, about three edges far, and by their likeness, five.
const ROUNDS: (usize, usize) = (16, 48);

/// Share of the vertices whose surroundings moved less than what counts as the noise.
const NOISE_SHARE: f64 = 0.05;

/// How many times the square of the noise counts as noise still.
const SLACK: f64 = 2.0;

/// Correlation of the steps of neighbours: noise has less than the first, detail more than the second.
const LIKENESS: (f64, f64) = (0.04, 0.12);

/// Noise in mean edge lengths: below the first all detail comes back, above the second none does.
const WEAK: (f64, f64) = (0.06, 0.12);

/// Vertices or faces of one unit of parallel work.
const CHUNK: usize = 4096;

/// Takes steps back where detail was taken away rather than noise.
///
/// With d_i the step of vertex i, r_i the root mean square of d around it, s the r that a twentieth of the vertices lie
/// below, and ρ_i = ⟨d_a · d_b⟩ / ⟨d_a²⟩ over the edges ab around it:
///
/// v_i ← before_i + w_i (after_i − before_i),  w_i = max(min(1, 2 s² / r_i²)², 1 − S(ρ_i) (1 − T(s)))
///
/// Noise is everywhere, so what exceeds s may be detail. Noise is also independent from vertex to vertex, detail is not:
/// S rises smoothly from 0 at ρ = 0.04 to 1 at 0.12, so uneven noise goes whole. T rises from 0 at s = 0.06 mean edges to
/// 1 at 0.12: with stronger noise nothing comes back, since as much noise would come with it.
///
/// - `topology`, `before` (V), `after` (V) in mesh units.
///
/// Returns (V) positions, in mesh units, each between `before` and `after`.
///
/// # Errors
/// [`crate::GeomError::LengthMismatch`], [`crate::GeomError::NonFiniteVertex`].
///
/// Choice: docs/choices.md#detail-under-weak-noise.
///
/// ```
/// use gcnd_geom::{fixtures, keep_detail::keep_detail, Topology};
/// let (before, faces) = fixtures::grid(20, 20);
/// let topology = Topology::new(faces, before.len())?;
/// let mut after = before.clone();
/// after[210..231].iter_mut().for_each(|v| v.z += 0.02); // a row taken away from what has no noise
/// assert!(keep_detail(&topology, &before, &after)?[220].z < 1e-6);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn keep_detail(topology: &Topology, before: &[DVec3], after: &[DVec3]) -> Result<Vec<DVec3>> {
    check_len("before", topology.n_vertices(), before.len())?;
    check_len("after", topology.n_vertices(), after.len())?;
    check_vertices(before)?;
    check_vertices(after)?;
    let edge = mean_edge_length(before, topology.faces());
    let has_faces = |&vertex_id: &usize| !topology.vertex_faces().row(vertex_id).is_empty();
    if !edge.is_normal() || topology.n_faces() == 0 {
        return Ok(after.to_vec());
    }
    // In mean edge lengths, so that squares stay in the range of numbers.
    let steps: Vec<DVec3> = after.par_iter().zip(before).map(|(&a, &b)| (a - b) / edge).collect();
    let mut averages = Averages::new(topology, &steps);
    averages.run(ROUNDS.0);
    let sizes: Vec<f64> = averages.of_vertices.iter().map(|mean| mean.y).collect();
    let mut seen: Vec<f64> = (0..sizes.len()).filter(has_faces).map(|vertex_id| sizes[vertex_id]).collect();
    let noise = quantile(&mut seen, NOISE_SHARE);
    averages.run(ROUNDS.1 - ROUNDS.0);
    let kept = |(vertex_id, (&a, &b)): (usize, (&DVec3, &DVec3))| match share(
        sizes[vertex_id],
        noise,
        averages.of_vertices[vertex_id],
    ) {
        1.0 => a,
        share => b + share * (a - b),
    };
    Ok(after.par_iter().zip(before).enumerate().with_min_len(CHUNK).map(kept).collect())
}

/// w of a vertex, of r², s², and ⟨d_a · d_b⟩ with ⟨d_a²⟩, in mean edge lengths.
fn share(size: f64, noise: f64, alike: DVec2) -> f64 {
    let even = if size > SLACK * noise { (SLACK * noise / size).powi(2) } else { 1.0 };
    let likeness = if alike.y > 0.0 { alike.x / alike.y } else { 0.0 };
    even.max(1.0 - smooth_step(likeness, LIKENESS) * (1.0 - smooth_step(noise.sqrt(), WEAK)))
}

/// Rises from 0 at the first of `ends` to 1 at the second, level at both.
fn smooth_step(x: f64, ends: (f64, f64)) -> f64 {
    let t = ((x - ends.0) / (ends.1 - ends.0)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Means over the surroundings of a vertex, wider with every round: of d_a · d_b over edges, and of d_a².
struct Averages<'a> {
    topology: &'a Topology,
    of_faces: Vec<DVec2>,
    /// (V), zero for a vertex without faces.
    of_vertices: Vec<DVec2>,
}

impl<'a> Averages<'a> {
    /// Takes the mean of the faces at a vertex, of steps (V).
    fn new(topology: &'a Topology, steps: &[DVec3]) -> Self {
        let of_face = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| steps[v as usize]);
            let squares = a.length_squared() + b.length_squared() + c.length_squared();
            DVec2::new(a.dot(b) + b.dot(c) + c.dot(a), squares) / 3.0
        };
        let of_faces = topology.faces().par_iter().with_min_len(CHUNK).map(of_face).collect();
        let mut averages = Self { topology, of_faces, of_vertices: vec![DVec2::ZERO; steps.len()] };
        averages.gather();
        averages
    }

    /// Averages over faces, then over vertices, `rounds` times.
    fn run(&mut self, rounds: usize) {
        for _ in 0..rounds {
            let vertices = &self.of_vertices;
            let faces = self.of_faces.par_iter_mut().zip(self.topology.faces());
            faces.with_min_len(CHUNK).for_each(|(mean, face)| {
                let [a, b, c] = face.map(|v| vertices[v as usize]);
                *mean = (a + b + c) / 3.0;
            });
            self.gather();
        }
    }

    fn gather(&mut self) {
        let (topology, of_faces) = (self.topology, &self.of_faces);
        let vertices = self.of_vertices.par_iter_mut().enumerate();
        vertices.with_min_len(CHUNK).for_each(|(vertex_id, mean)| {
            let row = topology.vertex_faces().row(vertex_id);
            if !row.is_empty() {
                *mean = row.iter().map(|&f| of_faces[f as usize]).sum::<DVec2>() / row.len() as f64;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GeomError;
    use crate::fixtures;

    /// A plane whose vertices have random steps across it, of this root mean square in mean edge lengths.
    fn noisy_plane(level: f64) -> (Topology, Vec<DVec3>, Vec<DVec3>) {
        let (flat, faces) = fixtures::grid(60, 60);
        let edge = mean_edge_length(&flat, &faces);
        let mut before = flat.clone();
        fixtures::jitter(&mut before, level * edge, 3);
        before.iter_mut().zip(&flat).for_each(|(b, f)| *b = DVec3::new(f.x, f.y, b.z));
        (Topology::new(faces, flat.len()).expect("valid"), before, flat)
    }

    fn largest(a: &[DVec3], b: &[DVec3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    }

    #[test]
    fn shares_by_hand() {
        let (white, alike) = (DVec2::new(0.0, 1.0), DVec2::new(0.5, 1.0));
        assert_eq!(share(0.0, 0.0, DVec2::ZERO), 1.0, "nothing moved");
        assert_eq!(share(2e-4, 1e-4, alike), 1.0, "within the slack");
        assert_eq!(share(4e-4, 1e-4, alike), 0.25);
        assert_eq!(share(1e-6, 0.0, alike), 0.0, "without noise everything is detail");
        assert_eq!(share(4e-4, 1e-4, white), 1.0, "uneven noise");
        assert_eq!(share(1.0, 0.12 * 0.12, alike), 1.0, "strong noise");
        assert!((share(1.0, 0.09 * 0.09, alike) - 0.5).abs() < 1e-12, "half way to strong");
        assert_eq!(share(4.0, 0.0, DVec2::new(-0.5, 1.0)), 1.0);
        assert!((share(4.0, 0.0, DVec2::new(0.08, 1.0)) - 0.5).abs() < 1e-12, "half way");
    }

    #[test]
    fn averages_by_hand() {
        // Two triangles of a square, a step of 1 at two corners that share an edge and both faces, none elsewhere.
        let topology = Topology::new(vec![[0, 1, 2], [0, 2, 3]], 5).expect("valid");
        let mut steps = vec![DVec3::ZERO; 5];
        (steps[0], steps[2]) = (DVec3::Z, DVec3::Z);
        let mut averages = Averages::new(&topology, &steps);
        let both = DVec2::new(1.0, 2.0) / 3.0;
        assert_eq!(averages.of_vertices, [both, both, both, both, DVec2::ZERO]);
        averages.run(3);
        assert!(averages.of_vertices[..4].iter().all(|mean| mean.distance(both) < 1e-15));
        steps[2] = -DVec3::Z;
        assert_eq!(Averages::new(&topology, &steps).of_faces[0], DVec2::new(-1.0, 2.0) / 3.0);
        // Round by round over faces of different means: a third of the way between vertices 1 and 3 each time.
        (steps[2], steps[1]) = (DVec3::ZERO, DVec3::Z);
        let mut uneven = Averages::new(&topology, &steps);
        assert_eq!(
            uneven.of_vertices.iter().map(|mean| mean.y * 6.0).collect::<Vec<_>>(),
            [3.0, 4.0, 3.0, 2.0, 0.0]
        );
        uneven.run(1);
        assert!((uneven.of_vertices[1].y * 18.0 - 10.0).abs() < 1e-12, "(3 + 4 + 3) / 3");
    }

    #[test]
    fn even_noise_goes_whole_at_any_level() {
        for level in [0.001, 0.01, 0.03, 0.1, 0.7] {
            let (topology, before, after) = noisy_plane(level);
            let kept = keep_detail(&topology, &before, &after).expect("valid");
            let same = kept.iter().zip(&after).filter(|(k, a)| k == a).count();
            assert!(same * 100 > 98 * after.len(), "level {level}: {same} of {}", after.len());
        }
    }

    #[test]
    fn uneven_noise_goes_too() {
        let (topology, before, after) = noisy_plane(0.02);
        let uneven: Vec<DVec3> =
            before.iter().map(|v| DVec3::new(v.x, v.y, v.z * (v.x / 60.0).powi(2))).collect();
        let kept = keep_detail(&topology, &uneven, &after).expect("valid");
        let rms = |v: &[DVec3]| (v.iter().map(|v| v.z * v.z).sum::<f64>() / v.len() as f64).sqrt();
        assert!(rms(&kept) < 0.3 * rms(&uneven), "{} {}", rms(&kept), rms(&uneven));
    }

    #[test]
    fn a_ridge_comes_back_and_the_noise_around_it_does_not() {
        let (topology, before, after) = noisy_plane(0.005);
        let ridge = |v: &DVec3| (v.x - 30.0).abs() < 2.5;
        let raised: Vec<DVec3> =
            before.iter().map(|v| if ridge(v) { *v + DVec3::Z * 0.03 } else { *v }).collect();
        let kept = keep_detail(&topology, &raised, &after).expect("valid");
        for (k, r) in kept.iter().zip(&raised).filter(|(_, r)| ridge(r)) {
            assert!((k.z - r.z).abs() < 0.15 * r.z.abs(), "{k} {r}");
        }
        let far = |v: &&DVec3| (v.x - 30.0).abs() > 12.0;
        assert!(kept.iter().filter(far).all(|v| v.z.abs() < 0.002), "noise is gone elsewhere");
    }

    #[test]
    fn it_does_not_depend_on_scale_or_loose_vertices() {
        let (topology, before, _) = noisy_plane(0.01);
        let mut after = before.clone();
        after.iter_mut().enumerate().for_each(|(i, v)| v.z += 3e-5 * v.x * ((i * i) % 17) as f64);
        let kept = keep_detail(&topology, &before, &after).expect("valid");
        assert!(largest(&kept, &after) > 0.0);
        for scale in [1e-30, 1e30] {
            let [b, a] = [&before, &after].map(|v| v.iter().map(|v| *v * scale).collect::<Vec<_>>());
            let scaled = keep_detail(&topology, &b, &a).expect("valid");
            assert!(scaled.iter().zip(&kept).all(|(s, k)| (*s / scale).distance(*k) < 1e-12));
        }
        let [mut b, mut a] = [before.clone(), after.clone()];
        b.push(DVec3::splat(5.0));
        a.push(DVec3::splat(5.0));
        let more = Topology::new(topology.faces().to_vec(), b.len()).expect("valid");
        let with_loose = keep_detail(&more, &b, &a).expect("valid");
        assert_eq!(with_loose[..kept.len()], kept[..]);
        assert_eq!(with_loose[kept.len()], DVec3::splat(5.0));
    }

    #[test]
    fn what_has_no_size_stays_as_it_was_made_and_bad_input_is_named() {
        let point = vec![DVec3::ONE; 3];
        let topology = Topology::new(vec![[0, 1, 2]], 3).expect("valid");
        assert_eq!(keep_detail(&topology, &point, &point), Ok(point.clone()));
        let empty = Topology::new(vec![], 3).expect("valid");
        assert_eq!(keep_detail(&empty, &point, &point), Ok(point.clone()));
        let broken = [DVec3::ONE, DVec3::NAN, DVec3::ZERO];
        let named = Err(GeomError::NonFiniteVertex { vertex_id: 1 });
        assert_eq!(keep_detail(&topology, &broken, &point), named);
        assert_eq!(keep_detail(&topology, &point, &broken), named);
        assert!(keep_detail(&topology, &point[1..], &point).is_err());
    }
}
