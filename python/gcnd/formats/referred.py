"""Files that a mesh file refers to by name, material libraries and textures, taken along to another folder."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from gcnd.errors import MeshError
from gcnd.formats.beside import find_beside
from gcnd.formats.ply_header import parse_header

__all__ = ["copies_of_referred"]


def copies_of_referred(data: bytes, source: Path, path: Path) -> dict[Path, bytes]:
    """Reads the files that belong beside `path` when `source` is written there under the same references.

    Only files in the folder of `source` or below it are taken along: references that lead elsewhere stay as they are,
    and so do those to files that are not there.

    Args:
        data: Contents of `source`.
        source: A mesh file.
        path: Where it will be written.

    Returns:
        Contents by path; of what is there already, nothing.

    Raises:
        MeshError: Another file of such a name is there.
    """
    from_folder, to_folder = source.absolute().parent, path.absolute().parent
    copies: dict[Path, bytes] = {}
    waiting = _referred(data, source.suffix.lower())
    while waiting:
        name = waiting.pop()
        inner = PurePosixPath(name.replace("\\", "/"))
        copy = to_folder / inner
        if inner.is_absolute() or ".." in inner.parts or copy in copies:
            continue
        found = find_beside(from_folder, name)
        if found is None:
            continue
        content = found.read_bytes()
        waiting += _textures(content) if inner.suffix.lower() == ".mtl" else []
        if not copy.exists():
            copies[copy] = content
        elif copy.read_bytes() != content:
            raise MeshError(f"{copy} is another file than {found}", "choose another folder for the result")
    for copy in copies:
        copy.parent.mkdir(parents=True, exist_ok=True)
    return copies


def _referred(data: bytes, extension: str) -> list[str]:
    if extension == ".obj":
        return _rests(data, "mtllib")
    if extension == ".ply":
        texture = parse_header(data[3:] if data[:1] == b"\xef" else data).texture
        return [] if texture is None else [texture]
    if extension == ".glb":
        images = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")]).get("images", [])
        uris = [str(image.get("uri", "data:")) for image in images]
        return [unquote(uri) for uri in uris if not uri.startswith("data:")]
    return []


def _rests(data: bytes, *keys: str) -> list[str]:
    """What follows a keyword at the beginning of a line, without the keyword."""
    lines = [line.strip().partition(" ") for line in data.decode("utf-8", errors="replace").splitlines()]
    return [rest.strip() for key, _, rest in lines if key.lower().startswith(keys) and rest.strip()]


def _textures(library: bytes) -> list[str]:
    """Images of a material library; a name is what follows the last option."""
    rests = _rests(library, "map_", "bump", "disp", "decal", "refl", "norm")
    # With options such as "-s 1 1 1" before it, only the last word is sure to be part of the name.
    return [rest.split()[-1] if rest.startswith("-") else rest for rest in rests]
