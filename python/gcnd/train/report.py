"""A page about a training run: loss and validation error over the steps, and meshes before and after."""

from __future__ import annotations

import html
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from gcnd import _geom
from gcnd.errors import ConfigError, GcndError
from gcnd.formats.atomic import read_npz, write_or_tell
from gcnd.mesh_io import check_output_path
from gcnd.page import data_uri, html_page, inline_svg
from gcnd.picture import Panel, save_panels

_PAGES = (".html", ".htm")


def write_report(run: Path, out: Path) -> None:
    """Write one self-contained HTML page about the training run in a folder.

    Args:
        run: Folder of `gcnd.train.run.TrainingRun`, finished or not.
        out: The page to write; it opens without a network.

    Raises:
        ConfigError: The folder holds no log.
        GcndError: matplotlib is not installed; or the page cannot be written, or would replace another file of the run.

    Example:
        >>> write_report(Path("runs/default"), Path("report.html"))  # doctest: +SKIP
    """
    lines = read_log(run)
    others = (path for path in run.rglob("*") if path.suffix.lower() not in _PAGES and path.is_file())
    check_output_path(out, *others, is_mesh=False)
    parts = [
        f"<h1>Training run {html.escape(run.resolve().name)}</h1>",
        _table(lines),
        "<h2>Loss and error</h2>",
        _curves(lines),
    ]
    examples = sorted(run.glob("example-*.npz"))
    if examples:
        parts += ["<h2>Before and after</h2>", *(_example(path) for path in examples)]
    page = html_page(run.resolve().name, "".join(parts))
    write_or_tell(out, page)


def read_log(run: Path) -> list[dict[str, Any]]:
    """Read the lines of a run's log; a step that a resumed run repeated counts as it was done last.

    Raises:
        ConfigError: There is no log, it holds no line, or a line is damaged.

    Example:
        >>> read_log(Path("runs/default"))[0]["stage"]  # doctest: +SKIP
        1
    """
    path = run / "log.jsonl"
    if not path.is_file():
        raise ConfigError(f"no training run in {run}", hint="give the folder that gcnd train wrote to")
    by_step: dict[tuple[int, int], dict[str, Any]] = {}
    texts = path.read_text(encoding="utf-8", errors="replace").split("\n")
    # Every whole line ends with a line break; what a kill cut short stands after the last one.
    for number, text in enumerate(texts[:-1], start=1):
        try:
            line = json.loads(text)
            by_step[line["stage"], line["step"]] = line
            _check_line(line)
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ConfigError(f"line {number} of {path} is damaged: {text[:60]!r}") from error
    if not by_step:
        raise ConfigError(f"{path} holds no line yet", hint="wait for the first hundred steps")
    return [by_step[key] for key in sorted(by_step)]


def _check_line(line: dict[str, Any]) -> None:
    """Raises ValueError or KeyError unless a line has the numbers that a report shows."""
    for name, kind in {"stage": int, "step": int, "loss": float, "patches_per_second": float}.items():
        if not isinstance(line[name], int | float) or (kind is int and not isinstance(line[name], int)):
            raise ValueError(name)
    if not isinstance(line.get("validation_e_a", 0.0), int | float):
        raise ValueError("validation_e_a")


def _table(lines: list[dict[str, Any]]) -> str:
    rows = []
    for stage in sorted({line["stage"] for line in lines}):
        own = [line for line in lines if line["stage"] == stage]
        errors = [line["validation_e_a"] for line in own if "validation_e_a" in line]
        last = f"{errors[-1]:.2f}°" if errors else "–"
        rows.append(
            f"<tr><td>{stage}<td>{own[-1]['step']:,}<td>{own[-1]['loss']:.4f}<td>{last}"
            f"<td>{own[-1]['patches_per_second']:,.0f}"
        )
    heads = "".join(f"<th>{head}" for head in ("stage", "steps", "loss", "validation E_a", "patches/s"))
    return f"<table><tr>{heads}{''.join(rows)}</table>"


def _curves(lines: list[dict[str, Any]]) -> str:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise GcndError("a report needs matplotlib", hint="pip install 'gcnd[picture]'") from error
    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for stage in sorted({line["stage"] for line in lines}):
        own = [line for line in lines if line["stage"] == stage]
        checked = [line for line in own if "validation_e_a" in line]
        left.plot([line["step"] for line in own], [line["loss"] for line in own], label=f"stage {stage}")
        steps, errors = [line["step"] for line in checked], [line["validation_e_a"] for line in checked]
        right.plot(steps, errors, marker="o", markersize=3, label=f"stage {stage}")
    for axes, title in ((left, "training loss"), (right, "E_a of the normals on validation meshes, degrees")):
        axes.set_title(title)
        axes.set_xlabel("step")
        axes.grid(alpha=0.3)
        axes.legend()
    return inline_svg(figure)


def _example(path: Path) -> str:
    stored = read_npz(path, "name", "faces", *_EXAMPLE_KEYS.values())
    if stored is None:
        raise ConfigError(
            f"{path} is damaged", hint="delete it; gcnd train writes it again at the end of the run"
        )
    name, faces = str(stored["name"]), stored["faces"]
    meshes = {label: stored[key] for label, key in _EXAMPLE_KEYS.items()}
    truth = _geom.face_geometry(meshes["truth"], faces)[0]
    panels = []
    for label, vertices in meshes.items():
        angles = _geom.normal_angles(_geom.face_geometry(vertices, faces)[0], truth)
        title = label if label == "truth" else f"{label}, E_a {np.nanmean(angles):.2f}°"
        panels.append(Panel(title, vertices, faces, None if label == "truth" else angles))
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "panels.png"
        save_panels(picture, [panels])
        source = data_uri(picture.read_bytes(), "png")
    return f'<h3>{html.escape(name)}</h3><img alt="noisy, denoised and true mesh" src="{source}">'


_EXAMPLE_KEYS = {"noisy": "noisy", "denoised": "denoised", "truth": "clean"}
