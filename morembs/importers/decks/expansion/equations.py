"""Knots and hinges: how fibres and cross-sections of one node hang together.

CalculiX CrunchiX User's Manual, "Expansion of the one-dimensional and two-dimensional elements": where a node has
several of them they are rigid but for a stretch, uniform, or along two axes where all their nodes are in a plane. A
node with one is at the mean of the corners of that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem import rigid_motion
from morembs.fem.constraints import Equations
from morembs.fem.fe_model import Component
from morembs.importers.decks.expansion.normals import Fibres
from morembs.importers.decks.expansion.solids import FibreNodes
from morembs.importers.decks.tables import DeckTables
from morembs.importers.tolerances import TOL

KNOTS, MEANS = "knots of shells and beams", "nodes of shells and beams"


class _Part(NamedTuple):
    """Nodes and components (k,) that follow the nodes ``leaders`` (t,) in components ``of`` (t,) with ``values``
    (k, t)."""

    nodes: Ints
    components: Ints
    leaders: Ints
    of: Ints
    values: Floats


def knot_nodes(fibres: Fibres, count: int) -> Ints:
    """Rows of the nodes, of ``count``, that have several fibres or cross-sections."""
    return np.flatnonzero(np.bincount(fibres.node, minlength=count) > 1)


def knot_equations(deck: DeckTables, fibres: Fibres, nodes: FibreNodes) -> tuple[tuple[Equations, ...], Ints, Floats]:
    """How the nodes of fibres and cross-sections follow knots, with labels (s,) and places (s, 3) of new nodes for the
    stretches of these: scalars, of which other nodes may have those inside of elements."""
    parts, places = list[_Part](), [np.empty((0, 3))]
    order = np.argsort(fibres.node, kind="stable")
    first = begin = int(nodes.labels.max()) + 1
    start = np.searchsorted(fibres.node[order], np.arange(len(deck.ids) + 1))
    for row in knot_nodes(fibres, len(deck.ids)).tolist():
        own = order[start[row] : start[row + 1]]
        labels, there = nodes.labels[own], nodes.is_there[own]
        made = labels > 0
        directions = _stretches(nodes.xyz[own][there], has_beams=bool(fibres.first[own].any()))
        holders = first + np.arange(len(directions))
        first += len(directions)
        parts.append(_follows(deck, row, labels[made], nodes.xyz[own][made], directions, holders))
        places.append(np.repeat(deck.xyz[[row]], len(directions), axis=0))
        if fibres.is_straight[row]:
            parts.append(_no_spin(int(deck.ids[row]), fibres.normal[own[-1]]))
    xyz = np.concatenate(places)
    return tuple(_equations(KNOTS, parts)), begin + np.arange(len(xyz)), xyz


def _stretches(places: Floats, *, has_beams: bool) -> Floats:
    """Directions (d, 3, 3) of the stretches of a knot whose nodes are at ``places`` (m, 3), as matrices: e e' of one
    along e, the identity of a uniform one."""
    from_mean = places - places.mean(axis=0)
    size, axes = np.linalg.eigh(from_mean.T @ from_mean)
    if has_beams and size[0] < TOL.flat_knot <= size[1]:
        return np.stack([np.outer(axes[:, i], axes[:, i]) for i in (2, 1)])
    return np.eye(3)[None]


def _follows(deck: DeckTables, row: int, own: Ints, places: Floats, directions: Floats, holders: Ints) -> _Part:
    """Nodes ``own`` (m,) at ``places`` (m, 3) behind a knot in a ``row`` of the deck, and the scalars of ``holders``
    (d,), its stretches along ``directions`` (d, 3, 3)."""
    components, arms = np.tile(np.arange(3), len(places)), places - deck.xyz[row]
    rigid = rigid_motion(np.repeat(arms, 3, axis=0), components)
    stretch = np.einsum("mb,dab->mad", arms, directions).reshape(-1, len(directions))
    return _Part(
        nodes=np.repeat(own, 3),
        components=components,
        leaders=np.concatenate([np.full(6, deck.ids[row]), holders]),
        of=np.concatenate([np.arange(6), np.full(len(holders), Component.SCALAR)]),
        values=np.hstack([rigid, stretch]),
    )


def _no_spin(knot: int, normal: Floats) -> _Part:
    """No rotation of a knot about its only ``normal``, or the axis next to it, which moves none of its fibres."""
    i = int(np.abs(normal).argmax())
    is_near = 1.0 - abs(normal[i]) < TOL.near_axis
    j = np.flatnonzero((np.arange(3) != i) & ~is_near)
    values = -normal[None, j] / normal[i]
    return _Part(np.array([knot]), np.array([3 + i]), np.full(len(j), knot), 3 + j, values)


def _equations(name: str, parts: Sequence[_Part]) -> Iterator[Equations]:
    if parts:
        counts = np.concatenate([np.full(len(part.nodes), len(part.leaders)) for part in parts])
        yield Equations(
            name=name,
            nodes=np.concatenate([part.nodes for part in parts]),
            components=np.concatenate([part.components for part in parts]),
            offsets=np.concatenate([[0], np.cumsum(counts)]),
            term_nodes=np.concatenate([np.tile(part.leaders, len(part.nodes)) for part in parts]),
            term_components=np.concatenate([np.tile(part.of, len(part.nodes)) for part in parts]),
            coefficients=np.concatenate([part.values.ravel() for part in parts]),
        )


def mean_equations(nodes: Ints, corners: Ints) -> Iterator[Equations]:
    """Displacements of ``nodes`` (n,) as means of those of ``corners`` (n, c), of which the first follow."""
    count = corners.shape[1]
    if not len(nodes):
        return
    components = np.tile(np.arange(3), len(nodes))
    terms = np.repeat(np.column_stack([nodes, corners[:, 1:]]), 3, axis=0)
    yield Equations(
        name=MEANS,
        nodes=np.repeat(corners[:, 0], 3),
        components=components,
        offsets=count * np.arange(3 * len(nodes) + 1),
        term_nodes=terms.ravel(),
        term_components=np.repeat(components, count),
        coefficients=np.tile([count, *[-1.0] * (count - 1)], 3 * len(nodes)),
    )
