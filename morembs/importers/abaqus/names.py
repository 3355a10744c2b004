"""What the names and labels of an input deck mean: nodes and elements of scopes in their places, as rows of all."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.fem import ElementBlock
from morembs.importers.abaqus.data import label
from morembs.importers.abaqus.deck import Members, NamedSet, Scope
from morembs.importers.decks.labels import Labels, distinct
from morembs.importers.tolerances import TOL

_NONE = np.empty(0, dtype=np.int64)


@dataclass(eq=False)
class Placed:
    """A scope in its place, where x is ``rotation`` x + ``offset``.

    ``nodes`` and ``elements`` are its labels with their rows, and numbers, among all.
    """

    name: str
    contents: list[Scope]
    rotation: Floats
    offset: Floats = field(default_factory=lambda: np.zeros(3))
    nodes: Labels = field(default_factory=lambda: Labels(_NONE, ""))
    elements: Labels = field(default_factory=lambda: Labels(_NONE, ""))

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

    def split(self, placed: Placed, text: str) -> tuple[Placed, str]:
        """The scope of a reference "INSTANCE.NAME", and the name in that scope."""
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
            return scope.nodes.rows(np.array([value]), "a line names")
        return self.members("node", scope, rest)

    def pair(self, placed: Placed, text: str) -> Ints:
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
                pieces += [self.pair(where, name) for name in part.names]
            else:
                pieces.append(self._part("node", scope, part, rest, ()))
        listed = np.concatenate(pieces)
        return listed[np.sort(np.unique(listed, return_index=True)[1])]

    def elements_of(self, placed: Placed, text: str) -> Ints:
        """Numbers of the elements that a label or the name of a set means."""
        scope, rest = self.split(placed, text)
        value = label(rest)
        if value is not None:
            return scope.elements.rows(np.array([value]), f"the set {text!r} names")
        return self.members("element", scope, rest)

    def members(self, kind: str, placed: Placed, name: str, visited: tuple[str, ...] = ()) -> Ints:
        """Rows of nodes or numbers of elements of the set ``name``, sorted."""
        sets = placed.sets(kind)
        if name.upper() not in sets:
            raise InputError(
                f"{self.deck}: {name!r}{of_instance(placed)} is neither a label nor a set of {kind}s; "
                f"{nearest(name, [named[0].name for named in sets.values()])}",
                kind="unknown",
            )
        key = (id(placed), kind, name.upper())
        if name.upper() in visited or len(visited) > TOL.max_references:
            raise InputError(
                f"{self.deck}: the {kind} set {name!r} contains itself; expected labels or other sets", kind="conflict"
            )
        if key not in self._cache:
            pieces = [
                self._part(kind, placed, part, name, (*visited, name.upper()))
                for named in sets[name.upper()]
                for part in named.parts
            ]
            self._cache[key] = distinct(np.concatenate(pieces)) if pieces else _NONE
        return self._cache[key]

    def _part(self, kind: str, placed: Placed, part: Members, name: str, visited: tuple[str, ...]) -> Ints:
        scope = placed
        if part.instance:
            if part.instance.upper() not in self.placed:
                raise InputError(
                    f"{self.deck}: the set {name!r} is of the instance {part.instance!r}, which is unknown",
                    kind="unsupported",
                )
            scope = self.placed[part.instance.upper()]
        table, who = scope.nodes if kind == "node" else scope.elements, f"the set {name!r} names"
        if part.of_elements:
            return self.nodes_of_elements(self._part("element", placed, replace(part, of_elements=False), name, ()))
        pieces = [table.rows(part.labels, who)]
        for first, last, step in part.ranges:
            low, high = np.searchsorted(table.ascending, [first, last + 1])
            on = (table.ascending[low:high] - first) % step == 0
            missing = (last - first) // step + 1 - int(on.sum())
            if missing:
                self.notes.append(
                    f"The {kind} set {name} runs from {first} to {last} in steps of {step}; {missing} of these labels "
                    "do not exist and are not in it."
                )
            pieces.append(table.order[low:high][on])
        for other in part.names:
            target, rest = self.split(scope, other)
            value = label(rest)
            if value is not None:
                own = target.nodes if kind == "node" else target.elements
                pieces.append(own.rows(np.array([value]), who))
            else:
                pieces.append(self.members(kind, target, rest, visited if target is placed else ()))
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

    def new_elements(self, placed: Placed, name: str, numbers: Ints) -> str:
        """The name of a new set of elements of a scope."""
        labels = placed.elements.ascending[np.isin(placed.elements.order, numbers)]
        placed.contents[-1].element_sets[name.upper()] = NamedSet(name, [Members(labels, [], [], "")])
        return name

    def final_names(self, kind: str) -> dict[str, tuple[Placed, str]]:
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
        for name, (where, own) in self.final_names(kind).items():
            if where is scope and own.upper() == rest.upper():
                return name
        raise InputError(f"{self.deck}: {text!r} is not a set of {kind}s", kind="unsupported")


def of_instance(placed: Placed) -> str:
    return f" of the instance {placed.name!r}" if placed.name else ""
