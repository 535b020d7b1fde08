"""`gcnd models`: the weights that come with gcnd."""

from __future__ import annotations

from gcnd.cli.options import JsonFlag, print_json

__all__ = ["run"]

_FIELDS = ("name", "description", "n_parameters", "file_bytes", "licence", "sha256", "default")


def run(as_json: JsonFlag = False) -> None:
    """List the weights that come with gcnd."""
    from gcnd.weights import list_models

    models = list_models()
    if as_json:
        print_json([{name: getattr(model, name) for name in _FIELDS} for model in models])
        return
    for model in models:
        size = f"{model.n_parameters:,} weights, {model.file_bytes / 1e6:.1f} MB, {model.licence}"
        print(f"{model.name}{' (default)' if model.default else ''}: {size}\n    {model.description}")
