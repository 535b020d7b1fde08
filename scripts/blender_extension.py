"""Packs the Blender extension: dist/gcnd_denoise-VERSION.zip, the same bytes from the same files.

python scripts/blender_extension.py
python scripts/blender_extension.py --out somewhere
"""

from __future__ import annotations

import argparse
import re
import zipfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "plugins" / "blender" / "gcnd_denoise"
LICENCE = ROOT / "LICENSE-MIT"

TIME = (1980, 1, 1, 0, 0, 0)
"""The earliest that a zip file can hold, so that none is told apart by when it was made."""


def version(source: Path = SOURCE) -> str:
    """Returns the version that the manifest states."""
    match = re.search(r'^version = "([^"]+)"$', (source / "blender_manifest.toml").read_text("utf-8"), re.M)
    if match is None:
        raise SystemExit(f"error: {source / 'blender_manifest.toml'} states no version")
    return match[1]


def files(source: Path = SOURCE) -> dict[str, Path]:
    """Returns what goes into the extension, by its name there."""
    own = sorted([*source.glob("*.py"), source / "blender_manifest.toml"])
    return {path.name: path for path in own} | {LICENCE.name: LICENCE}


def pack(folder: Path, source: Path = SOURCE) -> Path:
    """Writes the extension into a folder; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{source.name}-{version(source)}.zip"
    with zipfile.ZipFile(path, "w") as packed:
        for name, file in files(source).items():
            info = zipfile.ZipInfo(name, TIME)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            packed.writestr(info, file.read_bytes())
    return path


def main() -> None:
    """Packs the extension and prints its path."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zip file")
    print(pack(parser.parse_args().out))


if __name__ == "__main__":
    main()
