//! The classical filters: one function each, positions in, positions out, stopped by Ctrl-C or by their callback.

use crate::arrays::{self, Points};
use crate::mesh::PyTopology;
use crate::watched::watched;
use gcnd_geom::normals::{
    BilateralNormalParams, FastEffectiveParams, GuidedNormalParams, ImplicitNormalParams, LowRankParams,
    TgvParams,
};
use gcnd_geom::smoothing::{BilateralMeshParams, HcLaplacianParams, L0Params, LaplacianParams, TaubinParams};
use gcnd_geom::{DVec3, Topology, Watch, normals, smoothing};
use numpy::PyArray2;
use pyo3::prelude::*;
use std::f64::consts::SQRT_2;

type Positions<'py> = PyResult<Bound<'py, PyArray2<f64>>>;
type Filter<P> = fn(&Topology, &[DVec3], &P, &mut Watch<'_>) -> gcnd_geom::Result<Vec<DVec3>>;

fn run<'py, P: Sync>(
    py: Python<'py>,
    filter: Filter<P>,
    topology: &PyTopology,
    vertices: &Points<'py>,
    params: &P,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    run_within(py, filter, topology, vertices, params, progress, None)
}

/// As [`run`], with so many bytes of memory for what can tell before what it will take.
fn run_within<'py, P: Sync>(
    py: Python<'py>,
    filter: Filter<P>,
    topology: &PyTopology,
    vertices: &Points<'py>,
    params: &P,
    progress: Option<Py<PyAny>>,
    memory: Option<u64>,
) -> Positions<'py> {
    let vertices = arrays::points("vertices", vertices)?;
    let topology = &topology.inner;
    let work = |watch: &mut Watch<'_>| {
        watch.allow_memory(memory);
        filter(topology, vertices, params, watch)
    };
    arrays::triples(py, watched(py, progress, work)?)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, sigma_r=0.35, sigma_s=None, normal_iterations=20,
                    vertex_iterations=20, fix_boundary=true, progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn bilateral_normal<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    sigma_r: f64,
    sigma_s: Option<f64>,
    normal_iterations: usize,
    vertex_iterations: usize,
    fix_boundary: bool,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params =
        BilateralNormalParams { sigma_r, sigma_s, normal_iterations, vertex_iterations, fix_boundary };
    run(py, normals::bilateral_normal, topology, &vertices, &params, progress)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, sigma_r=0.35, sigma_s=None, smoothness=0.01,
                    vertex_iterations=20, fix_boundary=true, memory=None, progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn bilateral_normal_implicit<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    sigma_r: f64,
    sigma_s: Option<f64>,
    smoothness: f64,
    vertex_iterations: usize,
    fix_boundary: bool,
    memory: Option<u64>,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params = ImplicitNormalParams { sigma_r, sigma_s, smoothness, vertex_iterations, fix_boundary };
    run_within(py, normals::bilateral_normal_implicit, topology, &vertices, &params, progress, memory)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, sigma_r=0.35, sigma_s=None, radius=2.0, normal_iterations=20,
                    vertex_iterations=20, fix_boundary=false, progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn guided_normal<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    sigma_r: f64,
    sigma_s: Option<f64>,
    radius: f64,
    normal_iterations: usize,
    vertex_iterations: usize,
    fix_boundary: bool,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params =
        GuidedNormalParams { sigma_r, sigma_s, radius, normal_iterations, vertex_iterations, fix_boundary };
    run(py, normals::guided_normal, topology, &vertices, &params, progress)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, threshold=0.5, normal_iterations=20, vertex_iterations=50,
                    fix_boundary=true, progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn fast_effective<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    threshold: f64,
    normal_iterations: usize,
    vertex_iterations: usize,
    fix_boundary: bool,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params = FastEffectiveParams { threshold, normal_iterations, vertex_iterations, fix_boundary };
    run(py, normals::fast_effective, topology, &vertices, &params, progress)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, sigma_m=0.2, similar_patches=10, patch_size=50, search_rings=10,
                    normal_iterations=1, vertex_iterations=10, fix_boundary=false, fixed_step=false, progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn low_rank<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    sigma_m: f64,
    similar_patches: usize,
    patch_size: usize,
    search_rings: usize,
    normal_iterations: usize,
    vertex_iterations: usize,
    fix_boundary: bool,
    fixed_step: bool,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params = LowRankParams {
        sigma_m,
        similar_patches,
        patch_size,
        search_rings,
        normal_iterations,
        vertex_iterations,
        fix_boundary,
        fixed_step,
    };
    run(py, normals::low_rank, topology, &vertices, &params, progress)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, alpha1=1.0, alpha0=0.5, beta=2.5, normal_iterations=50,
                    vertex_iterations=20, fix_boundary=false, memory=None, progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn tgv<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    alpha1: f64,
    alpha0: f64,
    beta: f64,
    normal_iterations: usize,
    vertex_iterations: usize,
    fix_boundary: bool,
    memory: Option<u64>,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params = TgvParams { alpha1, alpha0, beta, normal_iterations, vertex_iterations, fix_boundary };
    run_within(py, normals::tgv, topology, &vertices, &params, progress, memory)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, iterations=5, progress=None))]
pub fn bilateral_mesh<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    iterations: usize,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    run(py, smoothing::bilateral_mesh, topology, &vertices, &BilateralMeshParams { iterations }, progress)
}

#[pyfunction]
// pyo3 by itself can tell Python literals alone.
#[pyo3(
    signature = (topology, vertices, *, lambda_=None, alpha=None, mu_alpha=0.5, beta=0.001, beta_max=1000.0,
                 mu_beta=SQRT_2, memory=None, progress=None),
    text_signature = "(topology, vertices, *, lambda_=None, alpha=None, mu_alpha=0.5, beta=0.001, beta_max=1000.0, \
                      mu_beta=1.4142135623730951, memory=None, progress=None)"
)]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn l0<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    lambda_: Option<f64>,
    alpha: Option<f64>,
    mu_alpha: f64,
    beta: f64,
    beta_max: f64,
    mu_beta: f64,
    memory: Option<u64>,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params = L0Params { lambda: lambda_, alpha, mu_alpha, beta, beta_max, mu_beta };
    run_within(py, smoothing::l0, topology, &vertices, &params, progress, memory)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, lambda_=0.5, iterations=10, fix_boundary=true, progress=None))]
pub fn laplacian<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    lambda_: f64,
    iterations: usize,
    fix_boundary: bool,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params = LaplacianParams { lambda: lambda_, iterations, fix_boundary };
    run(py, smoothing::laplacian, topology, &vertices, &params, progress)
}

#[pyfunction]
// pyo3 by itself does not tell Python negative defaults.
#[pyo3(
    signature = (topology, vertices, *, lambda_=0.5, mu=-0.53, iterations=10, fix_boundary=true, progress=None),
    text_signature = "(topology, vertices, *, lambda_=0.5, mu=-0.53, iterations=10, fix_boundary=True, progress=None)"
)]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn taubin<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    lambda_: f64,
    mu: f64,
    iterations: usize,
    fix_boundary: bool,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params = TaubinParams { lambda: lambda_, mu, iterations, fix_boundary };
    run(py, smoothing::taubin, topology, &vertices, &params, progress)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, alpha=0.1, beta=0.5, iterations=10, fix_boundary=true,
                    progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn hc_laplacian<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    alpha: f64,
    beta: f64,
    iterations: usize,
    fix_boundary: bool,
    progress: Option<Py<PyAny>>,
) -> Positions<'py> {
    let params = HcLaplacianParams { alpha, beta, iterations, fix_boundary };
    run(py, smoothing::hc_laplacian, topology, &vertices, &params, progress)
}
