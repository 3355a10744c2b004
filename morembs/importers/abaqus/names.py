"""What the names and labels of an input deck mean: nodes and elements of scopes in their places, as rows of all."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.fem import ElementBlock
from morembs.importers.abaqus.data import label
from morembs.importers.abaqus.deck import Members, NamedSet, Scope
from morembs.importers.tolerances import TOL

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


class Names:
    """Nodes and elements by label, by set and by instance.

    ``deck`` is the name of the deck, ``top`` what stands outside of its instances, ``ids`` (n,) are the labels of all
    nodes; elements are numbered through ``blocks``, ``discrete`` and ``others``.
    """

    deck: str
    top: Placed
    placed: dict[str, Placed]
    ids: Ints
    blocks: list[ElementBlock]
    discrete: list[Discrete]
    others: list[tuple[str, Ints, Ints]]
    notes: list[str]

    def __init__(self) -> None:
        self._cache: dict[tuple[int, str, str], Ints] = {}

    def rows_of(self, placed: Placed, labels: Ints, who: str) -> Ints:
        """Rows of all nodes with ``labels`` (any shape) of a scope."""
        own = placed.labels
        if len(own) and own[-1] - own[0] + 1 == len(own):
            # Without gaps a place follows from its label.
            at = labels - own[0]
            wrong = (at < 0) | (at >= len(own))
        else:
            at = np.searchsorted(own, labels)
            at[at == len(own)] = 0
            wrong = own[at] != labels if len(own) else np.ones(labels.shape, dtype=bool)
        if wrong.any():
            missing = np.unique(labels[wrong])
            some = ", ".join(map(str, missing[:10].tolist()))
            raise InputError(
                f"{self.deck}: {who} the node {missing[0]}{of_instance(placed)}, which is not defined"
                if len(missing) == 1
                else f"{self.deck}: {who} {len(missing)} nodes{of_instance(placed)} that are not defined: {some}"
            )
        return np.asarray(placed.rows[at])

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
            return self._rows_by_label("element", scope, np.array([value]), text)
        return self.members("element", scope, rest)

    def members(self, kind: str, placed: Placed, name: str, seen: tuple[str, ...] = ()) -> Ints:
        """Rows of nodes or numbers of elements of the set ``name``, sorted."""
        sets = placed.sets(kind)
        if name.upper() not in sets:
            raise InputError(
                f"{self.deck}: {name!r}{of_instance(placed)} is neither a label nor a set of {kind}s; "
                f"{nearest(name, [named[0].name for named in sets.values()])}"
            )
        key = (id(placed), kind, name.upper())
        if name.upper() in seen or len(seen) > TOL.max_references:
            raise InputError(f"{self.deck}: the {kind} set {name!r} contains itself; expected labels or other sets")
        if key not in self._cache:
            pieces = [
                self._part(kind, placed, part, name, (*seen, name.upper()))
                for named in sets[name.upper()]
                for part in named.parts
            ]
            self._cache[key] = ascending(np.concatenate(pieces)) if pieces else _NONE
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
        pieces = [self._rows_by_label(kind, scope, part.labels, name)]
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
                pieces.append(self._rows_by_label(kind, target, np.array([value]), name))
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

    def _rows_by_label(self, kind: str, scope: Placed, labels: Ints, name: str) -> Ints:
        if kind == "node":
            return self.rows_of(scope, labels, f"the set {name!r} names")
        at = np.searchsorted(scope.element_labels, labels)
        at[at == len(scope.element_labels)] = 0
        wrong = scope.element_labels[at] != labels if len(scope.element_labels) else np.ones(len(labels), dtype=bool)
        if wrong.any():
            raise InputError(
                f"{self.deck}: the set {name!r} names the element {labels[wrong][0]}{of_instance(scope)}, which is not "
                "defined"
            )
        return scope.element_rows[at]

    def new_elements(self, placed: Placed, name: str, numbers: Ints) -> str:
        """The name of a new set of elements of a scope."""
        labels = placed.element_labels[np.isin(placed.element_rows, numbers)]
        placed.contents[-1].element_sets[name.upper()] = NamedSet(name, [Members(labels, [], [], "")])
        return name

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


def ascending(labels: Ints) -> Ints:
    """Each label once; those of most files ascend already."""
    return labels if (labels[1:] > labels[:-1]).all() else np.unique(labels)


def of_instance(placed: Placed) -> str:
    return f" of the instance {placed.name!r}" if placed.name else ""
