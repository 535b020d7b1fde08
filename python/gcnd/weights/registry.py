"""Which weights ship with the package, and how a cascade is read from a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcnd.auto import CANDIDATES
from gcnd.errors import ConfigError, WeightsError
from gcnd.forks import refuse_fork
from gcnd.nn.cascade import Cascade, CascadeConfig
from gcnd.weights.files import load_header, load_tensors, save_tensors

if TYPE_CHECKING:
    import torch

LAYOUT_VERSION = 2
"""Version of features and configuration; weights of another version are refused."""

_FOLDER = Path(__file__).parent

_CARD = {"description": str, "n_parameters": int, "licence": str, "sha256": str}
"""What every card must say."""

_SHIPPED = ("default", "fast", "paper", "paper-scan", "scan")
"""Presets with weights in the package: ``<name>.safetensors`` with its card ``<name>.json``."""


@dataclass(frozen=True)
class ModelInfo:
    """One entry of ``gcnd models``.

    Attributes:
        name: What ``preset`` takes.
        description: One line.
        n_parameters: Trained numbers, all stages together.
        file_bytes: Size of the weights file.
        licence: Of the weights.
        sha256: Of the weights file, as the card states it.
        auto: Whether preset "auto", which is taken when none is named, may choose it.
        card: The whole model card: data, noise, steps, time, measured E_a.
    """

    name: str
    description: str
    n_parameters: int
    file_bytes: int
    licence: str
    sha256: str
    auto: bool
    card: dict[str, Any]


def list_models() -> list[ModelInfo]:
    """Lists the shipped weights with their cards."""
    models = []
    for name in _SHIPPED:
        card = _load_card(name)
        models.append(
            ModelInfo(
                name=name,
                description=card["description"],
                n_parameters=card["n_parameters"],
                file_bytes=(_FOLDER / f"{name}.safetensors").stat().st_size,
                licence=card["licence"],
                sha256=card["sha256"],
                auto=name in CANDIDATES,
                card=card,
            )
        )
    return models


def find_weights(preset: str, also: Sequence[str] = ()) -> Path:
    """Finds the file of a preset.

    Args:
        preset: A shipped name, or the path of a file with the ending ``.safetensors``.
        also: Names of no file that the caller takes beside these, for the error to name.

    Raises:
        ConfigError: No such preset.
        WeightsError: No such file.
    """
    is_path = str(preset).endswith(".safetensors")
    if not is_path and preset not in _SHIPPED:
        raise ConfigError(
            f"unknown preset {preset!r}, allowed: {', '.join((*also, *_SHIPPED))} "
            "or the path of a .safetensors file",
            hint="`gcnd models` lists the presets",
        )
    path = Path(preset) if is_path else _FOLDER / f"{preset}.safetensors"
    if not path.is_file():
        raise WeightsError(f"no such weights file: {path}", hint=None if is_path else "reinstall gcnd")
    return path


def weights_hash(preset: str, also: Sequence[str] = ()) -> str:
    """Returns the SHA-256 of a preset's file, in hexadecimal; arguments and errors as in ``find_weights``."""
    return hashlib.sha256(find_weights(preset, also).read_bytes()).hexdigest()


def load_cascade(preset: str, device: torch.device | str = "cpu") -> Cascade:
    """Loads a cascade in its inference form: evaluation mode, BatchNorm folded in.

    Args:
        preset: A shipped name, or the path of a file with the ending ``.safetensors``.
        device: Where the weights go.

    Raises:
        ConfigError: No such preset, or the device is not there.
        WeightsError: The file cannot be read, its hash or its layout does not match.
    """
    import torch

    target = checked_device(device)
    cascade = load_trainable(preset).for_inference()
    for name, tensor in cascade.state_dict().items():
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise WeightsError(
                f"{preset}: {name} leaves the range of numbers once its BatchNorm is folded in"
            )
    return cascade.to(target)


def load_config_of(preset: str) -> CascadeConfig:
    """Reads what a preset's file says of its networks, and no tensor; arguments and errors as in ``load_cascade``."""
    path = find_weights(preset)
    return _cascade_config(path, load_header(path))


def load_trainable(preset: str) -> Cascade:
    """Loads a cascade as it was trained, BatchNorm apart; arguments and errors as in ``load_cascade``."""
    import torch

    refuse_fork()
    path = find_weights(preset)
    if preset in _SHIPPED:
        _check_hash(path, _load_card(preset)["sha256"])
    tensors, header = load_tensors(path)
    config = _cascade_config(path, header)
    _check_tensors(path, config, tensors)
    # Whatever torch makes elsewhere by default.
    with torch.device("cpu"):
        cascade = Cascade(config).to(torch.float32)
    cascade.load_state_dict(tensors)
    return cascade


def save_cascade(path: Path, cascade: Cascade, header: dict[str, Any] | None = None) -> None:
    """Writes a cascade's weights and configuration to a ``.safetensors`` file, atomically."""
    whole = {"layout": LAYOUT_VERSION, "cascade": cascade.config.to_dict(), **(header or {})}
    save_tensors(path, cascade.state_dict(), whole)


def checked_device(device: torch.device | str) -> torch.device:
    """Returns the torch device of that name; raises ``ConfigError`` when this machine does not have it."""
    import torch

    try:
        found = torch.device(device)
    except RuntimeError as error:
        raise ConfigError(f"unknown device {device!r}", hint="cpu or cuda") from error
    if found.type not in ("cpu", "cuda"):
        raise ConfigError(f"device {device!r} is not supported", hint="cpu or cuda")
    if found.type == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device cuda is not available here", hint="use --device cpu")
    return found


def _load_card(name: str) -> dict[str, Any]:
    path = _FOLDER / f"{name}.json"
    try:
        card: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise WeightsError(f"cannot read the model card {path}: {error}", hint="reinstall gcnd") from error
    for key, kind in _CARD.items():
        if not isinstance(card, dict) or not isinstance(card.get(key), kind):
            raise WeightsError(f"the model card {path} has no {key}", hint="reinstall gcnd")
    return card


def _cascade_config(path: Path, header: dict[str, Any]) -> CascadeConfig:
    if header.get("layout") != LAYOUT_VERSION:
        raise WeightsError(
            f"{path} has feature layout {header.get('layout')}, this version of gcnd reads {LAYOUT_VERSION}",
            hint="train the weights again, or install the version that made them",
        )
    try:
        return CascadeConfig.from_dict(load_config(header))
    except ConfigError as error:
        raise WeightsError(f"{path} describes networks that this version does not know: {error}") from error


def load_config(header: dict[str, Any]) -> dict[str, Any]:
    """Returns the cascade's configuration from a file's header; raises ``ConfigError`` when there is none."""
    config = header.get("cascade")
    if not isinstance(config, dict):
        raise ConfigError("no cascade configuration")
    return config


def _check_hash(path: Path, expected: str) -> None:
    if hashlib.sha256(path.read_bytes()).hexdigest() != expected:
        raise WeightsError(
            f"{path} does not have the hash that its card states", hint="reinstall gcnd: the file is damaged"
        )


def _check_tensors(path: Path, config: CascadeConfig, tensors: dict[str, Any]) -> None:
    """Checks tensors against the description in the same file, before anything of the described size is allocated."""
    import torch

    try:
        with torch.device("meta"):
            described = Cascade(config).state_dict()
    except (RuntimeError, TypeError, ValueError, OverflowError) as error:
        raise WeightsError(f"{path} describes networks that cannot be: {error}") from error
    wanted = {name: tuple(tensor.shape) for name, tensor in described.items()}
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    for name in sorted(wanted.keys() | found.keys()):
        if wanted.get(name) != found.get(name):
            raise WeightsError(
                f"{path} does not fit its own description: {name} has shape {found.get(name)}, "
                f"expected {wanted.get(name)}"
            )
    for name, tensor in tensors.items():
        if tensor.is_floating_point() != described[name].is_floating_point():
            raise WeightsError(f"{path}: {name} has type {tensor.dtype}, expected {described[name].dtype}")
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise WeightsError(f"{path}: {name} has values that are not finite")


__all__ = [
    "ModelInfo",
    "checked_device",
    "find_weights",
    "list_models",
    "load_cascade",
    "load_config_of",
    "load_header",
    "save_cascade",
    "weights_hash",
]
