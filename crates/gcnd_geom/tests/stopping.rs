//! Stopping long work: whoever watches is asked after every step, and nothing is done after a no.

use gcnd_geom::face_geometry::FaceGeometry;
use gcnd_geom::fixtures;
use gcnd_geom::normals::{
    AdaptiveParams, ImplicitNormalParams, RefineParams, TgvParams, bilateral_normal_implicit,
    refine_consistent, refine_normals, tgv,
};
use gcnd_geom::patch::{PatchExtractor, PatchParams};
use gcnd_geom::smoothing::{L0Params, l0};
use gcnd_geom::vertex_fit::{self, fit_vertices};
use gcnd_geom::vertex_update::{Boundary, update_vertices};
use gcnd_geom::{DVec3, GeomError, Result, Topology, Watch};
use std::ops::ControlFlow;

/// Stops `work` at each of its steps in turn, and checks that all steps are told and none after the stop.
fn assert_stops_anywhere(steps: usize, work: impl Fn(&mut Watch<'_>) -> Result<()>) {
    for last in 1..=steps + 1 {
        let mut told = Vec::new();
        let mut report = |iteration, total| {
            told.push((iteration, total));
            if iteration < last { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let result = work(&mut Watch::new(&mut report));
        let expected = if last > steps { Ok(()) } else { Err(GeomError::Cancelled { iteration: last }) };
        assert_eq!(result, expected);
        let all: Vec<_> = (1..=last.min(steps)).map(|iteration| (iteration, steps)).collect();
        assert_eq!(told, all);
    }
}

struct Noisy {
    topology: Topology,
    vertices: Vec<DVec3>,
    normals: Vec<DVec3>,
}

fn noisy() -> Noisy {
    let (mut vertices, faces) = fixtures::icosphere(3);
    fixtures::jitter(&mut vertices, 0.02, 7);
    let normals = FaceGeometry::compute(&vertices, &faces).normals;
    Noisy { topology: Topology::new(faces, vertices.len()).expect("valid"), vertices, normals }
}

#[test]
fn the_implicit_scheme_asks_after_every_step_of_its_solver() {
    let Noisy { topology, vertices, .. } = noisy();
    let params = ImplicitNormalParams { vertex_iterations: 0, ..ImplicitNormalParams::default() };
    let told_until = |last: usize| {
        let mut told = Vec::new();
        let mut report = |iteration, total| {
            told.push((iteration, total));
            if told.len() < last { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let result = bilateral_normal_implicit(&topology, &vertices, &params, &mut Watch::new(&mut report));
        (told, result.map(drop))
    };
    let (all, result) = told_until(usize::MAX);
    assert_eq!(result, Ok(()));
    let steps: Vec<usize> =
        (0..3).map(|axis| all.iter().filter(|told| **told == (axis, 3)).count()).collect();
    assert!(steps.iter().all(|n| *n > 10), "{steps:?}");
    for last in [1, 7, steps[0] + 3] {
        let (told, result) = told_until(last);
        assert_eq!(told, all[..last]);
        assert_eq!(result, Err(GeomError::Cancelled { iteration: all[last - 1].0 }));
    }
}

#[test]
fn total_generalised_variation_asks_around_its_factorisations() {
    let Noisy { topology, vertices, .. } = noisy();
    for (normal_iterations, steps) in [(0, 2), (1, 7), (3, 9)] {
        let params = TgvParams { normal_iterations, vertex_iterations: 2, ..TgvParams::default() };
        assert_stops_anywhere(steps, |watch| tgv(&topology, &vertices, &params, watch).map(drop));
    }
}

#[test]
fn factors_larger_than_is_allowed_are_not_made() {
    let Noisy { topology, vertices, .. } = noisy();
    type Run = fn(&Topology, &[DVec3], &mut Watch<'_>) -> Result<Vec<DVec3>>;
    let filters: [Run; 2] =
        [|t, v, w| l0(t, v, &L0Params::default(), w), |t, v, w| tgv(t, v, &TgvParams::default(), w)];
    for run in filters {
        let allowed = |bytes| {
            let mut watch = Watch::silent();
            watch.allow_memory(bytes);
            run(&topology, &vertices, &mut watch)
        };
        let whole = allowed(None).expect("valid");
        assert_eq!(allowed(Some(1 << 30)), Ok(whole.clone()));
        let Err(GeomError::OutOfMemory { needed, free: 1000 }) = allowed(Some(1000)) else {
            panic!("1000 bytes are enough")
        };
        // 642 vertices or 1280 faces have that many entries on the diagonal alone.
        assert!((642 * 8..1 << 24).contains(&needed), "{needed}");
        // With the first one, and no more, the second system of `tgv` is not made.
        let result = allowed(Some(needed));
        assert!(result == Ok(whole) || matches!(result, Err(GeomError::OutOfMemory { free: 0, .. })));
    }
}

#[test]
fn refinement_asks_after_its_weights_and_every_iteration() {
    let Noisy { topology, vertices, normals } = noisy();
    for (iterations, steps) in [(0, 0), (1, 2), (12, 13)] {
        let params = RefineParams { iterations, ..RefineParams::default() };
        assert_stops_anywhere(steps, |watch| {
            refine_normals(&topology, &vertices, &normals, &params, watch).map(drop)
        });
    }
}

#[test]
fn consistent_refinement_asks_in_its_averages_too() {
    let Noisy { topology, vertices, normals } = noisy();
    let spread = vec![0.01; normals.len()];
    for (iterations, steps) in [(0, 10), (3, 14)] {
        let refine = RefineParams { iterations, ..RefineParams::default() };
        let params = AdaptiveParams { refine, tolerance: 1.0, region_rounds: 5 };
        assert_stops_anywhere(steps, |watch| {
            refine_consistent(&topology, &vertices, &normals, &spread, &params, watch).map(drop)
        });
    }
}

#[test]
fn vertex_updating_asks_after_every_iteration() {
    let Noisy { topology, vertices, normals } = noisy();
    for iterations in [0, 15] {
        assert_stops_anywhere(iterations, |watch| {
            update_vertices(&topology, &vertices, &normals, iterations, Boundary::Along, watch).map(drop)
        });
    }
}

#[test]
fn fitting_vertices_asks_after_every_step() {
    let Noisy { topology, vertices, normals } = noisy();
    assert_stops_anywhere(vertex_fit::ITERATIONS, |watch| {
        fit_vertices(&topology, &vertices, &normals, &vertices, vertex_fit::PULL, Boundary::Along, watch)
            .map(drop)
    });
}

#[test]
fn preparing_patches_asks_after_the_geometry_the_tree_and_every_smoothing() {
    let Noisy { topology, vertices, .. } = noisy();
    for (scale_space, first_normals, steps) in
        [(false, false, 2), (true, false, 18), (false, true, 6), (true, true, 22)]
    {
        let params = PatchParams { scale_space, first_normals, ..PatchParams::default() };
        assert_stops_anywhere(steps, |watch| {
            PatchExtractor::watched(&topology, &vertices, &vertices, params, watch).map(drop)
        });
    }
}
