"""Readers of mesh files; the table below is the contents page.

A reader takes a path and returns a ``Mesh`` in the units of the file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from morembs.errors import InputError
from morembs.importers.abaqus import read_abaqus
from morembs.importers.meshes import read_with_meshio
from morembs.model import Mesh, Nodes
from morembs.units import Units

# Endings with a reader of their own; every other mesh goes through meshio.
READERS: dict[str, Callable[[Path], Mesh]] = {".inp": read_abaqus}


def read_mesh(path: str | Path, units: Units | None = None) -> Mesh:
    """Mesh with node sets and element sets, coordinates in m.

    Raises:
        InputError: the file is missing, cannot be read, or has elements of an unsupported type.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise InputError(f"mesh {str(path)!r} is not a file; expected a mesh file such as conrod.msh")
    if not path.is_file():
        raise InputError(f"mesh file {str(path)!r} does not exist; check the path")
    mesh = READERS.get(path.suffix.lower(), read_with_meshio)(path)
    if not mesh.blocks:
        raise InputError(f"{path.name} has no solid elements; a volume mesh is needed (tet, hex or wedge)")
    nodes = mesh.nodes
    scaled = Nodes(ids=nodes.ids, xyz=nodes.xyz * (units or Units()).length, sets=nodes.sets)
    return replace(mesh, nodes=scaled, source=path.name)
