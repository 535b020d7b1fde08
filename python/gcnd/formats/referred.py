"""Files that a mesh file refers to by name, material libraries and textures, taken along to another folder."""

from __future__ import annotations

import json
import os
from codecs import BOM_UTF8
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from gcnd.errors import MeshError
from gcnd.formats.beside import can_be_name, find_beside, libraries_of_line
from gcnd.formats.parsed import DAMAGED_HINT
from gcnd.formats.ply_header import parse_header

__all__ = ["check_copies", "copies_of_referred", "paths_of_referred"]

_BLOCK_BYTES = 1 << 16


def copies_of_referred(data: bytes, source: Path, path: Path) -> dict[Path, bytes]:
    """Reads the files that belong beside `path` when `source` is written there under the same references.

    Only files in the folder of `source` or below it are taken along: references that lead elsewhere stay as they are,
    and so do those to files that are not there.

    Args:
        data: Contents of `source`.
        source: A mesh file.
        path: Where it will be written.

    Returns:
        Contents by path, of which folders may be missing; of what is there already, nothing.

    Raises:
        MeshError: Another file of such a name is there, or a file cannot be read.
    """
    to_folder = path.absolute().parent
    copies: dict[Path, bytes] = {}
    for name, found in _found(data, source).items():
        inner = PurePosixPath(name.replace("\\", "/"))
        if found is None or inner.is_absolute() or ".." in inner.parts:
            continue
        copy, content = to_folder / inner, _content(found)
        if _is_free(copy):
            copies[copy] = content
        elif not copy.is_file() or _content(copy) != content:
            raise MeshError(
                f"cannot write {path}: it refers to {name}, and {copy} is another file than {found}",
                "choose another folder for the result",
            )
    return copies


def check_copies(source: Path, path: Path) -> None:
    """Checks that what a mesh file refers to can be copied beside its result, before any long work.

    Args:
        source: A mesh file, as has been read before.
        path: Where its result will be written; of another format, it takes nothing along.

    Raises:
        MeshError: See `copies_of_referred`.
    """
    if source.suffix.lower() == path.suffix.lower():
        copies_of_referred(_content(source), source, path)


def paths_of_referred(source: Path, path: Path) -> list[Path]:
    """Lists the files of a run besides its input and its result, which nothing else may replace.

    Args:
        source: A mesh file, as has been read before.
        path: Where its result will be written.

    Returns:
        What `source` refers to, there or not, what will be beside `path` under such names, and its material library.

    Raises:
        MeshError: It cannot be read, or is damaged.
    """
    names = [name.replace("\\", "/") for name in _found(_head(source), source)]
    names += [PurePosixPath(name).name for name in names]
    libraries = [path.with_suffix(".mtl")] if path.suffix.lower() == ".obj" else []
    return [folder / name for folder in (source.parent, path.parent) for name in names] + libraries


def _found(data: bytes, source: Path) -> dict[str, Path | None]:
    """All names that a file and its material libraries refer to, and where they lie in its folder or below."""
    folder = source.absolute().parent
    found: dict[str, Path | None] = {}
    try:
        waiting = _referred(data, source.suffix.lower(), folder)
    except MeshError:
        raise
    except Exception as error:  # whatever a parser trips over is a fault of the file, not of its reader
        raise MeshError(f"cannot read {source}: {type(error).__name__}: {error}", DAMAGED_HINT) from error
    while waiting:
        name = waiting.pop()
        if name in found or not can_be_name(name):
            continue
        found[name] = library = find_beside(folder, name)
        if library is not None and library.suffix.lower() == ".mtl":
            waiting += _textures(_content(library))
    return found


def _head(source: Path) -> bytes:
    """As much of a mesh file as its references are in: the header of PLY, the JSON of GLB, all of OBJ."""
    extension = source.suffix.lower()
    if extension not in (".ply", ".glb"):
        return _content(source) if extension == ".obj" else b""
    try:
        with source.open("rb") as file:
            head = file.read(_BLOCK_BYTES)
            if extension == ".glb":
                n_json = min(int.from_bytes(head[12:16], "little"), source.stat().st_size)
                return head + file.read(max(20 + n_json - len(head), 0))
            while b"end_header" not in head[-2 * _BLOCK_BYTES :] and (block := file.read(_BLOCK_BYTES)):
                head += block
            return head
    except OSError as error:
        raise MeshError(f"cannot read {source}: {error.strerror or error}") from error


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise MeshError(f"cannot read {path}: {error.strerror or error}") from error


def _is_free(path: Path) -> bool:
    """Whether a file can be made there: there is nothing, and what is there of the folders above are folders."""
    above = next(folder for folder in path.parents if os.path.lexists(folder))
    return above.is_dir() and not os.path.lexists(path)


def _referred(data: bytes, extension: str, folder: Path) -> list[str]:
    if extension == ".obj":
        return [name for line in _rests(data, "mtllib") for name in libraries_of_line(folder, line)]
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
    text = data.removeprefix(BOM_UTF8).splitlines()
    lines = [line.decode("utf-8", errors="replace").strip().partition(" ") for line in text]
    return [rest.strip() for key, _, rest in lines if key.lower().startswith(keys) and rest.strip()]


def _textures(library: bytes) -> list[str]:
    """Images of a material library; a name is what follows the last option."""
    rests = _rests(library, "map_", "bump", "disp", "decal", "refl", "norm")
    # With options such as "-s 1 1 1" before it, only the last word is sure to be part of the name.
    return [rest.split()[-1] if rest.startswith("-") else rest for rest in rests]
