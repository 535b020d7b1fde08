//! Normal refinement, vertex updating, metrics and remeshing.

use crate::arrays::{self, Faces, Points};
use crate::errors::{ConfigError, IntoPython};
use crate::mesh::PyTopology;
use crate::watched::watched;
use gcnd_geom::normals::{AdaptiveParams, Neighborhood, RefineParams};
use gcnd_geom::remesh::RemeshParams;
use gcnd_geom::vertex_fit;
use gcnd_geom::vertex_update::{self, Boundary};
use gcnd_geom::{face_geometry, metrics, normals};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1};
use pyo3::prelude::*;

fn neighborhood_from(name: &str, radius: f64) -> PyResult<Neighborhood> {
    match name {
        "shared_vertex" => Ok(Neighborhood::SharedVertex),
        "shared_edge" => Ok(Neighborhood::SharedEdge),
        "radius" => Ok(Neighborhood::Radius { multiple: radius }),
        _ => Err(ConfigError::new_err(format!(
            "neighborhood is {name}, allowed: shared_vertex, shared_edge or radius"
        ))),
    }
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, normals, *, iterations, sigma_r=0.3, sigma_s=None,
                    neighborhood="shared_vertex", radius=2.0, progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn refine_normals<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    normals: Points<'py>,
    iterations: usize,
    sigma_r: f64,
    sigma_s: Option<f64>,
    neighborhood: &str,
    radius: f64,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let params =
        RefineParams { iterations, sigma_s, sigma_r, neighborhood: neighborhood_from(neighborhood, radius)? };
    let (vertices, input) = (arrays::points("vertices", &vertices)?, arrays::points("normals", &normals)?);
    let topology = &topology.inner;
    let refined =
        watched(py, progress, |watch| normals::refine_normals(topology, vertices, input, &params, watch))?;
    arrays::triples(py, refined)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, normals, spread, *, iterations, tolerance, sigma_r=0.3, region_rounds=20,
                    progress=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
pub fn refine_consistent<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    normals: Points<'py>,
    spread: PyReadonlyArray1<'py, f64>,
    iterations: usize,
    tolerance: f64,
    sigma_r: f64,
    region_rounds: usize,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let refine = RefineParams { iterations, sigma_r, ..RefineParams::default() };
    let params = AdaptiveParams { refine, tolerance, region_rounds };
    let (vertices, input) = (arrays::points("vertices", &vertices)?, arrays::points("normals", &normals)?);
    let (topology, spread) = (&topology.inner, spread.as_slice()?);
    let refined = watched(py, progress, |watch| {
        normals::refine_consistent(topology, vertices, input, spread, &params, watch)
    })?;
    arrays::triples(py, refined)
}

fn boundary_from(name: &str) -> PyResult<Boundary> {
    match name {
        "free" => Ok(Boundary::Free),
        "along" => Ok(Boundary::Along),
        "fixed" => Ok(Boundary::Fixed),
        _ => Err(ConfigError::new_err(format!("boundary is {name}, allowed: free, along or fixed"))),
    }
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, normals, iterations, boundary="free", *, progress=None))]
#[allow(clippy::too_many_arguments, reason = "arguments of the Python signature")]
pub fn update_vertices<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    normals: Points<'py>,
    iterations: usize,
    boundary: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let boundary = boundary_from(boundary)?;
    let (vertices, normals) = (arrays::points("vertices", &vertices)?, arrays::points("normals", &normals)?);
    let topology = &topology.inner;
    let updated = watched(py, progress, |watch| {
        vertex_update::update_vertices(topology, vertices, normals, iterations, boundary, watch)
    })?;
    arrays::triples(py, updated)
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, normals, first, boundary="free", *, pull=0.0026, progress=None))]
#[allow(clippy::too_many_arguments, reason = "arguments of the Python signature")]
pub fn fit_vertices<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    normals: Points<'py>,
    first: Points<'py>,
    boundary: &str,
    pull: f64,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let boundary = boundary_from(boundary)?;
    let (vertices, normals) = (arrays::points("vertices", &vertices)?, arrays::points("normals", &normals)?);
    let (topology, first) = (&topology.inner, arrays::points("first", &first)?);
    let fitted = watched(py, progress, |watch| {
        vertex_fit::fit_vertices(topology, vertices, normals, first, pull, boundary, watch)
    })?;
    arrays::triples(py, fitted)
}

#[pyfunction]
pub fn keep_detail<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    before: Points<'py>,
    after: Points<'py>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (before, after) = (arrays::points("before", &before)?, arrays::points("after", &after)?);
    let kept =
        py.detach(|| gcnd_geom::keep_detail::keep_detail(&topology.inner, before, after)).into_python()?;
    arrays::triples(py, kept)
}

#[pyfunction]
pub fn normal_angles<'py>(
    py: Python<'py>,
    result: Points<'py>,
    truth: Points<'py>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (result, truth) = (arrays::points("result", &result)?, arrays::points("truth", &truth)?);
    Ok(py.detach(|| metrics::angles(result, truth)).into_python()?.into_pyarray(py))
}

#[pyfunction]
pub fn vertex_error(
    py: Python<'_>,
    result_vertices: Points<'_>,
    result_faces: Faces<'_>,
    truth_vertices: Points<'_>,
    truth_faces: Faces<'_>,
    samples: usize,
    seed: u64,
) -> PyResult<f64> {
    let result = (arrays::points("result_vertices", &result_vertices)?, arrays::faces(&result_faces)?);
    let truth = (arrays::points("truth_vertices", &truth_vertices)?, arrays::faces(&truth_faces)?);
    py.detach(|| metrics::vertex_error(result.0, result.1, truth.0, truth.1, samples, seed)).into_python()
}

#[pyfunction]
pub fn mean_edge_length(py: Python<'_>, vertices: Points<'_>, faces: Faces<'_>) -> PyResult<f64> {
    let (vertices, faces) = (arrays::points("vertices", &vertices)?, arrays::faces(&faces)?);
    py.detach(|| {
        gcnd_geom::mesh::check_faces(faces, vertices.len())
            .map(|()| face_geometry::mean_edge_length(vertices, faces))
    })
    .into_python()
}

type MeshArrays<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u32>>);

#[pyfunction]
#[pyo3(signature = (vertices, faces, target_edge_length, *, feature_angle_deg=30.0, iterations=10, sizes=None))]
pub fn remesh<'py>(
    py: Python<'py>,
    vertices: Points<'py>,
    faces: Faces<'py>,
    target_edge_length: f64,
    feature_angle_deg: f64,
    iterations: usize,
    sizes: Option<PyReadonlyArray1<'py, f64>>,
) -> PyResult<MeshArrays<'py>> {
    let params = RemeshParams { target_edge_length, feature_angle_deg, iterations };
    let (vertices, faces) = (arrays::points("vertices", &vertices)?, arrays::faces(&faces)?);
    let sizes = sizes.as_ref().map(|sizes| sizes.as_slice()).transpose()?;
    let (vertices, faces) = py
        .detach(|| match sizes {
            Some(sizes) => gcnd_geom::remesh::remesh_with_sizes(vertices, faces, sizes, &params),
            None => gcnd_geom::remesh::remesh(vertices, faces, &params),
        })
        .into_python()?;
    Ok((arrays::triples(py, vertices)?, arrays::triples(py, faces)?))
}
