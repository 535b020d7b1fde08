"""A few seeded cases of every entry; `scripts/fuzz.py` runs many, the same way."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz_cases import CASES, run_case

N_CASES, SEED = 40, 20_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.mark.parametrize("name", CASES)
def test_random_input_is_worked_on_or_refused(name: str, folder: Path) -> None:
    accepted = 0
    for number in range(N_CASES):
        try:
            accepted += run_case(name, SEED, number, folder)
        except BaseException:
            print(f'again: python scripts/fuzz.py --only "{name}" --seed {SEED} --first {number} --cases 1')
            raise
    # Neither all nor none: a drawing that only one of the two paths sees tests nothing.
    assert accepted > 0
    assert accepted < N_CASES or name == "core: weld"
