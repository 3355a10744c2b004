"""Parts of an input deck in their places: one numbering of nodes and elements, sets as rows of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError, nearest
from morembs.importers.abaqus_deck import Deck, Instance, Members, NamedSet, Scope, values
from morembs.importers.abaqus_keywords import LARGEST, label
from morembs.model import ElementBlock, skew
from morembs.model.elements import TYPES
from morembs.model.middle_nodes import in_order

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_DEEPEST = 100
_NONE = np.empty(0, dtype=np.int64)


@dataclass(eq=False)
class Placed:
    """A scope in its place, where x is ``rotation`` x + ``offset``.

    ``labels`` (n,) are sorted, as in the deck; node i of them is row ``rows[i]`` of all.
    """

    name: str
    contents: list[Scope]
    rotation: Floats
    offset: Floats = field(default_factory=lambda: np.zeros(3))
    labels: Ints = field(default_factory=lambda: _NONE)
    rows: Ints = field(default_factory=lambda: _NONE)
    element_labels: Ints = field(default_factory=lambda: _NONE)
    element_rows: Ints = field(default_factory=lambda: _NONE)

    def sets(self, kind: str) -> dict[str, list[NamedSet]]:
        """Node or element sets under their names in capitals; a part and its instance may both add to one."""
        sets: dict[str, list[NamedSet]] = {}
        for scope in self.contents:
            for name, given in (scope.node_sets if kind == "node" else scope.element_sets).items():
                sets.setdefault(name, []).append(given)
        return sets


@dataclass(frozen=True, eq=False)
class Discrete:
    """An element of the type ``code`` on single ``nodes`` (rows of all), its label and its number among all."""

    placed: Placed
    code: str
    label: int
    number: int
    nodes: list[int]


class Assembly:
    """All nodes (n, 3) and elements of a deck, and what its names mean.

    Elements are numbered block by block, behind the solids those on single nodes, and behind these ``others`` (type,
    labels, rows of nodes), which are not assembled here.
    """

    def __init__(self, deck: Deck) -> None:
        self.deck = deck.name
        self.problems = deck.problems
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.top = Placed("", [deck.top], np.eye(3))
        self.placed: dict[str, Placed] = {}
        self._cache: dict[tuple[int, str, str], Ints] = {}
        node_parts: list[tuple[Placed, Ints, Floats]] = []
        for key, instance in deck.instances.items():
            contents = [deck.parts[instance.part]] if instance.part else []
            R, shift, point = _motion(instance)
            placed = self.placed[key] = Placed(
                instance.scope.name, [*contents, instance.scope], R, R @ (shift - point) + point
            )  # fmt: skip
            ids, xyz = _gathered(placed, deck.name)
            moved = xyz if not instance.moves else (xyz + shift - point) @ R.T + point
            node_parts.append((placed, ids, moved))
        node_parts.append((self.top, *_gathered(self.top, deck.name)))
        self._unused(deck)
        if not any(len(ids) for _, ids, _ in node_parts):
            raise InputError(f"{deck.name} has no *NODE block; expected an Abaqus or CalculiX input deck with a mesh")
        shift_of = self._shifts([ids for _, ids, _ in node_parts], "node")
        self.ids = np.concatenate([ids + s for (_, ids, _), s in zip(node_parts, shift_of, strict=True)])
        self.xyz = np.concatenate([xyz for *_, xyz in node_parts])
        if not (np.abs(self.xyz) < LARGEST).all():
            raise InputError(f"{deck.name}: coordinates are too large; check the nodes and how instances are moved")
        start = 0
        for placed, ids, _ in node_parts:
            order = np.argsort(ids, kind="stable")
            placed.labels, placed.rows = ids[order], order + start
            start += len(ids)
        self._elements([placed for placed, *_ in node_parts], deck)

    def _unused(self, deck: Deck) -> None:
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
            raise InputError(f"{self.deck}: {what} labels up to {together.max()} of several instances are too large")
        names = [*(placed.name for placed in self.placed.values()), "the assembly"]
        moved = ", ".join(f"{name} + {j * step}" for j, name in enumerate(names) if j and len(labels[j]))
        self.notes.append(f"The same {what} labels are in several instances, so these labels were raised: {moved}.")
        return [j * step for j in range(len(labels))]

    def _elements(self, scopes: list[Placed], deck: Deck) -> None:
        """Blocks with rows of all nodes; labels of each scope to numbers of elements."""
        per_scope: list[dict[tuple[str, str, str], Ints]] = []
        for placed in scopes:
            kinds: dict[tuple[str, str, str], list[Ints]] = {}
            for scope in placed.contents:
                for code, pieces in scope.elements.items():
                    kinds.setdefault(deck.kind(code), []).extend(pieces)
                    pieces.clear() if len(self.placed) < 2 else None
            per_scope.append({kind: np.concatenate(pieces) for kind, pieces in kinds.items()})
        extra_labels = [
            np.array(
                [n for scope in placed.contents for n, *_ in scope.discrete]
                + [n for scope in placed.contents for _, rows in scope.others for n in rows[:, 0].tolist()],
                dtype=np.int64,
            )
            for placed in scopes
        ]
        order_of = list(dict.fromkeys(kind for by_type in per_scope for kind in by_type))
        own = [
            np.concatenate([*(by_type[kind][:, 0] for kind in order_of if kind in by_type), extra])
            for by_type, extra in zip(per_scope, extra_labels, strict=True)
        ]
        for placed, labels in zip(scopes, own, strict=True):
            order = np.argsort(labels, kind="stable")
            placed.element_labels = labels[order]
            twice = np.flatnonzero(np.diff(placed.element_labels) == 0)
            if len(twice):
                raise InputError(
                    f"{self.deck} defines the element {placed.element_labels[twice[0]]}{_of(placed)} twice; expected "
                    "unique element labels"
                )
            placed.element_rows = np.empty(len(labels), dtype=np.int64)
        shifts = self._shifts(own, "element")
        number = [np.empty(len(labels), dtype=np.int64) for labels in own]
        filled, count, blocks = [0] * len(scopes), 0, []
        for kind in order_of:
            nodes, ids = [], []
            for j, placed in enumerate(scopes):
                rows = per_scope[j].pop(kind, None)
                if rows is not None:
                    nodes.append(self.rows_of(placed, rows[:, 1:], "elements name"))
                    ids.append(rows[:, 0] + shifts[j])
                    number[j][filled[j] : filled[j] + len(rows)] = np.arange(count, count + len(rows))
                    filled[j] += len(rows)
                    count += len(rows)
            whole, labels = np.concatenate(nodes) if len(nodes) > 1 else nodes[0], np.concatenate(ids)
            shape, formulation, mass = kind
            ordered = self._in_order(shape, whole, labels)
            blocks.append(
                ElementBlock(type=shape, nodes=ordered, ids=labels, formulation=formulation, mass=mass)
            )
        self.blocks: list[ElementBlock] = blocks
        self.solids = count
        self.discrete: list[Discrete] = []
        for j, placed in enumerate(scopes):
            items = [item for scope in placed.contents for item in scope.discrete]
            number[j][filled[j] : filled[j] + len(items)] = np.arange(count, count + len(items))
            filled[j] += len(items)
            for label_, nodes_, code in items:
                ends = [self.one_node(placed, ref) for ref in nodes_]
                self.discrete.append(Discrete(placed, code, label_ + shifts[j], count, ends))
                count += 1
        self.others: list[tuple[str, Ints, Ints]] = []
        for j, placed in enumerate(scopes):
            for scope in placed.contents:
                for code, rows in scope.others:
                    at = self.rows_of(placed, rows[:, 1:], "elements name")
                    self.others.append((code, rows[:, 0] + shifts[j], at))
            left = len(number[j]) - filled[j]
            number[j][filled[j] :] = np.arange(count, count + left)
            count += left
            placed.element_rows = number[j][np.argsort(own[j], kind="stable")]

    def element_labels(self) -> Ints:
        """Labels of all elements by their numbers."""
        discrete = np.array([element.label for element in self.discrete], dtype=np.int64)
        return np.concatenate([_NONE, *(b.ids for b in self.blocks), discrete, *(ids for _, ids, _ in self.others)])

    def _in_order(self, kind: str, nodes: Ints, ids: Ints) -> Ints:
        """Nodes in VTK order; surfaces, too, go by it. Programs differ in the order of the 7 inner nodes of hex27, so
        it is taken from where they are."""
        if kind == "hex27" and len(nodes):
            nodes = self._hex27_in_order(nodes)
        ordered, said = in_order(kind, nodes, self.xyz, ids, self.ids, self.deck)
        self.warnings += [] if said is None else [said]
        return ordered

    def _hex27_in_order(self, nodes: Ints) -> Ints:
        N, _ = TYPES["hex20"].shape(TYPES["hex27"].reference[20:])
        expected = np.einsum("ak,ekx->eax", N, self.xyz[nodes[:, :20]])
        distance = np.linalg.norm(self.xyz[nodes[:, 20:]][:, None] - expected[:, :, None], axis=3)
        order = distance.argmin(axis=2)
        if (np.sort(order, axis=1) != np.arange(7)).any():
            raise InputError(f"{self.deck}: nodes 21 to 27 of a C3D27 are not near its faces and its centre")
        return np.concatenate([nodes[:, :20], np.take_along_axis(nodes[:, 20:], order, axis=1)], axis=1)

    def rows_of(self, placed: Placed, labels: Ints, who: str) -> Ints:
        """Rows of all nodes with ``labels`` (any shape) of a scope."""
        at = np.searchsorted(placed.labels, labels)
        at[at == len(placed.labels)] = 0
        wrong = placed.labels[at] != labels if len(placed.labels) else np.ones(labels.shape, dtype=bool)
        if wrong.any():
            missing = np.unique(labels[wrong])
            some = ", ".join(map(str, missing[:10].tolist()))
            raise InputError(
                f"{self.deck}: {who} the node {missing[0]}{_of(placed)}, which is not defined"
                if len(missing) == 1
                else f"{self.deck}: {who} {len(missing)} nodes{_of(placed)} that are not defined: {some}"
            )
        return placed.rows[at]

    @cached_property
    def in_solids(self) -> NDArray[np.bool_]:
        """Which nodes belong to solids."""
        used = np.zeros(len(self.ids), dtype=bool)
        for block in self.blocks:
            used[block.nodes] = True
        return used

    def new_node(self, xyz: Floats) -> int:
        """Row of a node that the deck does not have."""
        self.ids = np.append(self.ids, self.ids.max() + 1)
        self.xyz = np.vstack([self.xyz, xyz])
        return len(self.ids) - 1

    def split(self, placed: Placed, text: str) -> tuple[Placed, str]:
        """The scope that a reference "INSTANCE.NAME" means and what it names there."""
        first, dot, rest = text.partition(".")
        if dot and placed is self.top and first.upper() in self.placed:
            return self.placed[first.upper()], rest
        return placed, text

    def one_node(self, placed: Placed, text: str) -> int:
        """Row of a node given by its label or by a set of one node."""
        rows = self.nodes_of(placed, text)
        if len(rows) != 1:
            raise InputError(f"{self.deck}: {text!r} has {len(rows)} nodes where one is expected")
        return int(rows[0])

    def nodes_of(self, placed: Placed, text: str) -> Ints:
        """Rows of the nodes that a label or the name of a set means."""
        scope, rest = self.split(placed, text)
        value = label(rest)
        if value is not None:
            return self.rows_of(scope, np.array([value]), "a line names")
        return self.members("node", scope, rest)

    def paired(self, placed: Placed, text: str) -> Ints:
        """Rows of the nodes that a label or set means as they are paired with others: by their labels, or as they are
        listed where the set is UNSORTED."""
        rows = self.nodes_of(placed, text)
        scope, rest = self.split(placed, text)
        named = [] if label(rest) is not None else scope.sets("node")[rest.upper()]
        parts = [part for given in named for part in given.parts]
        if not any(part.unsorted for part in parts):
            return rows[np.argsort(self.ids[rows], kind="stable")]
        pieces = [_NONE]
        for part in parts:
            if part.unsorted and part.names:
                where = self.placed.get(part.instance.upper(), scope)
                pieces += [self.paired(where, name) for name in part.names]
            else:
                pieces.append(self._part("node", scope, part, rest, ()))
        listed = np.concatenate(pieces)
        return listed[np.sort(np.unique(listed, return_index=True)[1])]

    def elements_of(self, placed: Placed, text: str) -> Ints:
        """Numbers of the elements that a label or the name of a set means."""
        scope, rest = self.split(placed, text)
        value = label(rest)
        if value is not None:
            return self._found("element", scope, np.array([value]), text)
        return self.members("element", scope, rest)

    def members(self, kind: str, placed: Placed, name: str, seen: tuple[str, ...] = ()) -> Ints:
        """Rows of nodes or numbers of elements of the set ``name``, sorted."""
        sets = placed.sets(kind)
        if name.upper() not in sets:
            raise InputError(
                f"{self.deck}: {name!r}{_of(placed)} is neither a label nor a set of {kind}s; "
                f"{nearest(name, [named[0].name for named in sets.values()])}"
            )
        key = (id(placed), kind, name.upper())
        if name.upper() in seen or len(seen) > _DEEPEST:
            raise InputError(f"{self.deck}: the {kind} set {name!r} contains itself; expected labels or other sets")
        if key not in self._cache:
            pieces = [
                self._part(kind, placed, part, name, (*seen, name.upper()))
                for named in sets[name.upper()]
                for part in named.parts
            ]
            self._cache[key] = _ascending(np.concatenate(pieces)) if pieces else _NONE
        return self._cache[key]

    def _part(self, kind: str, placed: Placed, part: Members, name: str, seen: tuple[str, ...]) -> Ints:
        scope = placed
        if part.instance:
            if part.instance.upper() not in self.placed:
                raise InputError(
                    f"{self.deck}: the set {name!r} is of the instance {part.instance!r}, which is unknown"
                )
            scope = self.placed[part.instance.upper()]
        labels, rows = (scope.labels, scope.rows) if kind == "node" else (scope.element_labels, scope.element_rows)
        if part.of_elements:
            return self.nodes_of_elements(self._part("element", placed, replace(part, of_elements=False), name, ()))
        pieces = [self._found(kind, scope, part.labels, name)]
        for first, last, step in part.ranges:
            low, high = np.searchsorted(labels, [first, last + 1])
            on = (labels[low:high] - first) % step == 0
            missing = (last - first) // step + 1 - int(on.sum())
            if missing:
                self.notes.append(
                    f"The {kind} set {name} runs from {first} to {last} in steps of {step}; {missing} of these labels "
                    "do not exist and are not in it."
                )
            pieces.append(rows[low:high][on])
        for other in part.names:
            target, rest = self.split(scope, other)
            value = label(rest)
            if value is not None:
                pieces.append(self._found(kind, target, np.array([value]), name))
            else:
                pieces.append(self.members(kind, target, rest, seen if target is placed else ()))
        return np.concatenate(pieces)

    def nodes_of_elements(self, numbers: Ints) -> Ints:
        """Rows of the nodes of elements by their numbers, ascending."""
        rows, start = [_NONE], 0
        for block in self.blocks:
            own = numbers[(numbers >= start) & (numbers < start + len(block.nodes))] - start
            rows.append(np.unique(block.nodes[own]))
            start += len(block.nodes)
        chosen = set(numbers[numbers >= start].tolist())
        rows += [np.array(element.nodes) for element in self.discrete if element.number in chosen]
        start += len(self.discrete)
        for _, ids, nodes in self.others:
            own = numbers[(numbers >= start) & (numbers < start + len(ids))] - start
            rows.append(np.unique(nodes[own]))
            start += len(ids)
        return np.unique(np.concatenate(rows))

    def _found(self, kind: str, scope: Placed, labels: Ints, name: str) -> Ints:
        if kind == "node":
            return self.rows_of(scope, labels, f"the set {name!r} names")
        at = np.searchsorted(scope.element_labels, labels)
        at[at == len(scope.element_labels)] = 0
        wrong = scope.element_labels[at] != labels if len(scope.element_labels) else np.ones(len(labels), dtype=bool)
        if wrong.any():
            raise InputError(
                f"{self.deck}: the set {name!r} names the element {labels[wrong][0]}{_of(scope)}, which is not defined"
            )
        return scope.element_rows[at]

    def named(self, kind: str) -> dict[str, tuple[Placed, str]]:
        """Final name of each set -> where it is and its name there.

        Sets of the assembly keep their names; those of instances too, where there is one instance and no clash.
        """
        names: dict[str, tuple[Placed, str]] = {}
        taken = set()
        for named in self.top.sets(kind).values():
            names[named[0].name] = (self.top, named[0].name)
            taken.add(named[0].name.upper())
        for placed in self.placed.values():
            for key, named in placed.sets(kind).items():
                plain = len(self.placed) == 1 and key not in taken
                names[named[0].name if plain else f"{placed.name}.{named[0].name}"] = (placed, named[0].name)
        return names

    def final_name(self, kind: str, placed: Placed, text: str) -> str:
        """Name that the set ``text`` of a scope has in the end."""
        scope, rest = self.split(placed, text)
        for name, (where, own) in self.named(kind).items():
            if where is scope and own.upper() == rest.upper():
                return name
        raise InputError(f"{self.deck}: {text!r} is not a set of {kind}s")


def _repeats(labels: Ints) -> bool:
    """Whether a label is there twice."""
    return len(_ascending(labels)) < len(labels)


def _ascending(labels: Ints) -> Ints:
    """Each label once; those of most files ascend already."""
    return labels if (labels[1:] > labels[:-1]).all() else np.unique(labels)


def _of(placed: Placed) -> str:
    return f" of the instance {placed.name!r}" if placed.name else ""


def _gathered(placed: Placed, deck: str) -> tuple[Ints, Floats]:
    """Labels and coordinates of a scope as they are written."""
    ids = np.concatenate([_NONE, *(a for scope in placed.contents for a in scope.node_ids)])
    xyz = np.concatenate([np.empty((0, 3)), *(a for scope in placed.contents for a in scope.xyz)])
    if len(ids) and (_repeats(ids) or ids.min() < 1):
        raise InputError(f"{deck} defines some nodes{_of(placed)} twice, or below 1; expected unique node labels")
    return ids, xyz


def _motion(instance: Instance) -> tuple[Floats, Floats, Floats]:
    """Rotation (3, 3), shift (3,) before it and a point (3,) on its axis."""
    rows = [values(row, instance.card) for row in instance.moves if row]
    R, shift, point = np.eye(3), np.zeros(3), np.zeros(3)
    if len(rows) > 2 or any(len(row) > n for row, n in zip(rows, (3, 7), strict=False)):
        raise InputError(f"{instance.card} has data lines that are not a shift (3 numbers) and a rotation (7 numbers)")
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
        A = skew(axis / length)
        R = np.eye(3) + np.sin(angle) * A + (1 - np.cos(angle)) * A @ A
    return R, shift, point
