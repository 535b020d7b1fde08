"""`gcnd info`: what a mesh file holds."""

from __future__ import annotations

import sys

from gcnd.cli.options import InputMesh, JsonFlag, print_json, print_table

__all__ = ["run"]


def run(input_mesh: InputMesh, as_json: JsonFlag = False) -> None:
    """Count the vertices, faces and defects of IN, estimate its noise, and say which preset suits it."""
    from gcnd.auto import choose_preset, read_signs
    from gcnd.mesh_info import mesh_info
    from gcnd.mesh_io import read_shape
    from gcnd.start import Start
    from gcnd.surface import as_surface

    shape = read_shape(input_mesh)
    arrays = shape.arrays
    welded, _ = arrays.welded()
    # As denoising sees it, or the preset would be another.
    surface = as_surface(welded)
    start = Start(surface.topology, surface.mesh.vertices)
    signs = read_signs(surface.topology, start.positions, surface.mesh.faces)
    choice = choose_preset(signs)
    info: dict[str, object] = {**mesh_info(arrays.vertices, arrays.faces)}
    info |= {"spikes": 0 if start.spikes is None else len(start.spikes.ids), **signs.described()}
    info |= {"preset": choice.preset, "why": choice.why}
    if shape.polygons is not None:
        print(
            f"the {shape.n_faces:,} faces of {input_mesh} are counted as {len(arrays.faces):,} triangles, since some "
            "have more than three corners; gcnd denoise takes them with --triangulate",
            file=sys.stderr,
        )
    if as_json:
        print_json(info)
    else:
        print_table({name.replace("_", " "): _text(value) for name, value in info.items()})


def _text(value: object) -> str:
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.6g}"
        case _:
            return str(value)
