"""The binding of the Rust core ``gcnd_geom``: arrays in, arrays out, the GIL released.

Points are float64 (n, 3), faces uint32 (n, 3), all contiguous in C order. Errors are ``gcnd.errors.MeshError`` and,
for parameters and array shapes, ``gcnd.errors.ConfigError``. Formulas and sources stand in the core's own docs.

``progress`` is called after each step or iteration with (its number, how many there are); what it raises, or Ctrl-C,
stops the work.
"""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Faces = NDArray[np.uint32]
Ids = NDArray[np.uint32]
StepProgress = Callable[[int, int], object]

class Topology:
    """Adjacency of a mesh, built once: vertex → faces and face → faces across an edge."""

    def __init__(self, faces: Faces, n_vertices: int) -> None: ...
    @property
    def n_faces(self) -> int: ...
    @property
    def n_vertices(self) -> int: ...
    def edge_neighbors(self) -> tuple[NDArray[np.uint64], Ids]:
        """Compressed rows: the neighbours of face i are ids[offsets[i]:offsets[i + 1]]."""

    def vertex_faces(self) -> tuple[NDArray[np.uint64], Ids]:
        """Compressed rows: the faces of vertex i are ids[offsets[i]:offsets[i + 1]]."""

class PatchExtractor:
    """Cuts aligned patch graphs from a mesh (paper Sec. 4)."""

    def __init__(
        self,
        topology: Topology,
        vertices: Points,
        *,
        patch_scale: float = 4.0,
        sheets: Literal["all", "one"] = "all",
        n_nodes: int = 64,
        budget: Literal["nearest", "random"] = "nearest",
        seed: int = 0,
        voting_region: Literal["patch", "two_ring", "nobody"] = "patch",
        sigma_vote: float = ...,
        vertex_offsets: bool = True,
        scale_space: bool = False,
        first: Points | None = None,
        roughness: NDArray[np.float64] | None = None,
        progress: StepProgress | None = None,
    ) -> None: ...
    @property
    def n_channels(self) -> int: ...
    def normals(self) -> Points:
        """The mesh's own unit normals (F, 3); zero for a face without area."""

    def extract(
        self,
        centers: Ids,
        features: NDArray[np.float32],
        neighbors: NDArray[np.int32],
        face_ids: NDArray[np.uint32],
        mask: NDArray[np.uint8],
        world_from_patch: NDArray[np.float64],
        radii: NDArray[np.float64],
    ) -> None:
        """Fills the buffers (P, N, C), (P, N, 3), (P, N), (P, N), (P, 3, 3), (P,) for P centre faces."""

class NormalAccumulator:
    """Averages the normals that overlapping patches predict for each face."""

    def __init__(self, n_faces: int) -> None: ...
    def add_nodes(
        self,
        features: NDArray[np.float32],
        face_ids: NDArray[np.uint32],
        mask: NDArray[np.uint8],
        world_from_patch: NDArray[np.float64],
        predicted: NDArray[np.float32],
    ) -> None:
        """Adds (P, N, 3) predictions, patch frame, each with weight exp(−2‖c̄‖²)."""

    def add_centers(
        self, centers: Ids, world_from_patch: NDArray[np.float64], predicted: NDArray[np.float32]
    ) -> None:
        """Adds (P, 3) predictions of the centres, patch frame."""

    def spread(self) -> NDArray[np.float64]:
        """How far the predictions for each face disagree (F,), about radians; 0 for a single one."""

    def normals(self, fallback: Points) -> Points:
        """Averaged unit normals (F, 3); a face's ``fallback`` where nothing was added."""

class Cover:
    """Chooses patch centres where predictions are missing: each face comes up once, unless they weigh enough."""

    def __init__(self, n_faces: int, least_weight: float, seed: int) -> None: ...
    def next_centers(self, predictions: NormalAccumulator, at_most: int) -> Ids:
        """The next centres, ascending; empty when every face has come up."""

    @property
    def progress(self) -> float:
        """The fraction of the faces that have come up."""

def orient(topology: Topology) -> tuple[NDArray[np.bool_], int, int, int]:
    """Returns which faces to turn (F,), edges whose faces disagree, how many of them are left, one-sided components."""

def find_spikes(topology: Topology, vertices: Points) -> tuple[Ids, Points, NDArray[np.bool_]]:
    """Returns vertices far off the surface (S,), where the surface is (S, 3), and which are on a boundary (S,)."""

def validate(vertices: Points, faces: Faces) -> None: ...
def weld(vertices: Points) -> tuple[Ids, Ids]:
    """Returns (first vertex at each distinct position, index into that list for each vertex)."""

def face_geometry(vertices: Points, faces: Faces) -> tuple[Points, Points, NDArray[np.float64]]:
    """Returns unit normals (F, 3), centroids (F, 3) and areas (F,)."""

def mean_edge_length(vertices: Points, faces: Faces) -> float: ...
def classify_faces(
    topology: Topology, vertices: Points, *, patch_scale: float = 4.0, sigma_vote: float = ...
) -> NDArray[np.uint8]:
    """Classes (F,): 0 flat, 1 edge, 2 corner, 3 transitional (paper Sec. 5.2)."""

def mesh_roughness(topology: Topology, vertices: Points) -> NDArray[np.float64]:
    """How rough the mesh is (4,), quantiles in mesh units; see the core's `mesh_roughness`."""

def flat_share(topology: Topology, vertices: Points, angle: float) -> float:
    """Share of the faces' edges across which the surface goes on in one plane, to within ``angle`` in radians."""

def refine_normals(
    topology: Topology,
    vertices: Points,
    normals: Points,
    *,
    iterations: int,
    sigma_r: float = 0.3,
    sigma_s: float | None = None,
    neighborhood: Literal["shared_vertex", "shared_edge", "radius"] = "shared_vertex",
    radius: float = 2.0,
    progress: StepProgress | None = None,
) -> Points:
    """Bilateral refinement of normals (Eq. 5)."""

def refine_consistent(
    topology: Topology,
    vertices: Points,
    normals: Points,
    spread: NDArray[np.float64],
    *,
    iterations: int,
    tolerance: float,
    sigma_r: float = 0.3,
    region_rounds: int = 20,
    progress: StepProgress | None = None,
) -> Points:
    """Eq. 5 where it moves normals no further than the predictions disagree; ``spread`` (F,)."""

def update_vertices(
    topology: Topology,
    vertices: Points,
    normals: Points,
    iterations: int,
    boundary: Literal["free", "along", "fixed"] = "free",
    *,
    progress: StepProgress | None = None,
) -> Points:
    """Moves vertices to fit normals (Eq. 6); `boundary` as of the core's `Boundary`."""

# The classical filters return positions (V, 3) and leave ``vertices`` as they are.
def bilateral_normal(
    topology: Topology,
    vertices: Points,
    *,
    sigma_r: float = 0.35,
    sigma_s: float | None = None,
    normal_iterations: int = 20,
    vertex_iterations: int = 20,
    fix_boundary: bool = True,
    progress: StepProgress | None = None,
) -> Points:
    """Bilateral filter on normals (Zheng et al. 2011, Eq. 5), then Eq. 6."""

def bilateral_normal_implicit(
    topology: Topology,
    vertices: Points,
    *,
    sigma_r: float = 0.35,
    sigma_s: float | None = None,
    smoothness: float = 0.01,
    vertex_iterations: int = 20,
    fix_boundary: bool = True,
    memory: int | None = None,
    progress: StepProgress | None = None,
) -> Points:
    """Bilateral filter on normals, all at once (Zheng et al. 2011, Eqs. 7–10), then Eq. 6."""

def guided_normal(
    topology: Topology,
    vertices: Points,
    *,
    sigma_r: float = 0.35,
    sigma_s: float | None = None,
    radius: float = 2.0,
    normal_iterations: int = 20,
    vertex_iterations: int = 20,
    fix_boundary: bool = False,
    progress: StepProgress | None = None,
) -> Points:
    """Bilateral filter on normals under guidance (Zhang et al. 2015, Eqs. 5–9), Eq. 6 in each iteration."""

def fast_effective(
    topology: Topology,
    vertices: Points,
    *,
    threshold: float = 0.5,
    normal_iterations: int = 20,
    vertex_iterations: int = 50,
    fix_boundary: bool = True,
    progress: StepProgress | None = None,
) -> Points:
    """Thresholded averages of normals (Sun et al. 2007, Eqs. 4–6 and 8)."""

def low_rank(
    topology: Topology,
    vertices: Points,
    *,
    sigma_m: float = 0.2,
    similar_patches: int = 10,
    patch_size: int = 50,
    search_rings: int = 10,
    normal_iterations: int = 1,
    vertex_iterations: int = 10,
    fix_boundary: bool = False,
    fixed_step: bool = False,
    progress: StepProgress | None = None,
) -> Points:
    """Normals of patches alike as matrices of low rank (Li et al. 2018), then Eq. 6."""

def tgv(
    topology: Topology,
    vertices: Points,
    *,
    alpha1: float = 1.0,
    alpha0: float = 0.5,
    beta: float = 2.5,
    normal_iterations: int = 50,
    vertex_iterations: int = 20,
    fix_boundary: bool = False,
    memory: int | None = None,
    progress: StepProgress | None = None,
) -> Points:
    """Normals that bend evenly, or at creases (Liu et al. 2022), then Eq. 6."""

def bilateral_mesh(
    topology: Topology, vertices: Points, *, iterations: int = 5, progress: StepProgress | None = None
) -> Points:
    """Bilateral filter on positions (Fleishman et al. 2003, Sec. 3)."""

def l0(
    topology: Topology,
    vertices: Points,
    *,
    lambda_: float | None = None,
    alpha: float | None = None,
    mu_alpha: float = 0.5,
    beta: float = 0.001,
    beta_max: float = 1000.0,
    mu_beta: float = 1.4142135623730951,
    memory: int | None = None,
    progress: StepProgress | None = None,
) -> Points:
    """As few bent edges as possible (He, Schaefer 2013, Eqs. 5, 8 and 9)."""

def laplacian(
    topology: Topology,
    vertices: Points,
    *,
    lambda_: float = 0.5,
    iterations: int = 10,
    fix_boundary: bool = True,
    progress: StepProgress | None = None,
) -> Points:
    """Averages of positions (Taubin 1995, Sec. 2)."""

def taubin(
    topology: Topology,
    vertices: Points,
    *,
    lambda_: float = 0.5,
    mu: float = -0.53,
    iterations: int = 10,
    fix_boundary: bool = True,
    progress: StepProgress | None = None,
) -> Points:
    """Averages of positions without shrinking (Taubin 1995, Sec. 3)."""

def hc_laplacian(
    topology: Topology,
    vertices: Points,
    *,
    alpha: float = 0.1,
    beta: float = 0.5,
    iterations: int = 10,
    fix_boundary: bool = True,
    progress: StepProgress | None = None,
) -> Points:
    """Averages of positions, pushed back (Vollmer et al. 1999, Sec. 3)."""

def fit_vertices(
    topology: Topology,
    vertices: Points,
    normals: Points,
    first: Points,
    boundary: Literal["free", "along", "fixed"] = "free",
    *,
    pull: float = 0.0026,
    progress: StepProgress | None = None,
) -> Points:
    """Positions (V, 3), mesh units, between what normals (F, 3) ask for and where vertices were ``first``."""

def keep_detail(topology: Topology, before: Points, after: Points) -> Points:
    """Detail that was taken away with weak noise, back: positions (V, 3), mesh units."""

def normal_angles(result: Points, truth: Points) -> NDArray[np.float64]:
    """Degrees (F,) between normals; NaN where the truth is zero, 90 where only the result is."""

def vertex_error(
    result_vertices: Points,
    result_faces: Faces,
    truth_vertices: Points,
    truth_faces: Faces,
    samples: int,
    seed: int,
) -> float: ...
def remesh(
    vertices: Points,
    faces: Faces,
    target_edge_length: float,
    *,
    feature_angle_deg: float = 30.0,
    iterations: int = 10,
    sizes: NDArray[np.float64] | None = None,
) -> tuple[Points, Faces]: ...

# The kernels take float32 arrays, or bfloat16 ones as int16 bit patterns, and write into ``out`` or ``grad``.
def gather_max(values: NDArray[Any], neighbors: NDArray[np.int32], out: NDArray[Any]) -> None: ...
def gather_max_argmax(
    values: NDArray[Any], neighbors: NDArray[np.int32], out: NDArray[Any], argmax: NDArray[np.int16]
) -> None: ...
def gather_max_backward(grad_out: NDArray[Any], argmax: NDArray[np.int16], grad: NDArray[Any]) -> None: ...
def gather_sum(values: NDArray[Any], neighbors: NDArray[np.int32], out: NDArray[Any]) -> None: ...
def gather_sum_backward(grad_out: NDArray[Any], neighbors: NDArray[np.int32], grad: NDArray[Any]) -> None: ...
def edge_max_leaky(
    parts: NDArray[Any],
    scale: NDArray[np.float32],
    neighbors: NDArray[np.int32],
    slope: float,
    out: NDArray[Any],
) -> None: ...
def pool_nodes(values: NDArray[Any], out: NDArray[Any], argmax: NDArray[np.int16]) -> None: ...
def pool_nodes_backward(grad_out: NDArray[Any], argmax: NDArray[np.int16], grad: NDArray[Any]) -> None: ...
def knn(features: NDArray[Any], out: NDArray[np.int32]) -> None: ...
