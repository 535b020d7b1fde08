"""Fixtures that more than one file of tests takes."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import replace_denoiser, write_mesh


def pytest_configure() -> None:
    """Signals as in a terminal: what starts tests behind its back may have them ignored, and so would every child."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)


@pytest.fixture
def mesh_path(tmp_path: Path) -> Path:
    return write_mesh(tmp_path)


@pytest.fixture(scope="session")
def preset(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The path of a small cascade with random weights."""
    # Torch takes a second to import, and most tests need none.
    from denoise_cases import write_random_weights

    return write_random_weights(tmp_path_factory.mktemp("weights"))


@pytest.fixture(scope="session")
def result(preset: str) -> NDArray[np.float64]:
    """What that cascade makes of the noisy sphere."""
    from denoise_cases import denoised_sphere

    return denoised_sphere(preset)


@pytest.fixture
def denoise_calls(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    return replace_denoiser(monkeypatch)
