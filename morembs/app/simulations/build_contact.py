"""Contacts of a system file as the simulator takes them."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from morembs.app.simulations.built import Built
from morembs.app.simulations.contact_tables import ContactElementTable, ContactTable, SurfaceTable
from morembs.base.errors import InputError
from morembs.dynamics.multibody import (
    Contact,
    ContactElement,
    GridSurface,
    Marker,
    Plane,
    PowerLaw,
    Sphere,
    Surface,
    TriangleSurface,
)
from morembs.fem.selection import NUMBERS, nodes_in_region
from morembs.storage.csv_table import read_table


def contact_of(built: Built, table: ContactTable, name: str) -> Contact:
    """The contact of a table.

    Raises:
        InputError: markers, nodes or surfaces that there are not, or what the simulator refuses.
    """
    points = [marker for label in table.points for marker in _points(built, label)]
    given = table.compliance
    return Contact(
        points,
        surface_of(built, table.surface, name),
        on=built.marker(table.on),
        vertices=[built.marker(label) for label in table.vertices],
        friction=table.friction,
        restitution=table.restitution,
        axis=table.axis,
        compliance=given * np.eye(len(points)) if isinstance(given, float) else given,
        name=name,
    )


def element_of(built: Built, table: ContactElementTable, name: str) -> ContactElement:
    """The element of a table.

    Raises:
        InputError: as ``contact_of``.
    """
    first, second = built.pair(table.between)
    return ContactElement(
        first,
        second,
        stiffness=PowerLaw(table.stiffness, table.exponent),
        direction=table.direction,
        distance=table.distance,
        restitution=table.restitution,
        law=table.law,
        name=name,
    )


def _points(built: Built, label: str) -> list[Marker]:
    """A marker, or those of the nodes of a body in a region, "BODY:box:x0,y0,z0,x1,y1,z1"."""
    body, _, rest = label.partition(":")
    kind, _, numbers = rest.partition(":")
    if not numbers:
        return [built.marker(label)]
    if kind not in NUMBERS or body not in built.files:
        raise InputError(
            f"{label!r} was given; expected a marker, or nodes of a [[body]] by BODY:box:x0,y0,z0,x1,y1,z1 (or sphere, "
            "cylinder)",
            keyword="points",
        )
    stored = built.files[body][1]
    rows = nodes_in_region(stored.coordinates, kind, numbers)
    if not len(rows):
        raise InputError(
            f"{label!r} selects none of the {len(stored.node_ids)} nodes of the file; give coordinates in m",
            kind="unknown",
            keyword="points",
        )
    return [built.node(body, int(row), f"node_{stored.node_ids[row]}") for row in rows]


def surface_of(built: Built, table: SurfaceTable, name: str) -> Surface:
    """The surface of a table.

    Raises:
        InputError: a file that cannot be read, or what the simulator refuses.
    """
    if table.kind == "plane":
        return Plane(table.point, table.normal, name=name)
    if table.kind == "sphere":
        return Sphere(table.center, table.radius or 0.0, hollow=table.hollow, name=name)
    path = built.file.resolve(table.file or "")
    if table.kind == "triangles":
        return _triangles(path, name)
    columns = read_table(path, ("x", "y", "z"), what="the grid of a surface")
    points, count = np.stack([columns[key] for key in "xyz"], axis=1), table.columns or 1
    if len(points) % count:
        raise InputError(
            f"{path} has {len(points)} points; expected whole rows of columns = {count}", kind="file", keyword="columns"
        )
    return GridSurface(points.reshape(-1, count, 3), closed=table.closed, flip=table.flip, name=name)


def _triangles(path: Path, name: str) -> TriangleSurface:
    # Not at the top: few systems have such a surface.
    import meshio

    try:
        with warnings.catch_warnings():
            # Of the count of triangles that a text would have if it were a binary file.
            warnings.simplefilter("ignore", RuntimeWarning)
            mesh = meshio.read(path)
    except (OSError, SystemExit, ValueError, meshio.ReadError) as error:
        raise InputError(
            f"{path} cannot be read as a mesh of triangles ({error})", kind="file", keyword=path.name
        ) from error
    triangles = mesh.get_cells_type("triangle")
    if not len(triangles):
        raise InputError(
            f"{path} has no triangles with three nodes; expected a surface such as an .stl file", kind="file"
        )
    # Files such as STL name the corners of each triangle anew.
    points, at = np.unique(mesh.points, axis=0, return_inverse=True)
    return TriangleSurface(points, at.reshape(-1)[triangles], name=name)
