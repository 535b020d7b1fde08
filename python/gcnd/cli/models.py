"""`gcnd models`: the weights that come with gcnd, and what they were measured to do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gcnd.cli.options import JsonFlag, print_json

if TYPE_CHECKING:
    from gcnd.weights import ModelInfo

__all__ = ["run"]

_FIELDS = ("name", "description", "n_parameters", "file_bytes", "licence", "sha256", "auto")


def run(as_json: JsonFlag = False) -> None:
    """List the weights that come with gcnd: size, speed, data and E_a as measured."""
    from gcnd.weights import list_models

    models = list_models()
    if as_json:
        keys = ("data", "noise", "training", "measured")
        print_json(
            [
                {n: getattr(m, n) for n in _FIELDS} | {k: m.card[k] for k in keys if k in m.card}
                for m in models
            ]
        )
        return
    print("\n\n".join(_entry(model) for model in models))


def _entry(model: ModelInfo) -> str:
    size = f"{model.n_parameters:,} weights, {model.file_bytes / 1e6:.1f} MB, {model.licence}"
    lines = [f"{model.name}{' (auto)' if model.auto else ''}: {size}", f"    {model.description}"]
    measured = model.card.get("measured", {})
    if "speed" in measured:
        speed = measured["speed"]
        lines.append(f"    {speed['faces_per_second']:,} faces/s on {speed['hardware']}")
    if "data" in model.card:
        data = model.card["data"]
        meshes = sum(len(group["names"].split(",")) for group in data.get("meshes", []))
        lines.append(f"    trained on {data['shapes']} generated shapes and {meshes} openly licensed meshes")
    if measured.get("e_a_degrees"):
        lines += _error_table(measured["e_a_degrees"])
    return "\n".join(lines)


def _error_table(errors: dict[str, dict[str, Any]]) -> list[str]:
    """E_a in degrees, one line a kind of mesh and one column a level of noise."""
    levels = sorted({level for row in errors.values() for level in row})
    width = max(map(len, errors))
    head = f"    {'E_a in degrees, noise':<{width}}" + "".join(f"{level:>8}" for level in levels)
    width = len(head) - 4 - 8 * len(levels)
    rows = [
        f"    {kind:<{width}}"
        + "".join(f"{row[level]:8.2f}" if level in row else " " * 8 for level in levels)
        for kind, row in errors.items()
    ]
    return [head, *rows]
