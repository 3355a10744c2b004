"""Tables of contact: points on surfaces, which meet in impacts, and elements that are forces."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Annotated, Literal

from morembs.app.jobs.tables import Three
from morembs.app.simulations.keys import ORIGIN, Between, MarkerName, OptionalName, refuse_foreign
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key
from morembs.base.limits import Finite, NotNegative, Positive, Restitution, length, number, text

Points = Annotated[list[MarkerName], length("one or more", 1, sys.maxsize)]


@dataclass(frozen=True, kw_only=True)
class SurfaceTable(Table):
    """A surface along the axes of the marker that carries it."""

    kind: Literal["plane", "sphere", "grid", "triangles"] = "plane"
    point: Three = declare_key("[x, y, z] m, of a plane", ORIGIN)
    normal: Three = declare_key("[x, y, z] to where the points may be, of a plane", [0.0, 0.0, 1.0])
    center: Three = declare_key("[x, y, z] m, of a sphere", ORIGIN)
    radius: Positive | None = declare_key("m, of a sphere", None)
    hollow: bool = declare_key("true where the points are inside, of a sphere", False)
    file: Annotated[str, text('the path of a file such as "track.csv" or "hull.stl"')] | None = declare_key(
        "of a grid a .csv file with the columns x, y, z; of triangles a mesh with them", None
    )
    columns: Annotated[int, number("a count of points, 2 or more", ge=2)] | None = declare_key(
        "points in a row of the grid: the file has them row by row", None
    )
    closed: bool = declare_key("true joins the last row of a grid to the first", False)
    flip: bool = declare_key("true turns the normal of a grid", False)

    def refuse_conflicts(self) -> None:
        grid = {"file", "columns", "closed", "flip"}
        keys = {"plane": {"point", "normal"}, "sphere": {"center", "radius", "hollow"}, "grid": grid}
        refuse_foreign(self, self.kind, {**keys, "triangles": {"file"}})
        needed = {"plane": (), "sphere": ("radius",), "grid": ("file", "columns"), "triangles": ("file",)}
        for key in needed[self.kind]:
            if getattr(self, key) is None:
                raise InputError(
                    f'kind = "{self.kind}" was given without {key}; add it', kind="conflict", keyword="kind"
                )


@dataclass(frozen=True, kw_only=True)
class ContactTable(Table):
    """``[[contact]]``: points of one body that cannot enter a surface of another; their touches are impacts."""

    points: Points = declare_key(
        'markers of one body such as ["ball:c"], or nodes of an elastic one such as ["plate:box:0,0,0,1,1,0"]'
    )
    on: MarkerName = declare_key("the marker that carries the surface", "ground")
    surface: SurfaceTable = field(default_factory=SurfaceTable)
    vertices: list[MarkerName] = declare_key("markers that a grid or triangles follow, one for each point", [])
    friction: NotNegative = declare_key("coefficient of Coulomb's law", 0.0)
    restitution: Restitution = 0.0
    axis: Three = declare_key("[x, y, z] in the axes of on: the first component of friction", [1.0, 0.0, 0.0])
    compliance: Positive | list[list[Finite]] | None = declare_key(
        "m/N of each point, or a matrix of the normals", None
    )
    name: OptionalName = declare_key("a name; contact_1, contact_2, ... unless given", "")


@dataclass(frozen=True, kw_only=True)
class ContactElementTable(Table):
    """``[[contact_element]]``: a point that pushes itself off another by the stiffness of its penetration."""

    between: Between
    stiffness: Positive = declare_key("N/m^exponent")
    exponent: Positive = 1.5
    direction: Three | None = declare_key("[x, y, z] out of the second body, along its marker; of balls none", None)
    distance: Finite = declare_key("m between the markers where the bodies touch", 0.0)
    restitution: Restitution = 1.0
    law: Literal["flores", "hunt-crossley", "lankarani-nikravesh"] = "flores"
    name: OptionalName = declare_key("a name; contact_element_1, ... unless given", "")
