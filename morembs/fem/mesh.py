"""Nodes, solid elements and their sets. SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError, nearest
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.fem.arrays import freeze
from morembs.fem.material import Material
from morembs.fem.stored import sets_table
from morembs.fem.tolerances import TOL
from morembs.storage.table import dataset, derived, repeat_table, table_of


@checked
@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Nodes:
    """Nodes of a model.

    ``ids`` (n,) labels of the file the model came from; ``xyz`` (n, 3) coordinates in m;
    ``sets`` maps a name to rows of ``xyz`` (not labels), sorted.

    >>> nodes.sets["LEFT"]
    array([0, 1, 2, 3])
    """

    ids: Ints = dataset("whole", "N", "labels of the nodes in the source", name="nodes/ids")
    xyz: Floats = dataset("real", "N 3", units="m", name="nodes/coordinates", doc="of the nodes")
    sets: Mapping[str, Ints] = dataset(sets_table("N-1"), name="node_sets", default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", freeze(np.asarray(self.ids, dtype=np.int64)))
        object.__setattr__(self, "xyz", freeze(np.ascontiguousarray(self.xyz, dtype=np.float64)))
        object.__setattr__(self, "sets", MappingProxyType(dict(self.sets)))
        if self.xyz.shape != (len(self.ids), 3):
            raise InputError(
                f"nodes have {len(self.ids)} labels but coordinates of shape {self.xyz.shape}", keyword="nodes"
            )

    def __len__(self) -> int:
        return len(self.ids)

    def _facts(self) -> dict[str, object]:
        return {"count": len(self), "sets": list(self.sets)}


@checked
@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class ElementBlock:
    """Elements of one type.

    ``type`` is a name of ``morembs.fem.elements.TYPES``; ``nodes`` (ne, k) rows of ``Nodes.xyz`` in VTK
    order; ``ids`` (ne,) labels of the file. ``formulation`` of the strain and rule of the ``mass`` are names of
    ``FORMULATIONS`` and ``MASSES`` in ``morembs.fem.formulations``.

    >>> ElementBlock(type="hex8", nodes=cells, ids=np.arange(1, 5)).nodes.shape
    (4, 8)
    """

    type: str = dataset("words", "blocks", "of block_0, block_1, ...", name="types", beside=True)
    nodes: Ints = dataset("whole", "elements corners", "rows of /nodes, from 0, in VTK order", largest="solid-1")
    ids: Ints = dataset("whole", "elements", "labels of the elements in the source")
    formulation: str = dataset(
        "words",
        doc="of the strain, one of full, b-bar, mean-strain, incompatible, inner-modes, reduced, irons, bar",
        when="`full` without it",
        default="full",
    )
    mass: str = dataset(
        "words",
        doc="rule of the mass, one of exact, reduced, row-sum, irons, stroud",
        when="`exact` without it",
        default="exact",
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", freeze(np.ascontiguousarray(self.nodes, dtype=np.int64)))
        object.__setattr__(self, "ids", freeze(np.asarray(self.ids, dtype=np.int64)))


@checked
@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Nodes, solid elements and named element sets (name -> for each block the rows it holds).

    ``warnings`` are sentences about differences of a model assembled from the mesh from its source.

    Raises:
        InputError: coordinates beyond ``TOL.largest_number``.

    >>> mesh
    Mesh: nodes 20; elements 4 hex8; node sets LEFT, RIGHT; source bar
    """

    made_by: ClassVar[str] = "read_mesh(path, units)"

    nodes: Nodes

    @derived(
        "whole",
        "",
        "the first nodes are those of the elements",
        name="elements/node_count",
        read=True,
        counts="solid",
        largest="N",
    )
    def node_count(self) -> int:
        """Number of its nodes."""
        return len(self.nodes)

    blocks: tuple[ElementBlock, ...] = dataset(repeat_table(table_of(ElementBlock), "block"), name="elements")
    element_sets: Mapping[str, tuple[Ints, ...]] = dataset(
        sets_table(),
        default_factory=dict,
        doc="as `node_sets`; elements are counted through all blocks",
        write=lambda mesh: mesh.rows_of_sets,
    )
    source: str = dataset("words", name="elements/source", default="", doc="of the mesh")
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "element_sets", MappingProxyType(dict(self.element_sets)))
        refuse_far(self.nodes, self.source or "the mesh")

    @property
    def starts(self) -> Ints:
        """(blocks + 1,) number of the first element of each block, and that of all elements."""
        return np.cumsum([0, *(len(block.ids) for block in self.blocks)], dtype=np.int64)

    @property
    def rows_of_sets(self) -> dict[str, Ints]:
        """Elements of each set, counted through all blocks."""
        first = self.starts[:-1]
        return {
            name: np.concatenate([np.asarray(rows) + at for at, rows in zip(first, parts, strict=True)]).astype(
                np.int64
            )
            for name, parts in self.element_sets.items()
        }

    def with_rows_of_sets(self, sets: Mapping[str, Ints]) -> Mesh:
        """The mesh with these sets, each of elements counted through all blocks.

        Raises:
            InputError: elements that are not there.
        """
        found = {}
        for name, rows in sets.items():
            if len(rows) and not (rows.min() >= 0 and rows.max() < self.element_count):
                raise InputError(f"element set {name!r} names rows that do not exist")
            which = np.searchsorted(self.starts, rows, side="right") - 1
            found[name] = tuple(rows[which == b] - self.starts[b] for b in range(len(self.blocks)))
        return replace(self, element_sets=found)

    @property
    def element_count(self) -> int:
        """Number of elements of all blocks."""
        return sum(len(block.ids) for block in self.blocks)

    def _facts(self) -> dict[str, object]:
        kinds = ", ".join(f"{len(block.ids):,} {block.type}" for block in self.blocks)
        return {
            "nodes": len(self.nodes),
            "elements": kinds or 0,
            "node sets": list(self.nodes.sets),
            "element sets": list(self.element_sets),
            "source": self.source,
            "warnings": len(self.warnings) or None,
        }


def refuse_far(nodes: Nodes, source: str) -> None:
    """Refuse coordinates with whose volumes and moments of inertia nothing can be computed; unknown ones (NaN) pass.

    Raises:
        InputError: coordinates beyond ``TOL.largest_number``.
    """
    far = np.flatnonzero((np.abs(nodes.xyz) > TOL.largest_number).any(axis=1))
    if len(far):
        raise InputError(
            f"{source}: node {nodes.ids[far[0]]} is at {nodes.xyz[far[0]].tolist()}; the file is damaged, or the "
            f"units are wrong; expected coordinates up to {TOL.largest_number:g}",
            kind="file",
            keyword="nodes",
        )


def material_of_elements(mesh: Mesh, materials: Sequence[Material]) -> dict[int, Ints]:
    """For each block (by identity) the index of the material of each element.

    Raises:
        InputError: an unknown set, or an element with no or two materials.
    """
    owner = {id(block): np.full(len(block.ids), -1, dtype=np.int64) for block in mesh.blocks}
    for number, material in enumerate(materials):
        if material.set != "all" and material.set not in mesh.element_sets:
            raise InputError(
                f"material names the element set {material.set!r}, which the mesh does not have; "
                f"{nearest(material.set, ['all', *mesh.element_sets])}",
                kind="unknown",
                keyword="set",
            )
        for j, block in enumerate(mesh.blocks):
            chosen = np.arange(len(block.ids)) if material.set == "all" else mesh.element_sets[material.set][j]
            taken = owner[id(block)][chosen]
            if (taken >= 0).any():
                other = materials[int(taken[taken >= 0][0])].set
                raise InputError(
                    f"element {block.ids[chosen[taken >= 0][0]]} has two materials, of the sets {other!r} and "
                    f"{material.set!r}; give every element one",
                    kind="conflict",
                )
            owner[id(block)][chosen] = number
    for block in mesh.blocks:
        bare = np.flatnonzero(owner[id(block)] < 0)
        if len(bare):
            raise InputError(
                f"{len(bare)} elements have no material (first: {block.ids[bare[0]]}); add a material for their set, "
                f'or for set = "all" ([[material]] of a job, isotropic(set=...) in Python); '
                f"element sets: {', '.join(mesh.element_sets) or 'none'}",
                kind="missing",
                keyword="material",
            )
    return owner
