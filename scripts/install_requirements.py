"""Installs the dependencies of pyproject.toml and of one extra, without building the package itself."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10: pip brings its own copy
    from pip._vendor import tomli as tomllib


def requirements(extra: str) -> list[str]:
    """Returns the project's dependencies with those of an extra, extras that name extras resolved."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted, names = list(project["dependencies"]), [extra]
    while names:
        for requirement in project["optional-dependencies"][names.pop()]:
            own = re.fullmatch(r"gcnd\[(.+)\]", requirement)
            if own:
                names += own.group(1).split(",")
            else:
                wanted.append(requirement)
    return wanted


if __name__ == "__main__":
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    sys.exit(subprocess.call([*command, *requirements(sys.argv[1])]))
