"""Parts of an input deck in their places: one numbering of nodes and elements, sets as rows of it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import ElementBlock
from morembs.fem.elements import TYPES
from morembs.fem.middle_nodes import in_order
from morembs.importers.abaqus.deck import Contents, Instance, values
from morembs.importers.abaqus.names import Discrete, Names, Placed, of_instance
from morembs.importers.decks.algebra import rotation_about
from morembs.importers.decks.labels import Labels, distinct
from morembs.importers.tolerances import TOL

# Type, formulation and mass of solids.
Kind = tuple[str, str, str]
_NONE = np.empty(0, dtype=np.int64)


class Assembly(Names):
    """All nodes (n, 3) and elements of a deck, and what its names mean.

    Elements are numbered block by block, behind the solids those on single nodes, and behind these ``others`` (type,
    labels, rows of nodes), which are not assembled here.
    """

    def __init__(self, deck: Contents) -> None:
        super().__init__()
        self.deck = deck.name
        self.problems = deck.problems
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.top = Placed("", [deck.top], np.eye(3))
        self.placed: dict[str, Placed] = {}
        node_parts: list[tuple[Placed, Ints, Floats]] = []
        for key, instance in deck.instances.items():
            contents = [deck.parts[instance.part]] if instance.part else []
            R, shift, point = _motion(instance)
            placed = self.placed[key] = Placed(
                instance.scope.name, [*contents, instance.scope], R, R @ (shift - point) + point
            )
            ids, xyz = _gather(placed)
            moved = xyz if not instance.moves else (xyz + shift - point) @ R.T + point
            node_parts.append((placed, ids, moved))
        self._warn_of_unused(deck)
        node_parts.append((self.top, *_gather(self.top)))
        if not any(len(ids) for _, ids, _ in node_parts):
            raise InputError(
                f"{deck.name} has no *NODE block; expected an Abaqus or CalculiX input deck with a mesh", kind="missing"
            )
        shift_of = self._shifts([ids for _, ids, _ in node_parts], "node")
        self.ids = np.concatenate([ids + s for (_, ids, _), s in zip(node_parts, shift_of, strict=True)])
        self.xyz = np.concatenate([xyz for *_, xyz in node_parts])
        if not (np.abs(self.xyz) < TOL.largest_number).all():
            raise InputError(
                f"{deck.name}: coordinates are too large; check the nodes and how instances are moved",
                kind="unsupported",
            )
        start = 0
        for placed, ids, _ in node_parts:
            rows = start + np.arange(len(ids))
            placed.nodes = Labels(ids, deck.name, "node", of_instance(placed), rows)
            start += len(ids)
        self._elements([placed for placed, *_ in node_parts], deck)

    def _warn_of_unused(self, deck: Contents) -> None:
        used = {instance.part for instance in deck.instances.values()}
        spare = [part.name for key, part in deck.parts.items() if key not in used and part.node_ids]
        if spare and not deck.instances and len(deck.parts) == 1:
            # A lone part without an assembly is the model.
            self.top.contents = [*deck.parts.values(), deck.top]
        elif spare:
            self.notes.append(f"Parts without an instance were left out: {', '.join(spare)}.")

    def _shifts(self, labels: list[Ints], what: str) -> list[int]:
        """What to add to the labels of each scope so that each is there once."""
        together = np.concatenate(labels)
        if not _repeats(together):
            return [0] * len(labels)
        step = 10 ** len(str(int(together.max(initial=1))))
        if step * len(labels) > 2**62:
            raise InputError(
                f"{self.deck}: {what} labels up to {together.max()} of several instances are too large",
                kind="unsupported",
            )
        names = [*(placed.name for placed in self.placed.values()), "the assembly"]
        moved = ", ".join(f"{name} + {j * step}" for j, name in enumerate(names) if j and len(labels[j]))
        self.notes.append(f"The same {what} labels are in several instances, so these labels were raised: {moved}.")
        return [j * step for j in range(len(labels))]

    def _elements(self, scopes: list[Placed], deck: Contents) -> None:
        """Blocks with rows of all nodes; labels of each scope to numbers of elements: type by type, then those on
        single nodes, then others."""
        kinds = [_by_kind(placed, deck, spent=len(self.placed) < 2) for placed in scopes]
        order = list(dict.fromkeys(kind for own in kinds for kind in own))
        discrete = [[item for scope in placed.contents for item in scope.discrete] for placed in scopes]
        others = [[item for scope in placed.contents for item in scope.others] for placed in scopes]
        labels = [
            np.concatenate(
                [
                    *(own[kind][:, 0] for kind in order if kind in own),
                    np.array([n for n, *_ in single], dtype=np.int64),
                    *(rows[:, 0] for _, rows in rest),
                ]
            )
            for own, single, rest in zip(kinds, discrete, others, strict=True)
        ]
        counts = np.array(
            [
                [*(len(own.get(kind, ())) for kind in order), len(single), sum(len(rows) for _, rows in rest)]
                for own, single, rest in zip(kinds, discrete, others, strict=True)
            ]
        ).T
        first = (np.cumsum(counts) - counts.ravel()).reshape(counts.shape)
        for j, (placed, own) in enumerate(zip(scopes, labels, strict=True)):
            number = np.concatenate([np.arange(a, a + n) for a, n in zip(first[:, j], counts[:, j], strict=True)])
            placed.elements = Labels(own, self.deck, "element", of_instance(placed), number)
        shifts = self._shifts(labels, "element")
        self.blocks: list[ElementBlock] = [self._block(kind, scopes, kinds, shifts) for kind in order]
        self.solids = int(counts[:-2].sum())
        self.discrete: list[Discrete] = []
        self.others: list[tuple[str, Ints, Ints]] = []
        for j, placed in enumerate(scopes):
            for i, (label_, nodes, code) in enumerate(discrete[j]):
                ends = [self.one_node(placed, ref) for ref in nodes]
                self.discrete.append(Discrete(placed, code, label_ + shifts[j], int(first[-2, j]) + i, ends))
            for code, rows in others[j]:
                self.others.append((code, rows[:, 0] + shifts[j], placed.nodes.rows(rows[:, 1:], "elements name")))

    def _block(
        self, kind: Kind, scopes: list[Placed], kinds: list[dict[Kind, Ints]], shifts: list[int]
    ) -> ElementBlock:
        """The elements of one kind of all scopes; their labels and nodes are taken out of ``kinds``."""
        nodes, ids = [], []
        for placed, own, shift in zip(scopes, kinds, shifts, strict=True):
            rows = own.pop(kind, None)
            if rows is not None:
                nodes.append(placed.nodes.rows(rows[:, 1:], "elements name"))
                ids.append(rows[:, 0] + shift)
        whole, labels = nodes[0] if len(nodes) == 1 else np.concatenate(nodes), np.concatenate(ids)
        shape, formulation, mass = kind
        ordered = self._in_order(shape, whole, labels)
        return ElementBlock(type=shape, nodes=ordered, ids=labels, formulation=formulation, mass=mass)

    def element_labels(self) -> Ints:
        """Labels of all elements by their numbers."""
        discrete = np.array([element.label for element in self.discrete], dtype=np.int64)
        return np.concatenate([_NONE, *(b.ids for b in self.blocks), discrete, *(ids for _, ids, _ in self.others)])

    def resolve(self, kind: str) -> Iterator[tuple[str, Ints]]:
        """Sets of nodes, or of elements, by their final names, with rows or numbers; what is wrong is a problem."""
        for name, (placed, own) in self.final_names(kind).items():
            rows = _NONE
            with self.problems.collected():
                rows = self.members(kind, placed, own)
            yield name, rows

    def _in_order(self, kind: str, nodes: Ints, ids: Ints) -> Ints:
        """Nodes in VTK order; surfaces, too, go by it. Programs differ in the order of the 7 inner nodes of hex27, so
        it is taken from where they are."""
        if kind == "hex27" and len(nodes):
            nodes = self._hex27_in_order(nodes)
        ordered, warning = in_order(kind, nodes, self.xyz, ids, self.ids, self.deck)
        self.warnings += [] if warning is None else [warning]
        return ordered

    def _hex27_in_order(self, nodes: Ints) -> Ints:
        N, _ = TYPES["hex20"].shape(TYPES["hex27"].reference[20:])
        expected = np.einsum("ak,ekx->eax", N, self.xyz[nodes[:, :20]])
        distance = np.linalg.norm(self.xyz[nodes[:, 20:]][:, None] - expected[:, :, None], axis=3)
        order = distance.argmin(axis=2)
        if (np.sort(order, axis=1) != np.arange(7)).any():
            raise InputError(
                f"{self.deck}: nodes 21 to 27 of a C3D27 are not near its faces and its centre", kind="unsupported"
            )
        return np.concatenate([nodes[:, :20], np.take_along_axis(nodes[:, 20:], order, axis=1)], axis=1)

    @cached_property
    def in_solids(self) -> NDArray[np.bool_]:
        """Which nodes belong to solids."""
        used = np.zeros(len(self.ids), dtype=bool)
        for block in self.blocks:
            used[block.nodes] = True
        return used

    def copy(self, rows: Ints) -> Ints:
        """Rows of nodes that the deck does not have, at the places of others (k,)."""
        self.ids = np.append(self.ids, self.ids.max() + 1 + np.arange(len(rows)))
        self.xyz = np.vstack([self.xyz, self.xyz[rows]])
        return np.arange(len(self.ids) - len(rows), len(self.ids))

    def new_node(self, xyz: Floats) -> int:
        """Row of a node that the deck does not have."""
        self.ids = np.append(self.ids, self.ids.max() + 1)
        self.xyz = np.vstack([self.xyz, xyz])
        return len(self.ids) - 1


def _repeats(labels: Ints) -> bool:
    """True if a label is there twice."""
    return len(distinct(labels)) < len(labels)


def _by_kind(placed: Placed, deck: Contents, *, spent: bool) -> dict[Kind, Ints]:
    """Labels and nodes (k, width) of the solids of each kind; ``spent`` pieces are let go."""
    kinds: dict[Kind, list[Ints]] = {}
    for scope in placed.contents:
        for code, pieces in scope.elements.items():
            kinds.setdefault(deck.kind(code), []).extend(pieces)
            if spent:
                pieces.clear()
    return {kind: np.concatenate(pieces) for kind, pieces in kinds.items()}


def _gather(placed: Placed) -> tuple[Ints, Floats]:
    """Labels and coordinates of a scope as they are written."""
    ids = np.concatenate([_NONE, *(a for scope in placed.contents for a in scope.node_ids)])
    xyz = np.concatenate([np.empty((0, 3)), *(a for scope in placed.contents for a in scope.xyz)])
    return ids, xyz


def _motion(instance: Instance) -> tuple[Floats, Floats, Floats]:
    """Rotation (3, 3), shift (3,) before it and a point (3,) on its axis."""
    rows = [values(row, instance.card) for row in instance.moves if row]
    R, shift, point = np.eye(3), np.zeros(3), np.zeros(3)
    if len(rows) > 2 or any(len(row) > n for row, n in zip(rows, (3, 7), strict=False)):
        raise InputError(
            f"{instance.card} has data lines that are not a shift (3 numbers) and a rotation (7 numbers)",
            kind="unsupported",
        )
    if rows:
        shift[: len(rows[0])] = rows[0]
    if len(rows) > 1:
        if len(rows[1]) < 7:
            raise InputError(f"{instance.card} gives {len(rows[1])} numbers for a rotation; expected 7")
        point, axis, angle = np.array(rows[1][:3]), np.array(rows[1][3:6]), np.radians(rows[1][6])
        axis = axis - point
        length = np.linalg.norm(axis)
        if not 0 < length < np.inf:
            raise InputError(f"{instance.card}: the two points of the axis of rotation must differ")
        R = rotation_about(axis / length, float(angle))
    return R, shift, point
