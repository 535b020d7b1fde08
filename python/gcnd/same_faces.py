"""Whether two meshes differ only in positions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gcnd.errors import MeshError

if TYPE_CHECKING:
    from gcnd.mesh_io import MeshArrays

__all__ = ["check_same_faces"]


def check_same_faces(
    first: MeshArrays, second: MeshArrays, names: tuple[str, str], hint: str | None = None
) -> None:
    """Checks that two meshes have the same faces in the same order: what compares face i with face i needs that.

    Args:
        first: One mesh.
        second: The other.
        names: What the error calls them.
        hint: What the error advises.

    Raises:
        MeshError: The numbers of faces differ, or a face has other corners.

    Example:
        >>> import numpy as np
        >>> from gcnd.mesh_io import to_arrays
        >>> two = [to_arrays((np.eye(3), [corners]))[0] for corners in ([0, 1, 2], [1, 2, 0])]
        >>> check_same_faces(two[0], two[1], ("a.ply", "b.ply"))
        Traceback (most recent call last):
        gcnd.errors.MeshError: face 0 is (0, 1, 2) in a.ply and (1, 2, 0) in b.ply
    """
    if len(first.faces) != len(second.faces):
        raise MeshError(
            f"{names[0]} has {len(first.faces)} faces and {names[1]} has {len(second.faces)}", hint
        )
    differs = (first.faces != second.faces).any(axis=1)
    if differs.any():
        face_id = int(differs.argmax())
        corners = [tuple(mesh.faces[face_id].tolist()) for mesh in (first, second)]
        raise MeshError(f"face {face_id} is {corners[0]} in {names[0]} and {corners[1]} in {names[1]}", hint)
