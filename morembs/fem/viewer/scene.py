"""What a viewer shows: surfaces, what moves on them, and groups of their nodes and triangles with names. SI units."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from morembs.base.types import Floats, Ints

NONE: Ints = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """Triangles (nt, 3), rows of ``points`` (n, 3) m with the labels ``node_ids`` (n,); points behind those of the
    triangles are of groups alone. The bits 1, 2, 4 of ``sides`` (nt,) say which sides of a triangle are edges of
    elements: from its first corner to its second, and so on. ``note`` says what the picture leaves out."""

    points: Floats
    node_ids: Ints
    triangles: Ints
    sides: Ints
    note: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Displacements ``shapes`` (k, n, 3) of a surface: eigenmodes of a body with the frequencies ``values`` (k,) in Hz,
    or with ``over_time`` the steps of a motion at these times in s, in m. ``stress`` (k, n) is von Mises stress of any
    scale (of steps in Pa), NaN where it is unknown."""

    name: str
    surface: int
    shapes: Floats
    values: Floats
    over_time: bool = False
    stress: Floats | None = None


Kind = Literal["elements", "nodes", "coupling", "interface", "error", "warning", "note"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Group:
    """Some of a surface under one name: rows of its ``triangles``, rows of its points (``nodes``), and ``lines`` (k, 2)
    between points. ``select`` is the selection of a job that means it, ``about`` a sentence."""

    name: str
    kind: Kind
    triangles: Ints = field(default_factory=lambda: NONE)
    nodes: Ints = field(default_factory=lambda: NONE)
    lines: Ints = field(default_factory=lambda: NONE.reshape(0, 2))
    count: int = 0
    about: str = ""
    select: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Feature:
    """A face or a hole of the skin that a click may mean: its ``triangles``, and the selection of a job for it."""

    select: str
    about: str
    triangles: Ints
