"""Fixtures that more than one file of tests takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cli_cases import replace_denoiser, write_mesh


@pytest.fixture
def mesh_path(tmp_path: Path) -> Path:
    return write_mesh(tmp_path)


@pytest.fixture
def denoise_calls(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    return replace_denoiser(monkeypatch)
