//! Validation, welding, adjacency and face geometry.

use crate::arrays::{self, Faces, Points};
use crate::errors::IntoPython;
use gcnd_geom::face_geometry::FaceGeometry;
use gcnd_geom::orientation::Orientation;
use gcnd_geom::{DVec3, Topology, mesh, orientation, spikes};
use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;
use std::sync::Arc;

#[pyclass(name = "Topology", module = "gcnd._geom", frozen)]
pub struct PyTopology {
    pub inner: Arc<Topology>,
}

#[pymethods]
impl PyTopology {
    #[new]
    fn new(py: Python<'_>, faces: Faces<'_>, n_vertices: usize) -> PyResult<Self> {
        let faces = arrays::faces(&faces)?.to_vec();
        let inner = py.detach(|| Topology::new(faces, n_vertices)).into_python()?;
        Ok(Self { inner: Arc::new(inner) })
    }

    #[getter]
    fn n_faces(&self) -> usize {
        self.inner.n_faces()
    }

    #[getter]
    fn n_vertices(&self) -> usize {
        self.inner.n_vertices()
    }

    fn edge_neighbors<'py>(&self, py: Python<'py>) -> (Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<u32>>) {
        let rows = self.inner.edge_neighbor_rows();
        (rows.offsets().to_vec().into_pyarray(py), rows.values().to_vec().into_pyarray(py))
    }

    fn vertex_faces<'py>(&self, py: Python<'py>) -> (Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<u32>>) {
        let rows = self.inner.vertex_faces();
        (rows.offsets().to_vec().into_pyarray(py), rows.values().to_vec().into_pyarray(py))
    }
}

type OrientationArrays<'py> = (Bound<'py, PyArray1<bool>>, usize, usize, usize);

#[pyfunction]
pub fn orient<'py>(py: Python<'py>, topology: &PyTopology) -> OrientationArrays<'py> {
    let Orientation { is_turned, disagreeing_edges, edges_left, one_sided_components } =
        py.detach(|| orientation::orientation(&topology.inner));
    (is_turned.into_pyarray(py), disagreeing_edges, edges_left, one_sided_components)
}

type SpikeArrays<'py> = (Bound<'py, PyArray1<u32>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>);

#[pyfunction]
pub fn find_spikes<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
) -> PyResult<SpikeArrays<'py>> {
    let vertices = arrays::points("vertices", &vertices)?;
    let found = py.detach(|| spikes::find_spikes(&topology.inner, vertices)).into_python()?;
    let ids: Vec<u32> = found.iter().map(|spike| spike.vertex_id).collect();
    let feet: Vec<DVec3> = found.iter().map(|spike| spike.foot).collect();
    let is_on_rim: Vec<bool> = found.iter().map(|spike| spike.is_on_rim).collect();
    Ok((ids.into_pyarray(py), arrays::triples(py, feet)?, is_on_rim.into_pyarray(py)))
}

#[pyfunction]
pub fn validate(py: Python<'_>, vertices: Points<'_>, faces: Faces<'_>) -> PyResult<()> {
    let (vertices, faces) = (arrays::points("vertices", &vertices)?, arrays::faces(&faces)?);
    py.detach(|| mesh::validate(vertices, faces)).into_python()
}

type WeldArrays<'py> = (Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<u32>>);

#[pyfunction]
pub fn weld<'py>(py: Python<'py>, vertices: Points<'py>) -> PyResult<WeldArrays<'py>> {
    let vertices = arrays::points("vertices", &vertices)?;
    let weld = py.detach(|| mesh::weld(vertices));
    Ok((weld.representatives.into_pyarray(py), weld.welded_from_input.into_pyarray(py)))
}

type GeometryArrays<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>);

#[pyfunction]
pub fn face_geometry<'py>(
    py: Python<'py>,
    vertices: Points<'py>,
    faces: Faces<'py>,
) -> PyResult<GeometryArrays<'py>> {
    let (vertices, faces) = (arrays::points("vertices", &vertices)?, arrays::faces(&faces)?);
    let geometry = py
        .detach(|| mesh::check_faces(faces, vertices.len()).map(|()| FaceGeometry::compute(vertices, faces)))
        .into_python()?;
    Ok((
        arrays::triples(py, geometry.normals)?,
        arrays::triples(py, geometry.centroids)?,
        geometry.areas.into_pyarray(py),
    ))
}
