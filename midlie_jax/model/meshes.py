"""Files of shape models: tables of vertices and faces, and the formats of trimesh; and their repair."""

from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

_TABLES = {".txt", ".tab", ".tbl", ".dat", ".plt", ".ver", ".shape", ".asc", ".mod", ".wf"}


def read_mesh(path: str | PathLike[str], repair: bool) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and faces (n, 3) from 0."""
    table = _table(path) if Path(path).suffix.lower() in _TABLES else None
    if table is not None and not repair:
        return table
    try:
        import trimesh
    except ImportError as error:
        raise ImportError("reading a surface needs trimesh: pip install 'midlie_jax[surfaces]'.") from error
    try:
        mesh: Any = trimesh.load_mesh(str(path)) if table is None else trimesh.Trimesh(*table, process=False)
    except NotImplementedError as error:
        raise ValueError(f"trimesh cannot read {path}: {error}; give an OBJ, STL or PLY file.") from error
    if not len(getattr(mesh, "faces", ())):
        raise ValueError(f"{path} holds no triangles; give the file of a surface.")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if repair:
        mesh.update_faces(mesh.unique_faces() & mesh.nondegenerate_faces())
        trimesh.repair.fix_winding(mesh)
        mesh.fill_holes()
        trimesh.repair.fix_normals(mesh, multibody=True)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _table(path: str | PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    lines = [line.split("#")[0].replace(",", " ").split() for line in Path(path).read_text().splitlines()]
    lines = [line for line in lines if line]
    try:
        vertices, faces = _lettered(lines) if lines and lines[0][0] in "vf" else _counted(lines)
    except (ValueError, IndexError) as error:
        raise ValueError(
            f"{path} is no table of a surface: the numbers of vertices and faces, then their rows; give an OBJ, STL or "
            "PLY file."
        ) from error
    return vertices, faces.astype(int) - min(1, int(faces.min()))  # each vertex belongs to a face: the least is 0 or 1


def _lettered(lines: list[list[str]]) -> Any:
    return tuple(np.array([line[1:4] for line in lines if line[0] == name], float) for name in "vf")


def _counted(lines: list[list[str]]) -> Any:
    numbers = np.array([word for line in lines for word in line], float)
    together = len(lines[0]) == 2
    vertices = int(numbers[0])
    # A row of four begins with its index, or with the number of corners.
    for width, corners in product((3, 4), repeat=2):
        begin = 1 + together
        end = begin + width * vertices
        faces = int(numbers[1] if together else numbers[end] if end < len(numbers) else -1)
        rest = end + (not together)
        if faces > 0 and len(numbers) == rest + corners * faces:
            rows = numbers[begin:end].reshape(-1, width), numbers[rest:].reshape(-1, corners)
            return rows[0][:, -3:], rows[1][:, -3:]
    raise ValueError("the numbers of rows do not fit")
