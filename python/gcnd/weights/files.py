"""Tensors with a JSON header in a safetensors file: written atomically, read with its layout checked."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from gcnd.errors import WeightsError
from gcnd.formats.atomic import write_atomic

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

_HEADER = "gcnd"


def save_tensors(path: Path, tensors: dict[str, Tensor], header: dict[str, Any]) -> None:
    """Writes tensors and a JSON header to ``path`` so that a kill leaves the old file or the new one."""
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    write_atomic(path, save(whole, metadata={_HEADER: json.dumps(header, sort_keys=True)}))


def load_header(path: Path) -> dict[str, Any]:
    """Reads only the JSON header; raises ``WeightsError`` when ``path`` is not a file of ``save_tensors``."""
    return _read(path, with_tensors=False)[1]


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Reads what ``save_tensors`` wrote; raises ``WeightsError`` when it is something else."""
    return _read(path, with_tensors=True)


def _read(path: Path, with_tensors: bool) -> tuple[dict[str, Tensor], dict[str, Any]]:
    if not path.is_file():
        raise WeightsError(f"no such weights file: {path}")
    try:
        with safe_open(str(path), framework="pt") as file:
            metadata = file.metadata() or {}
            names = file.keys() if with_tensors else []
            tensors = {name: file.get_tensor(name) for name in names}
        header: dict[str, Any] = json.loads(metadata[_HEADER])
        if not isinstance(header, dict):
            raise ValueError("its description is no object")
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        raise WeightsError(
            f"cannot read {path}: {error}", hint="the file is not a weights file, or it is cut short"
        ) from error
    except KeyError:
        raise WeightsError(
            f"{path} does not say which networks it holds",
            hint="only files that gcnd wrote can be loaded",
        ) from None
    return tensors, header
