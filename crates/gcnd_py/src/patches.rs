//! Patch extraction, covering and averaging.

use crate::arrays::{self, Points, slice, slice_mut};
use crate::errors::{ConfigError, IntoPython};
use crate::mesh::PyTopology;
use crate::watched::watched;
use gcnd_geom::flatness;
use gcnd_geom::patch::{
    self, Budget, Cover, NormalAccumulator, PatchBuffers, PatchExtractor, PatchParams, ROUGHNESS_QUANTILES,
    Sheets, VotingRegion,
};
use gcnd_geom::{DVec3, Topology};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArrayDyn, PyReadwriteArrayDyn,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use std::sync::{Arc, Mutex};

struct Mesh {
    topology: Arc<Topology>,
    vertices: Vec<DVec3>,
}

self_cell::self_cell!(
    struct ExtractorCell {
        owner: Mesh,
        #[covariant]
        dependent: PatchExtractor,
    }
);

#[pyclass(name = "PatchExtractor", module = "gcnd._geom", frozen)]
pub struct PyPatchExtractor {
    cell: ExtractorCell,
}

fn voting_region_from(name: &str) -> PyResult<VotingRegion> {
    match name {
        "patch" => Ok(VotingRegion::Patch),
        "two_ring" => Ok(VotingRegion::TwoRing),
        "nobody" => Ok(VotingRegion::Nobody),
        _ => {
            Err(ConfigError::new_err(format!("voting_region is {name}, allowed: patch, two_ring or nobody")))
        }
    }
}

fn sheets_from(name: &str) -> PyResult<Sheets> {
    match name {
        "all" => Ok(Sheets::All),
        "one" => Ok(Sheets::One),
        _ => Err(ConfigError::new_err(format!("sheets is {name}, allowed: all or one"))),
    }
}

fn budget_from(name: &str, seed: u64) -> PyResult<Budget> {
    match name {
        "nearest" => Ok(Budget::NearestFirst),
        "random" => Ok(Budget::Random { seed }),
        _ => Err(ConfigError::new_err(format!("budget is {name}, allowed: nearest or random"))),
    }
}

fn roughness_from(values: PyReadonlyArray1<'_, f64>) -> PyResult<[f64; ROUGHNESS_QUANTILES.len()]> {
    let values = values.as_array().to_vec();
    let n = values.len();
    values.try_into().map_err(|_| {
        let allowed = ROUGHNESS_QUANTILES.len();
        ConfigError::new_err(format!("roughness has {n} values, allowed: {allowed}"))
    })
}

#[pymethods]
impl PyPatchExtractor {
    #[new]
    #[pyo3(signature = (topology, vertices, *, patch_scale=4.0, sheets="all", n_nodes=64, budget="nearest", seed=0,
                        voting_region="patch", sigma_vote=1.0 / 3.0, vertex_offsets=true,
                        scale_space=false, first=None, roughness=None, progress=None))]
    #[allow(clippy::too_many_arguments, reason = "keyword arguments of the Python signature")]
    fn new(
        py: Python<'_>,
        topology: &PyTopology,
        vertices: Points<'_>,
        patch_scale: f64,
        sheets: &str,
        n_nodes: usize,
        budget: &str,
        seed: u64,
        voting_region: &str,
        sigma_vote: f64,
        vertex_offsets: bool,
        scale_space: bool,
        first: Option<Points<'_>>,
        roughness: Option<PyReadonlyArray1<'_, f64>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let params = PatchParams {
            patch_scale,
            sheets: sheets_from(sheets)?,
            n_nodes,
            budget: budget_from(budget, seed)?,
            voting_region: voting_region_from(voting_region)?,
            sigma_vote,
            vertex_offsets,
            scale_space,
            first_normals: first.is_some(),
            roughness: roughness.map(roughness_from).transpose()?,
        };
        let vertices = arrays::points("vertices", &vertices)?.to_vec();
        let first = first.as_ref().map(|first| arrays::points("first", first)).transpose()?;
        let mesh = Mesh { topology: Arc::clone(&topology.inner), vertices };
        let cell = watched(py, progress, |watch| {
            ExtractorCell::try_new(mesh, |mesh| {
                let first = first.unwrap_or(&mesh.vertices);
                PatchExtractor::watched(&mesh.topology, &mesh.vertices, first, params, watch)
            })
        })?;
        Ok(Self { cell })
    }

    #[getter]
    fn n_channels(&self) -> usize {
        self.cell.borrow_dependent().n_channels()
    }

    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::triples(py, self.cell.borrow_dependent().geometry().normals.clone())
    }

    #[allow(clippy::too_many_arguments, reason = "one argument a buffer")]
    fn extract(
        &self,
        py: Python<'_>,
        centers: PyReadonlyArray1<'_, u32>,
        mut features: PyReadwriteArrayDyn<'_, f32>,
        mut neighbors: PyReadwriteArrayDyn<'_, i32>,
        mut face_ids: PyReadwriteArrayDyn<'_, u32>,
        mut mask: PyReadwriteArrayDyn<'_, u8>,
        mut world_from_patch: PyReadwriteArrayDyn<'_, f64>,
        mut radii: PyReadwriteArrayDyn<'_, f64>,
    ) -> PyResult<()> {
        let centers = centers
            .as_slice()
            .map_err(|_| ConfigError::new_err("centers must be a contiguous array in C order"))?;
        let out = PatchBuffers {
            features: slice_mut("features", &mut features)?,
            neighbors: slice_mut("neighbors", &mut neighbors)?,
            face_ids: slice_mut("face_ids", &mut face_ids)?,
            mask: slice_mut("mask", &mut mask)?,
            world_from_patch: slice_mut("world_from_patch", &mut world_from_patch)?,
            radii: slice_mut("radii", &mut radii)?,
        };
        let extractor = self.cell.borrow_dependent();
        py.detach(|| extractor.extract(centers, out)).into_python()
    }
}

#[pyfunction]
#[pyo3(signature = (topology, vertices, *, patch_scale=4.0, sigma_vote=1.0 / 3.0))]
pub fn classify_faces<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
    patch_scale: f64,
    sigma_vote: f64,
) -> PyResult<Bound<'py, PyArray1<u8>>> {
    let params = PatchParams { patch_scale, sigma_vote, ..PatchParams::default() };
    let vertices = arrays::points("vertices", &vertices)?;
    let classes = py.detach(|| patch::classify_faces(&topology.inner, vertices, params)).into_python()?;
    Ok(classes.into_iter().map(|class| class as u8).collect::<Vec<_>>().into_pyarray(py))
}

#[pyfunction]
pub fn mesh_roughness<'py>(
    py: Python<'py>,
    topology: &PyTopology,
    vertices: Points<'py>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let vertices = arrays::points("vertices", &vertices)?;
    let roughness = py.detach(|| patch::mesh_roughness(&topology.inner, vertices)).into_python()?;
    Ok(roughness.to_vec().into_pyarray(py))
}

#[pyfunction]
pub fn flat_share(py: Python<'_>, topology: &PyTopology, vertices: Points<'_>, angle: f64) -> PyResult<f64> {
    let vertices = arrays::points("vertices", &vertices)?;
    py.detach(|| flatness::flat_share(&topology.inner, vertices, angle)).into_python()
}

#[pyclass(name = "NormalAccumulator", module = "gcnd._geom", frozen)]
pub struct PyNormalAccumulator {
    inner: Mutex<NormalAccumulator>,
}

#[pymethods]
impl PyNormalAccumulator {
    #[new]
    fn new(n_faces: usize) -> PyResult<Self> {
        if n_faces > u32::MAX as usize {
            return Err(ConfigError::new_err(format!("n_faces is {n_faces}, allowed: below 2^32")));
        }
        Ok(Self { inner: Mutex::new(NormalAccumulator::new(n_faces)) })
    }

    fn add_nodes(
        &self,
        py: Python<'_>,
        features: PyReadonlyArrayDyn<'_, f32>,
        face_ids: PyReadonlyArrayDyn<'_, u32>,
        mask: PyReadonlyArrayDyn<'_, u8>,
        world_from_patch: PyReadonlyArrayDyn<'_, f64>,
        predicted: PyReadonlyArrayDyn<'_, f32>,
    ) -> PyResult<()> {
        let n_channels = features.shape().last().copied().unwrap_or(0);
        let (face_ids, mask) = (slice("face_ids", &face_ids)?, slice("mask", &mask)?);
        let (predicted, features) = (slice("predicted", &predicted)?, slice("features", &features)?);
        let world_from_patch = slice("world_from_patch", &world_from_patch)?;
        py.detach(|| self.lock().add(face_ids, mask, predicted, features, n_channels, world_from_patch))
            .into_python()
    }

    fn add_centers(
        &self,
        py: Python<'_>,
        centers: PyReadonlyArrayDyn<'_, u32>,
        world_from_patch: PyReadonlyArrayDyn<'_, f64>,
        predicted: PyReadonlyArrayDyn<'_, f32>,
    ) -> PyResult<()> {
        let (centers, predicted) = (slice("centers", &centers)?, slice("predicted", &predicted)?);
        let world_from_patch = slice("world_from_patch", &world_from_patch)?;
        py.detach(|| self.lock().add_centers(centers, predicted, world_from_patch)).into_python()
    }

    fn spread<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        py.detach(|| self.lock().spread()).into_pyarray(py)
    }

    fn normals<'py>(&self, py: Python<'py>, fallback: Points<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let fallback = arrays::points("fallback", &fallback)?;
        let normals = py.detach(|| self.lock().normals(fallback)).into_python()?;
        arrays::triples(py, normals)
    }
}

impl PyNormalAccumulator {
    /// A poisoned lock only means that another thread panicked; the sums it guards are plain numbers.
    fn lock(&self) -> std::sync::MutexGuard<'_, NormalAccumulator> {
        self.inner.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

#[pyclass(name = "Cover", module = "gcnd._geom", frozen)]
pub struct PyCover {
    inner: Mutex<Cover>,
}

#[pymethods]
impl PyCover {
    #[new]
    fn new(py: Python<'_>, n_faces: usize, least_weight: f64, seed: u64) -> PyResult<Self> {
        let cover = py.detach(|| Cover::new(n_faces, least_weight, seed)).into_python()?;
        Ok(Self { inner: Mutex::new(cover) })
    }

    fn next_centers<'py>(
        &self,
        py: Python<'py>,
        predictions: &PyNormalAccumulator,
        at_most: usize,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let centers = py.detach(|| self.lock().next_centers(&predictions.lock(), at_most)).into_python()?;
        Ok(centers.into_pyarray(py))
    }

    #[getter]
    fn progress(&self) -> f64 {
        self.lock().progress()
    }
}

impl PyCover {
    /// As [`PyNormalAccumulator::lock`].
    fn lock(&self) -> std::sync::MutexGuard<'_, Cover> {
        self.inner.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}
