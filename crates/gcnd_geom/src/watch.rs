//! Watching what takes long: how far it is, whether it goes astray, and stopping it.

use crate::error::{GeomError, Result, check_len};
use crate::mesh::check_vertices;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// A filter's iteration and how many there will be; returns whether to go on.
type Report<'a> = dyn FnMut(usize, usize) -> ControlFlow<()> + Send + 'a;

/// Hears of every iteration of a filter, or of other long work, and may stop it.
///
/// ```
/// use gcnd_geom::smoothing::{LaplacianParams, laplacian};
/// use gcnd_geom::{GeomError, Topology, Watch, fixtures};
/// use std::ops::ControlFlow;
/// let (vertices, faces) = fixtures::tetrahedron();
/// let topology = Topology::new(faces, vertices.len())?;
/// let mut stop_after_two = |iteration, _total| {
///     if iteration < 2 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
/// };
/// let watch = &mut Watch::new(&mut stop_after_two);
/// let result = laplacian(&topology, &vertices, &LaplacianParams::default(), watch);
/// assert_eq!(result, Err(GeomError::Cancelled { iteration: 2 }));
/// # Ok::<(), GeomError>(())
/// ```
#[derive(Default)]
pub struct Watch<'a> {
    report: Option<&'a mut Report<'a>>,
    /// Bytes that the work may still take; `None` for any.
    memory: Option<u64>,
}

impl<'a> Watch<'a> {
    /// Calls `report` after each iteration with its number, from 1, and the total of all steps. Where an iteration takes
    /// long, it may be called within as well, with the number of the last one that is done, 0 before the first.
    pub fn new(report: &'a mut Report<'a>) -> Self {
        Self { report: Some(report), memory: None }
    }

    /// Allows the work so many bytes: what would take more, and knows it before, ends with [`GeomError::OutOfMemory`].
    /// Linear systems do; `None` allows any.
    pub fn allow_memory(&mut self, bytes: Option<u64>) {
        self.memory = bytes;
    }

    /// Watches nothing; the filter runs to its end.
    pub fn silent() -> Self {
        Self::default()
    }
}

/// Counts the iterations of one piece of work for whoever watches it.
pub(crate) struct Ticks<'r, 'w> {
    watch: &'r mut Watch<'w>,
    total: usize,
    iteration: usize,
}

impl<'r, 'w> Ticks<'r, 'w> {
    /// Nothing is done yet of `total` iterations.
    pub fn new(total: usize, watch: &'r mut Watch<'w>) -> Self {
        Self { watch, total, iteration: 0 }
    }

    /// Counts an iteration.
    ///
    /// # Errors
    /// [`GeomError::Cancelled`] with its number when whoever watches does not want to go on.
    pub fn tick(&mut self) -> Result<()> {
        self.iteration += 1;
        self.ask()
    }

    /// Asks in the middle of an iteration.
    ///
    /// # Errors
    /// [`GeomError::Cancelled`] with the number of the last iteration that was done.
    pub fn ask(&mut self) -> Result<()> {
        let iteration = self.iteration;
        match self.watch.report.as_mut().map(|report| report(iteration, self.total)) {
            Some(ControlFlow::Break(())) => Err(GeomError::Cancelled { iteration }),
            _ => Ok(()),
        }
    }
}

/// Positions may leave the input's bounding box by so many times its longest side. What removes noise moves vertices by a
/// few edges; what goes on growing is to be told, not returned.
const ROOM: f64 = 1.0;

/// One filter at work on one mesh, in units in which the mesh is about 1 wide.
///
/// The unit is a power of two, so that changing to it and back is exact, and neither tiny nor huge meshes underflow
/// or overflow in areas and squared lengths.
pub(crate) struct Run<'r, 'w> {
    ticks: Ticks<'r, 'w>,
    /// Length in mesh units → length in the run's units.
    pub scale: f64,
    low: DVec3,
    high: DVec3,
}

impl<'r, 'w> Run<'r, 'w> {
    /// Checks a mesh and returns the run with the positions in its units.
    pub fn start(
        topology: &Topology,
        vertices: &[DVec3],
        total: usize,
        watch: &'r mut Watch<'w>,
    ) -> Result<(Self, Vec<DVec3>)> {
        check_len("vertices", topology.n_vertices(), vertices.len())?;
        check_vertices(vertices)?;
        let start = vertices.first().copied().unwrap_or_default();
        let low = vertices.iter().copied().fold(start, DVec3::min);
        let high = vertices.iter().copied().fold(start, DVec3::max);
        let scale = unit_scale((high - low).max_element());
        let (low, high) = (low * scale, high * scale);
        let room = DVec3::splat(ROOM * (high - low).max_element());
        // Beyond it, positions would be infinite in mesh units.
        let most = DVec3::splat(f64::MAX * scale);
        let (low, high) = ((low - room).max(-most), (high + room).min(most));
        let positions = vertices.iter().map(|v| *v * scale).collect();
        let ticks = Ticks::new(total, watch);
        Ok((Self { ticks, scale, low, high }, positions))
    }

    /// Takes so many bytes of what the work may take.
    ///
    /// # Errors
    /// [`GeomError::OutOfMemory`] if less is left.
    pub fn claim(&mut self, needed: u64) -> Result<()> {
        let Some(free) = self.ticks.watch.memory else { return Ok(()) };
        self.ticks.watch.memory =
            Some(free.checked_sub(needed).ok_or(GeomError::OutOfMemory { needed, free })?);
        Ok(())
    }

    /// Asks in the middle of an iteration whether to go on.
    pub fn ask(&mut self) -> Result<()> {
        self.ticks.ask()
    }

    /// Counts an iteration that changed no positions.
    pub fn tick(&mut self) -> Result<()> {
        self.ticks.tick()
    }

    /// Counts an iteration, and stops if one of its normals is no longer a number.
    pub fn tick_normals(&mut self, normals: &[DVec3]) -> Result<()> {
        if !normals.par_iter().with_min_len(1 << 14).all(|n| n.is_finite()) {
            return Err(self.diverged());
        }
        self.tick()
    }

    /// Counts an iteration, and stops if its positions are out of all bounds.
    pub fn tick_positions(&mut self, positions: &[DVec3]) -> Result<()> {
        self.check_positions(positions)?;
        self.tick()
    }

    /// Stops if positions of the iteration at work are out of all bounds.
    pub fn check_positions(&self, positions: &[DVec3]) -> Result<()> {
        let (low, high) = (self.low, self.high);
        let is_inside = |p: &DVec3| p.cmpge(low).all() && p.cmple(high).all();
        if positions.par_iter().with_min_len(1 << 14).all(is_inside) { Ok(()) } else { Err(self.diverged()) }
    }

    /// What to return when the iteration at work cannot go on.
    pub fn diverged(&self) -> GeomError {
        GeomError::Diverged { iteration: self.ticks.iteration + 1 }
    }

    /// The positions in mesh units.
    pub fn finish(self, mut positions: Vec<DVec3>) -> Vec<DVec3> {
        for p in &mut positions {
            *p /= self.scale;
        }
        positions
    }
}

/// The power of two that brings `extent` into [1, 2), as far as doubles reach; 1 for no extent.
fn unit_scale(extent: f64) -> f64 {
    if extent > 0.0 { (-extent.log2().floor()).clamp(-1000.0, 1000.0).exp2() } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn started(scale: f64) -> (Topology, Vec<DVec3>) {
        let (vertices, faces) = fixtures::cube();
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        (topology, vertices.into_iter().map(|v| v * scale + DVec3::splat(scale / 3.0)).collect())
    }

    #[test]
    fn changing_units_and_back_is_exact() {
        for scale in [1e-290, 1e-3, 1.0, 3.0, 1e150, 1e300] {
            let (topology, vertices) = started(scale);
            let mut watch = Watch::silent();
            let (run, positions) = Run::start(&topology, &vertices, 0, &mut watch).expect("valid");
            let extent = (positions[7] - positions[0]).max_element();
            assert!((1.0..2.0).contains(&extent), "{scale}: {extent}");
            assert_eq!(run.finish(positions), vertices, "{scale}");
        }
    }

    #[test]
    fn leaving_the_bounds_is_told_with_the_iteration() {
        let (topology, vertices) = started(1.0);
        for bad in [DVec3::NAN, DVec3::splat(2.5), DVec3::NEG_INFINITY] {
            let mut watch = Watch::silent();
            let (mut run, mut positions) = Run::start(&topology, &vertices, 5, &mut watch).expect("valid");
            assert_eq!(run.tick_positions(&positions), Ok(()));
            positions[3] = bad;
            assert_eq!(run.tick_positions(&positions), Err(GeomError::Diverged { iteration: 2 }));
        }
        let mut watch = Watch::silent();
        let (mut run, mut normals) = Run::start(&topology, &vertices, 5, &mut watch).expect("valid");
        assert_eq!(run.tick_normals(&normals), Ok(()));
        normals[2].z = f64::NAN;
        assert_eq!(run.tick_normals(&normals), Err(GeomError::Diverged { iteration: 2 }));
    }

    #[test]
    fn nothing_beyond_the_largest_number_is_returned() {
        let (topology, mut vertices) = started(1e-3);
        vertices[7] = DVec3::splat(f64::MAX);
        let mut watch = Watch::silent();
        let (run, mut positions) = Run::start(&topology, &vertices, 5, &mut watch).expect("valid");
        assert_eq!(run.check_positions(&positions), Ok(()));
        positions[7] *= 1.001;
        assert_eq!(run.check_positions(&positions), Err(GeomError::Diverged { iteration: 1 }));
    }

    #[test]
    fn memory_is_claimed_up_to_what_is_allowed() {
        let (topology, vertices) = started(1.0);
        let mut watch = Watch::silent();
        watch.allow_memory(Some(100));
        let (mut run, _) = Run::start(&topology, &vertices, 0, &mut watch).expect("valid");
        assert_eq!(run.claim(60), Ok(()));
        assert_eq!(run.claim(41), Err(GeomError::OutOfMemory { needed: 41, free: 40 }));
        assert_eq!(run.claim(40), Ok(()));
        let (mut watch, most) = (Watch::silent(), u64::MAX);
        let (mut run, _) = Run::start(&topology, &vertices, 0, &mut watch).expect("valid");
        assert_eq!((run.claim(most), run.claim(most)), (Ok(()), Ok(())));
    }

    #[test]
    fn every_iteration_is_reported() {
        let (topology, vertices) = started(1.0);
        let mut seen = Vec::new();
        let mut report = |iteration, total| {
            seen.push((iteration, total));
            ControlFlow::Continue(())
        };
        let mut watch = Watch::new(&mut report);
        let (mut run, positions) = Run::start(&topology, &vertices, 2, &mut watch).expect("valid");
        run.tick().expect("goes on");
        run.tick_positions(&positions).expect("goes on");
        assert_eq!(seen, [(1, 2), (2, 2)]);
    }
}
