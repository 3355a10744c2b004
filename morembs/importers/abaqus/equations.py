"""*EQUATION, *MPC and *TRANSFORM of an input deck: linear relations between motions, along axes of nodes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.fem.constraints import Equations, Term, solved_for_first
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.data import number
from morembs.importers.abaqus.deck import Rows, values
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.decks.algebra import frame_of, terms_of
from morembs.importers.tolerances import TOL

_TEMPERATURE = "11"


class Axes:
    """The axes of nodes that have their own (*TRANSFORM)."""

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly
        self._of: dict[int, tuple[Card, str, Floats, Floats]] = {}

    def read(self) -> None:
        """All *TRANSFORM of the scopes."""
        for placed in (*self.assembly.placed.values(), self.assembly.top):
            for scope in placed.contents:
                for card, rows in scope.transforms:
                    with self.assembly.problems.collected(card):
                        self._read_transform(placed, card, [row for row in rows if row])

    def _read_transform(self, placed: Placed, card: Card, rows: Rows) -> None:
        kind, data = card.options.get("TYPE", "R").upper()[:1], values(rows[0], card) if rows else []
        data += [0.0] * (6 - len(data))
        a, b = np.array(data[:3]), np.array(data[3:6])
        # Two directions, or two points of an axis; those of a part move with its instance.
        a, b = placed.rotation @ a, placed.rotation @ b
        if kind != "R":
            a, b = a + placed.offset, b + placed.offset
        for node in self.assembly.nodes_of(placed, card.need("NSET")).tolist():
            self._of[node] = card, kind, a, b

    def _at(self, node: int) -> Floats:
        """The axes of a node as rows."""
        card, kind, a, b = self._of[node]
        axes = frame_of(a, b) if kind == "R" else None
        if kind == "C":
            axes = frame_of(b - a, self.assembly.xyz[node] - a)
            # Along the axis, away from it, around it; the order of the manual is away, around, along.
            axes = None if axes is None else axes[[1, 2, 0]]
        if axes is None:
            raise InputError(
                f"{card} gives no axes at node {self.assembly.ids[node]}; expected TYPE=R or C and a node off the axis",
                kind="missing",
            )
        return axes

    def has_own_axes(self, node: int) -> bool:
        """True if a node has axes of its own."""
        return node in self._of

    def part(self, node: int, component: int) -> Floats:
        """Direction (6,) in global components of a component of a node."""
        part = np.zeros(6)
        if node in self._of:
            part[3 * (component // 3) : 3 * (component // 3) + 3] = self._at(node)[component % 3]
        else:
            part[component] = 1.0
        return part

    def terms(self, node: int, component: int, coefficient: float) -> list[Term]:
        """A term of an equation in global components."""
        return terms_of(node, coefficient * self.part(node, component), component)


def equations_of(
    assembly: Assembly, axes: Axes, placed: Placed, card: Card, rows: Rows
) -> list[tuple[str, list[Term]]]:
    """The sums that vanish of one *EQUATION, each with what to call it.

    Raises:
        InputError: data that are no equations, or sets of different lengths.
    """
    sums: list[tuple[str, list[Term]]] = []
    data = iter(rows)
    for head in data:
        count = int(number(head[0], card)) if len(head) == 1 else 0
        if count < 1:
            raise InputError(f"{card}: {', '.join(head)[:60]!r} was given; expected the number of terms of an equation")
        terms: list[list[str]] = []
        while len(terms) < count:
            row = next(data, None)
            if row is None or len(terms) + -(-len(row) // 3) > count:
                raise InputError(
                    f"{card}: an equation of {count} terms has another number of them in its lines", kind="unsupported"
                )
            row = row + [""] * (-len(row) % 3)
            terms += [row[i : i + 3] for i in range(0, len(row), 3)]
        sums += _sums(assembly, axes, placed, card, terms)
    return sums


def _sums(
    assembly: Assembly, axes: Axes, placed: Placed, card: Card, terms: list[list[str]]
) -> list[tuple[str, list[Term]]]:
    if all(component == _TEMPERATURE for _, component, _ in terms):
        return []
    nodes = [assembly.pair(placed, text) for text, *_ in terms]
    count = max(len(rows) for rows in nodes)
    if any(len(rows) not in (1, count) for rows in nodes) or count == 0:
        raise InputError(f"{card}: its sets have {', '.join(str(len(n)) for n in nodes)} nodes; expected equal numbers")
    sums = []
    for i in range(count):
        total: list[Term] = []
        for rows, (_, component, coefficient) in zip(nodes, terms, strict=True):
            if component not in ("1", "2", "3", "4", "5", "6"):
                raise InputError(f"{card}: the direction {component!r} was given; expected 1 to 6")
            node = int(rows[i if len(rows) > 1 else 0])
            total += axes.terms(node, int(component) - 1, number(coefficient, card))
        label = assembly.ids[total[0][0]]
        sums.append((f"{card}, whose first term is direction {terms[0][1]} of node {label},", total))
    return sums


def mpc_sums(assembly: Assembly, placed: Placed, card: Card, row: list[str]) -> list[tuple[str, list[Term]]]:
    """The sums that vanish of one line of *MPC of the types LINEAR, LINK, PIN and TIE.

    Raises:
        InputError: another type, or nodes that do not fit it.
    """
    kind = row[0].upper()
    nodes = [assembly.pair(placed, text) for text in row[1:] if text and text != "0"]
    wanted = 3 if kind == "LINEAR" else 2
    if len(nodes) != wanted:
        raise InputError(f"{card} {kind} names {len(nodes)} nodes or sets; expected {wanted}")
    count, x = len(nodes[0]), assembly.xyz
    if any(len(rows) not in (1, count) for rows in nodes[1:]):
        raise InputError(f"{card} {kind}: its sets have different numbers of nodes; expected equal ones")
    sums = []
    for i in range(count):
        p, *others = (int(rows[i if len(rows) > 1 else 0]) for rows in nodes)
        title = f"{card} {kind} of node {assembly.ids[p]}"
        # Solids have no rotations.
        turning = kind == "TIE" and not assembly.in_solids[[p, others[0]]].any()
        if kind == "LINEAR":
            a, b = others
            span = x[b] - x[a]
            t = float((x[p] - x[a]) @ span / max(span @ span, np.finfo(float).tiny))
            sums += [(title, [(p, c, 1.0), (a, c, t - 1.0), (b, c, -t)]) for c in range(3)]
        elif kind == "LINK":
            axis = x[others[0]] - x[p]
            if not np.linalg.norm(axis) > 0:
                raise InputError(
                    f"{title}: its two nodes are at one place; expected a distance between them", kind="model"
                )
            axis = axis / np.linalg.norm(axis)
            order = np.argsort(-np.abs(axis), kind="stable").tolist()
            sums.append((title, [(p, c, axis[c]) for c in order] + [(others[0], c, -axis[c]) for c in order]))
        else:
            sums += [(title, [(p, c, 1.0), (others[0], c, -1.0)]) for c in range(6 if turning else 3)]
    return sums


def solve(name: str, sums: Iterable[tuple[str, list[Term]]], axes: Axes) -> Equations:
    """The sums, each solved for its first term; where the node of that has axes of its own, those of the node together.

    Raises:
        InputError: as ``solved_for_first``, or sums of a node that depend on each other.
    """
    plain: list[tuple[str, list[Term]]] = []
    turned: dict[int, list[tuple[str, list[Term]]]] = {}
    for title, terms in sums:
        node, component, _ = terms[0]
        (turned.setdefault(node, []) if axes.has_own_axes(node) and component < 3 else plain).append((title, terms))
    for node, own in turned.items():
        A = np.zeros((len(own), 3))
        for i, (_, terms) in enumerate(own):
            for other, component, value in terms:
                if other == node and component < 3:
                    A[i, component] += value
        R, pivot = sl.qr(A, mode="r", pivoting=True)
        if len(own) > 3 or not abs(R[len(own) - 1, len(own) - 1]) > TOL.repeated_pivot * abs(R[0, 0]):
            raise InputError(
                f"{own[0][0]} has others on the same node that say the same; leave them out", kind="conflict"
            )
        mix = np.linalg.inv(A[:, pivot[: len(own)]])
        for i, (title, _) in enumerate(own):
            column = int(pivot[i])
            total = [
                (other, component, float(mix[i, j]) * value)
                for j, (_, terms) in enumerate(own)
                for other, component, value in terms
                if mix[i, j] and not (other == node and component in pivot[: len(own)])
            ]
            plain.append((title, [(node, column, 1.0), *total]))
    return solved_for_first(name, plain)
