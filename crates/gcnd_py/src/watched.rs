//! Long work of the core, stopped by Ctrl-C or by a Python callback.

use crate::errors::IntoPython;
use gcnd_geom::Watch;
use pyo3::prelude::*;
use std::ops::ControlFlow;

/// Runs `work` without the GIL, which it takes after each iteration to ask whether to go on.
///
/// `progress` is called with (iteration, total); what it raises stops the work and is raised here.
pub fn watched<T: Send>(
    py: Python<'_>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(&mut Watch<'_>) -> gcnd_geom::Result<T> + Send,
) -> PyResult<T> {
    let mut raised = None;
    let result = py.detach(|| {
        let mut report = |iteration: usize, total: usize| {
            let told = Python::attach(|py| {
                py.check_signals()?;
                progress.as_ref().map_or(Ok(()), |call| call.call1(py, (iteration, total)).map(drop))
            });
            match told {
                Ok(()) => ControlFlow::Continue(()),
                Err(error) => {
                    raised = Some(error);
                    ControlFlow::Break(())
                }
            }
        };
        work(&mut Watch::new(&mut report))
    });
    raised.map_or_else(|| result.into_python(), Err)
}
