"""Writes THIRD-PARTY-LICENSES: the licence texts of the crates that are linked into the compiled module.

    python scripts/third_party_licenses.py            # writes the file
    python scripts/third_party_licenses.py --check    # fails where Cargo.lock has other crates than the file

Crates are those that gcnd_py depends on, for the targets of deny.toml; macros and build scripts run at compile time
only and are not in it. Texts are those that come with the crates' sources, each once.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
TARGET_FILE = ROOT / "THIRD-PARTY-LICENSES"
LINKED_INTO = "gcnd_py"
TEXTS = re.compile(r"(LICEN[CS]E|COPYING|COPYRIGHT|NOTICE|UNLICENSE)(?!.*GPL)", re.IGNORECASE)
"""Names of texts; where a crate offers the GPL as well, it is used under the other licence."""
RULE = "=" * 100
HEAD = """\
The compiled module of gcnd (gcnd/_geom) holds code of the crates below, and of the Rust standard library
(The Rust Project Contributors, MIT OR Apache-2.0). Their licence texts follow, each once; a crate that comes without a
text of its own is under the licence that its line names, with the authors that it names, in the words in which other
crates have it here. Where one may be had under the GPL as well, it is used under the other licence.

Made by scripts/third_party_licenses.py.
"""


def targets() -> list[str]:
    """Lists the targets that wheels are made for, as deny.toml has them."""
    line = next(line for line in (ROOT / "deny.toml").read_text().splitlines() if line.startswith("targets"))
    return re.findall(r'"([^"]+)"', line)


def linked_crates(metadata: dict[str, Any]) -> list[dict[str, Any]]:
    """Lists the packages of `cargo metadata` that are linked into the module, those of this workspace left out."""
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    waiting = [id_ for id_, package in packages.items() if package["name"] == LINKED_INTO]
    seen = set(waiting)
    while waiting:
        for dependency in nodes[waiting.pop()]["deps"]:
            id_ = dependency["pkg"]
            is_linked = any(kind["kind"] is None for kind in dependency["dep_kinds"])
            is_macro = any("proc-macro" in target["kind"] for target in packages[id_]["targets"])
            if is_linked and not is_macro and id_ not in seen:
                seen.add(id_)
                waiting.append(id_)
    found = [packages[id_] for id_ in seen if packages[id_]["source"] is not None]
    return sorted(found, key=lambda package: (package["name"], package["version"]))


def title(package: dict[str, Any]) -> str:
    """Returns a crate's line: name, version and licence."""
    return f"{package['name']} {package['version']} ({package['license'] or 'see its text'})"


def texts_of(package: dict[str, Any]) -> list[str]:
    """Reads the licence texts at the root of a crate's sources and in its folder of licences."""
    folder = Path(package["manifest_path"]).parent
    places = [folder, *(path for path in folder.iterdir() if path.is_dir() and TEXTS.match(path.name))]
    paths = sorted(
        path for place in places for path in place.iterdir() if path.is_file() and TEXTS.match(path.name)
    )
    lines = [path.read_text(encoding="utf-8", errors="replace").splitlines() for path in paths]
    return ["\n".join(line.rstrip() for line in text).strip("\n") for text in lines]


def document(packages: list[dict[str, Any]]) -> str:
    """Returns the whole file."""
    owners: dict[str, list[str]] = {}
    without = []
    for package in packages:
        texts = texts_of(package)
        if not texts:
            without.append(", ".join([title(package), *package["authors"]]))
        for text in dict.fromkeys(texts):
            owners.setdefault(text, []).append(title(package))
    parts = [HEAD + "\n" + "\n".join(map(title, packages))]
    if without:
        parts.append("Without a text of their own:\n\n" + "\n".join(without))
    parts += ["\n".join(names) + "\n\n" + text for text, names in owners.items()]
    return f"\n\n{RULE}\n".join(parts) + "\n"


def missing(packages: list[dict[str, Any]], text: str) -> list[str]:
    """Lists the crates that a file does not name."""
    lines = set(text.splitlines())
    return [line for line in map(title, packages) if line not in lines]


def all_linked_crates() -> list[dict[str, Any]]:
    """Asks cargo for the crates of all targets; fetches sources that are not here."""
    found: dict[str, dict[str, Any]] = {}
    for target in targets():
        command = ["cargo", "metadata", "--locked", "--format-version", "1", "--filter-platform", target]
        told = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
        found |= {package["id"]: package for package in linked_crates(json.loads(told))}
    return sorted(found.values(), key=lambda package: (package["name"], package["version"]))


def main() -> int:
    """Writes or checks the file; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--check", action="store_true", help="only say which crates the file does not name")
    packages = all_linked_crates()
    if parser.parse_args().check:
        absent = missing(packages, TARGET_FILE.read_text(encoding="utf-8") if TARGET_FILE.exists() else "")
        print(
            "\n".join(f"no licence text: {line}" for line in absent) or f"{len(packages)} crates, all named"
        )
        return 1 if absent else 0
    TARGET_FILE.write_text(document(packages), encoding="utf-8")
    print(f"wrote {TARGET_FILE.name}: {len(packages)} crates")
    return 0


if __name__ == "__main__":
    sys.exit(main())
