"""The classical filters, which need no network: names, parameters and one function that runs any of them."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

from gcnd import _geom
from gcnd.controls import Controls
from gcnd.errors import ConfigError, check_count
from gcnd.memory import available_bytes, filter_bytes_a_face
from gcnd.runs import Denoised, Moved, run_on

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from gcnd.stages import Progress, Stages
    from gcnd.start import Start
    from gcnd.surface import Surface

__all__ = [
    "Filter",
    "FilterInfo",
    "all_parameters",
    "apply_filter",
    "finite",
    "list_filters",
    "parse_parameters",
]


@dataclass(frozen=True)
class FilterInfo:
    """Describes one filter.

    Attributes:
        name: What ``apply_filter`` and ``gcnd denoise --method`` call it.
        description: What it does, in a line.
        source: The paper that it follows, with the equations or the section where they are known.
        parameters: Names and defaults; None stands for a value taken from the mesh.
    """

    name: str
    description: str
    source: str
    parameters: dict[str, bool | int | float | None]


# A new filter is one function of the core and one line here.
_FILTERS: dict[str, tuple[Callable[..., Any], str, str]] = {
    "bilateral": (_geom.bilateral_mesh, "bilateral filter on positions", "Fleishman et al. 2003, Sec. 3"),
    "bilateral-normal": (_geom.bilateral_normal, "bilateral filter on normals", "Zheng et al. 2011, Eq. 5"),
    "bilateral-normal-implicit": (
        _geom.bilateral_normal_implicit,
        "bilateral filter on normals, all at once",
        "Zheng et al. 2011, Eqs. 7–10",
    ),
    "guided-normal": (
        _geom.guided_normal,
        "bilateral filter on normals under guidance",
        "Zhang et al. 2015, Eqs. 5–9",
    ),
    "l0": (_geom.l0, "as few bent edges as possible", "He, Schaefer 2013, Eqs. 5, 8 and 9"),
    "fast-effective": (
        _geom.fast_effective,
        "thresholded averages of normals",
        "Sun et al. 2007, Eqs. 4–6 and 8",
    ),
    "tgv": (_geom.tgv, "normals that bend evenly, or at creases", "Liu et al. 2022"),
    "low-rank": (_geom.low_rank, "normals of patches alike as matrices of low rank", "Li et al. 2018"),
    "laplacian": (_geom.laplacian, "averages of positions", "Taubin 1995, Sec. 2"),
    "taubin": (_geom.taubin, "averages of positions without shrinking", "Taubin 1995, Sec. 3"),
    "hc-laplacian": (_geom.hc_laplacian, "averages of positions, pushed back", "Vollmer et al. 1999, Sec. 3"),
}


# Counts that the core bounds; it cannot tell of a number that does not fit its own.
_COUNTS = {"similar_patches": "1 to 64", "patch_size": "2 to 512", "search_rings": "1 to 32"}


def list_filters() -> list[FilterInfo]:
    """Lists the filters.

    Returns:
        One entry for each, in no order that matters.

    Example:
        >>> [info.source for info in list_filters() if info.name == "guided-normal"]
        ['Zhang et al. 2015, Eqs. 5–9']
    """
    return [
        FilterInfo(name, description, source, _defaults(function))
        for name, (function, description, source) in _FILTERS.items()
    ]


def apply_filter(
    mesh: Any,
    method: str,
    *,
    controls: Controls | None = None,
    triangulate: bool = False,
    progress: Progress | None = None,
    **parameters: Any,
) -> Any:
    """Removes noise from a triangle mesh by a classical filter.

    Faces and the order of vertices stay; only positions change. Vertices at exactly the same position move together.
    The input is left as it is.

    Args:
        mesh: As `gcnd.denoise` takes it.
        method: Name of the filter; ``list_filters`` has them.
        controls: How much of the result is wanted, and where; all of it, everywhere, by default.
        triangulate: Whether faces of four corners and more are split for the work; they are refused otherwise.
        progress: Called after each iteration with (fraction done, the filter's name); returning False cancels, and
            what it raises stops the filter too.
        parameters: Of the filter, as ``list_filters`` has them; lengths in mesh units. What Python keeps for itself
            has an underscore: ``lambda_``.

    Returns:
        The same kind as ``mesh`` (a ``trimesh.Trimesh`` for a path), with float64 positions or the input's dtype.

    Raises:
        MeshError: The mesh cannot be worked on: no faces, NaN, an index out of range, a file that is not a mesh; or
            more memory is needed than is free.
        ConfigError: The filter or a parameter is unknown, or a parameter is out of range.
        GcndError: The filter diverged: a position left the mesh's bounding box by more than its longest side, or is no
            longer a number. The iteration is told, and the input is as it was.
        Cancelled: ``progress`` returned False.

    Example:
        >>> import trimesh
        >>> noisy = trimesh.creation.icosphere(subdivisions=3)
        >>> clean = apply_filter(noisy, "bilateral-normal", sigma_r=0.45)
        >>> bool((clean.faces == noisy.faces).all())
        True
    """
    chosen = Filter(method, controls=controls, triangulate=triangulate, **parameters)
    return chosen.run(mesh, progress=progress).mesh


class Filter:
    """Holds a filter with its parameters, for more than one mesh; arguments and errors as of ``apply_filter``.

    Example:
        >>> import trimesh
        >>> done = Filter("taubin", iterations=3).run(trimesh.creation.icosphere(subdivisions=2))
        >>> done.method["filter"], done.method["parameters"]["iterations"], len(done.mesh.faces)
        ('taubin', 3, 320)
    """

    def __init__(
        self,
        method: str,
        *,
        controls: Controls | None = None,
        triangulate: bool = False,
        **parameters: Any,
    ) -> None:
        self.method, self.controls, self.triangulate = method, controls or Controls(), triangulate
        self.parameters = _checked(method, _defaults(_find(method)), parameters)

    def run(self, mesh: Any, *, progress: Progress | None = None) -> Denoised:
        """Filters one mesh and returns all that is known of the result."""

        def move(surface: Surface, start: Start, stages: Stages) -> Moved:
            def report(iteration: int, total: int) -> None:
                stages(iteration / total, self.method)

            run = _find(self.method)
            # What factorises systems knows how large they are before it takes the memory.
            limit = {"memory": available_bytes()} if "memory" in inspect.signature(run).parameters else {}
            moved = run(surface.topology, start.positions, progress=report, **limit, **self.parameters)
            return Moved(start.way_back(moved))

        parameters = all_parameters(self.method, self.parameters)
        described = {"filter": self.method, "parameters": parameters}

        def bytes_a_face(n_faces: int) -> int:
            return filter_bytes_a_face(self.method, n_faces, parameters.get("patch_size") or 0)

        return run_on(
            mesh, move, self.controls, described, progress, self.triangulate, bytes_a_face=bytes_a_face
        )


def all_parameters(method: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Adds the defaults of all parameters that are not given, as the filter runs with them.

    Args:
        method: Name of the filter.
        given: Values by name.

    Returns:
        Values of all parameters; None stands for a value taken from each mesh.

    Example:
        >>> all_parameters("laplacian", {"iterations": 3})
        {'lambda_': 0.5, 'iterations': 3, 'fix_boundary': True}
    """
    return {**_defaults(_find(method)), **given}


def parse_parameters(method: str, texts: Mapping[str, str]) -> dict[str, bool | int | float]:
    """Reads a filter's parameters from text, as the command line has them.

    Args:
        method: Name of the filter.
        texts: Values by name; ``lambda`` serves for ``lambda_``.

    Returns:
        Values for ``apply_filter``.

    Raises:
        ConfigError: The filter or a parameter is unknown, or a value is not of its kind.

    Example:
        >>> parse_parameters("taubin", {"lambda": "0.4", "iterations": "3", "fix_boundary": "false"})
        {'lambda_': 0.4, 'iterations': 3, 'fix_boundary': False}
    """
    defaults = _defaults(_find(method))
    parsed: dict[str, bool | int | float] = {}
    for given, text in texts.items():
        name = _known(method, defaults, given, parsed)
        kind = type(defaults[name])
        try:
            if kind is bool:
                parsed[name] = {"true": True, "false": False}[text.lower()]
            else:
                parsed[name] = int(text) if kind is int else finite(float(text))
        except (KeyError, ValueError):
            raise ConfigError(f"{given} is {text}, allowed: {_allowed(defaults[name])}") from None
    return parsed


def finite(value: float) -> float:
    """Returns a number that is one; raises ``ValueError`` for NaN and infinities."""
    if not math.isfinite(value):
        raise ValueError(value)
    return value


def _find(method: str) -> Callable[..., Any]:
    if not isinstance(method, str) or method not in _FILTERS:
        raise ConfigError(f"there is no filter {method!r}", hint=f"filters are {', '.join(_FILTERS)}")
    return _FILTERS[method][0]


def _defaults(function: Callable[..., Any]) -> dict[str, bool | int | float | None]:
    """A filter's own parameters, which stand in its signature as keywords, beside those that are ours to give."""
    signature = inspect.signature(function)
    keywords = [p for p in signature.parameters.values() if p.kind is inspect.Parameter.KEYWORD_ONLY]
    return {p.name: p.default for p in keywords if p.name not in ("memory", "progress")}


def _known(method: str, defaults: Mapping[str, Any], name: str, before: Mapping[str, Any]) -> str:
    """A parameter's own name; ``before`` has those that were given already."""
    for candidate in (name, f"{name}_"):
        if candidate in before:
            raise ConfigError(f"{method} is given {name.removesuffix('_')} twice, allowed: once")
        if candidate in defaults:
            return candidate
    names = ", ".join(known.removesuffix("_") for known in defaults)
    raise ConfigError(f"{method} has no parameter {name!r}", hint=f"its parameters are {names}")


def _checked(method: str, defaults: Mapping[str, Any], parameters: Mapping[str, Any]) -> dict[str, Any]:
    checked: dict[str, Any] = {}
    for given, value in parameters.items():
        name = _known(method, defaults, given, checked)
        default = defaults[name]
        if value is None and default is None:
            continue
        is_bool = isinstance(value, bool)
        if isinstance(default, bool):
            is_right = is_bool
        elif isinstance(default, int):
            is_right = isinstance(value, Integral) and not is_bool
        else:
            is_right = isinstance(value, Real) and not is_bool
        if not is_right:
            raise ConfigError(f"{given} is {value!r}, allowed: {_allowed(default)}")
        if isinstance(default, int) and not is_bool:
            if name in _COUNTS and not 0 <= value < 1 << 64:
                raise ConfigError(f"{given} is {value}, allowed: {_COUNTS[name]}")
            check_count(given, value)
        # Of Python's own types, which the core and a report take, whatever numpy's it is.
        checked[name] = value if is_bool else int(value) if isinstance(value, Integral) else float(value)
    return checked


def _allowed(default: bool | int | float | None) -> str:
    if isinstance(default, bool):
        return "true or false"
    return "a whole number" if isinstance(default, int) else "a number"
