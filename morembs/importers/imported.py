"""What comes out of a file of another program, before it becomes a finite-element model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Floats, Ints
from morembs.fem import DofMap, Mesh, NamedColumns, Nodes, freeze
from morembs.fem.constraints import AverageElement, Equations, RigidElement
from morembs.fem.material import Material


@dataclass(frozen=True, kw_only=True, eq=False)
class PointMass:
    """``mass`` and ``inertia`` (3, 3) about its centre, which is at ``offset`` (3,) from the node in row ``node``."""

    name: str
    node: int
    mass: float
    inertia: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    offset: Floats = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("inertia", "offset"):
            object.__setattr__(self, name, freeze(np.asarray(getattr(self, name), dtype=np.float64)))


@dataclass(frozen=True, kw_only=True, eq=False)
class DiscreteElement:
    """Entries of one matrix between a few dofs: a spring, a dashpot, a mass that differs by direction.

    ``matrix`` "K", "M" or "D"; ``nodes`` (d,) rows and ``components`` (d,) of the dofs; ``values`` (d, d).
    """

    name: str
    matrix: str
    nodes: Ints
    components: Ints
    values: Floats

    def __post_init__(self) -> None:
        for name in ("nodes", "components"):
            object.__setattr__(self, name, freeze(np.asarray(getattr(self, name), dtype=np.int64)))
        object.__setattr__(self, "values", freeze(np.asarray(self.values, dtype=np.float64)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Lacking:
    """What the material of an element set lacks, in a ``sentence``; its ``stiffness`` (6, 6) where only the density is
    missing."""

    sentence: str
    stiffness: Floats | None = None


Tied = TypeVar("Tied", RigidElement, AverageElement, Equations, PointMass, DiscreteElement)
Ties = RigidElement | AverageElement | Equations | PointMass | DiscreteElement


def nodes_of(elements: Iterable[Ties]) -> Ints:
    """Rows of the nodes that ``elements`` are on, ascending."""
    rows: list[Ints] = [np.empty(0, dtype=np.int64)]
    for element in elements:
        if isinstance(element, RigidElement):
            rows.append(np.append(element.slaves, element.master))
        elif isinstance(element, AverageElement):
            rows.append(np.append(element.nodes, element.reference))
        elif isinstance(element, Equations):
            rows += [element.nodes, element.term_nodes]
        elif isinstance(element, DiscreteElement):
            rows.append(element.nodes)
        else:
            rows.append(np.array([element.node]))
    return np.unique(np.concatenate(rows)).astype(np.int64)


def on_rows(elements: Iterable[Tied], row: Ints | Callable[[Ints], Ints]) -> tuple[Tied, ...]:
    """The elements on other rows (or labels) of their nodes: ``row`` (n,) by the present ones, or what gives them."""
    new: Callable[[Ints], Ints] = row if callable(row) else row.__getitem__

    def move(element: Tied) -> Tied:
        change: dict[str, Any]
        if isinstance(element, RigidElement):
            change = {"master": int(new(np.array(element.master))), "slaves": new(element.slaves)}
        elif isinstance(element, AverageElement):
            change = {"reference": int(new(np.array(element.reference))), "nodes": new(element.nodes)}
        elif isinstance(element, Equations):
            change = {"nodes": new(element.nodes), "term_nodes": new(element.term_nodes)}
        elif isinstance(element, DiscreteElement):
            change = {"nodes": new(element.nodes)}
        else:
            change = {"node": int(new(np.array(element.node)))}
        return replace(element, **change)

    return tuple(map(move, elements))


def sets_on(sets: Mapping[str, Ints], row: Ints) -> dict[str, Ints]:
    """Sets of nodes on the new rows ``row`` (n,) of these, ascending, without nodes that have none (-1)."""
    moved = {name: np.sort(row[rows][row[rows] >= 0]) for name, rows in sets.items()}
    return {name: rows for name, rows in moved.items() if len(rows)}


def picked_nodes(nodes: Nodes, kept: Ints) -> Nodes:
    """The nodes in the rows ``kept`` (k,), in this order, and the sets on them."""
    row = np.full(len(nodes), -1, dtype=np.int64)
    row[kept] = np.arange(len(kept))
    return Nodes(ids=nodes.ids[kept], xyz=nodes.xyz[kept], sets=sets_on(nodes.sets, row))


def first_nodes(nodes: Nodes, count: int) -> Nodes:
    """The first ``count`` nodes and the sets on them."""
    return nodes if count == len(nodes) else picked_nodes(nodes, np.arange(count))


@dataclass(frozen=True, kw_only=True, eq=False)
class Imported:
    """All that a file holds, in the units of the file.

    Matrices ``K``, ``M``, ``D``, ``G``, ``N`` (N, N) as they are there (whole, not half; real or complex, symmetric or
    not) with ``dofs``, and ``inputs`` and ``outputs`` (columns of B, rows of C) on them; or a ``mesh`` with
    ``materials``; or both. ``nodes`` may carry sets. ``surfaces`` name -> rows of nodes.
    ``notes`` say in a sentence each what was found and what the file holds that a model cannot carry; ``warnings``
    what makes the model another one than that of the file, beside what ``mesh`` warns of. ``incomplete`` maps an
    element set to what its material lacks: such a model is refused until the set has one. ``seams`` says that the
    program of the file takes meshes in which faces of elements that meet differ.
    """

    source: str
    K: sp.csr_array | None = None
    M: sp.csr_array | None = None
    D: sp.csr_array | None = None
    G: sp.csr_array | None = None
    N: sp.csr_array | None = None
    nodes: Nodes | None = None
    dofs: DofMap | None = None
    mesh: Mesh | None = None
    materials: tuple[Material, ...] = ()
    rigid: tuple[RigidElement, ...] = ()
    average: tuple[AverageElement, ...] = ()
    equations: tuple[Equations, ...] = ()
    masses: tuple[PointMass, ...] = ()
    discrete: tuple[DiscreteElement, ...] = ()
    inputs: NamedColumns | None = None
    outputs: NamedColumns | None = None
    surfaces: Mapping[str, Ints] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    incomplete: Mapping[str, Lacking] = field(default_factory=dict)
    seams: bool = False

    @property
    def ties(self) -> list[Ties]:
        """All that joins nodes or hangs on them."""
        return [*self.rigid, *self.average, *self.equations, *self.masses, *self.discrete]

    def on_rows(self, row: Ints | Callable[[Ints], Ints]) -> Imported:
        """With its ties on other rows of their nodes, as ``on_rows`` of ties has them."""
        return replace(
            self,
            rigid=on_rows(self.rigid, row),
            average=on_rows(self.average, row),
            equations=on_rows(self.equations, row),
            masses=on_rows(self.masses, row),
            discrete=on_rows(self.discrete, row),
        )
