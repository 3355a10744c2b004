"""What sets, surfaces and couplings that name nodes of shells and beams mean once these are solids.

Displacements of a node are those of its mean (CalculiX, "Expansion of the one-dimensional and two-dimensional
elements"), which the first of its corners makes so; rotations are those of knots alone. Sets hold their nodes with the
others of fibres and cross-sections, so that an interface on them takes these along.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem.constraints import AverageElement, RigidElement
from morembs.fem.fe_model import Component
from morembs.importers.decks.expansion.equations import mean_equations
from morembs.importers.decks.expansion.solids import FibreNodes
from morembs.importers.decks.labels import find, in_ranges, ranges_of
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.decks.tables import DeckTables, Surface


def with_names(deck: DeckTables, nodes: FibreNodes, problems: Problems) -> DeckTables:
    """The deck whose sets, surfaces and couplings name the nodes that it has now."""
    labels, counts = np.unique(nodes.parent, return_counts=True)
    single = np.flatnonzero(~np.isin(nodes.parent, labels[counts > 1]))
    members, parents = nodes.labels[single], nodes.parent[single]
    became = {int(node): own[own > 0] for node, own in zip(parents, members, strict=True)}
    # The first corner follows the node and the others.
    free = {node: np.append(node, own[1:]) for node, own in became.items()}
    _refuse_masters(deck, nodes.parent if deck.program == "CalculiX" else parents, problems)
    rigid = tuple(_rigid(deck, element, free) for element in deck.rigid)
    average = tuple(_average(element, became) for element in deck.average)
    deck = replace(deck, rigid=rigid, average=average)
    _refuse_rotations(deck, became, problems)
    more = members[:, 1:]
    flat, of = more[more > 0], np.repeat(parents, (more > 0).sum(axis=1))
    sets = {
        name: own if not (chosen := in_ranges(of, own)).any() else _with(own, flat[chosen])
        for name, own in deck.node_sets.items()
    }
    surfaces = {name: _surface(surface, free) for name, surface in deck.surfaces.items()}
    equations = list(deck.equations)
    for count in (2, 4):
        rows = single[nodes.is_corner[single].sum(axis=1) == count]
        corners = nodes.labels[rows][nodes.is_corner[rows]].reshape(-1, count)
        equations += mean_equations(nodes.parent[rows], corners)
    return replace(deck, node_sets=sets, surfaces=surfaces, equations=tuple(equations))


def _with(ranges: Ints, more: Ints) -> Ints:
    """Ranges of labels with ``more`` of them."""
    return ranges_of(np.concatenate([*(np.arange(a, b + 1) for a, b in ranges.tolist()), more]))


def _surface(surface: Surface, became: Mapping[int, Ints]) -> Surface:
    """A surface on what its nodes became, which share their weights."""
    nodes, weights = _share_weights(surface.nodes, surface.weights, became)
    order = np.argsort(nodes, kind="stable")
    return surface if len(nodes) == len(surface.nodes) else Surface(nodes=nodes[order], weights=weights[order])


def _share_weights(nodes: Ints, weights: Floats, became: Mapping[int, Ints]) -> tuple[Ints, Floats]:
    """Nodes, replaced by the nodes of their expansion, and weights that these share."""
    own = [became.get(int(node), np.array([node])) for node in nodes]
    shares = [np.full(len(part), weight / len(part)) for part, weight in zip(own, weights, strict=True)]
    return np.concatenate([nodes[:0], *own]), np.concatenate([weights[:0], *shares])


def _average(element: AverageElement, became: Mapping[int, Ints]) -> AverageElement:
    nodes, weights = _share_weights(element.nodes, element.weights, became)
    return replace(element, nodes=nodes, weights=weights)


def _rigid(deck: DeckTables, element: RigidElement, became: Mapping[int, Ints]) -> RigidElement:
    """A rigid element: of Abaqus its slaves turn with it, of CalculiX it has their translations alone, as a hinge."""
    if deck.program == "CalculiX":
        return replace(element, components=tuple(c for c in element.components if c < 3))
    if len(element.components) < Component.SCALAR:
        return element
    slaves, _ = _share_weights(element.slaves, np.ones(len(element.slaves)), became)
    return replace(element, slaves=slaves)


def _refuse_masters(deck: DeckTables, nodes: Ints, problems: Problems) -> None:
    """Problems of rigid elements whose masters are among ``nodes``; in CalculiX they turn without a knot there, too."""
    for element in deck.rigid:
        if element.master in nodes:
            what = f"the master {element.master} of the rigid element {element.name!r} is a node of a shell or beam"
            _refuse(problems, deck.name, f"{deck.name}: {what}")


def _refuse_rotations(deck: DeckTables, became: Mapping[int, Ints], problems: Problems) -> None:
    """Problems of what acts on rotations of nodes that have none."""
    named = [(own.nodes, own.components, own.name) for own in deck.equations]
    named += [(own.nodes, own.components, own.name) for own in deck.discrete]
    named += [(own.term_nodes, own.term_components, own.name) for own in deck.equations]
    named += [(np.full(3, own.node), np.array([3, 4, 5]), own.name) for own in deck.masses if own.inertia.any()]
    named += [(np.array([own.reference]), np.array([3]), own.name) for own in deck.average]
    known = np.array(sorted(became), dtype=np.int64)
    for nodes, components, name in named:
        bare = (components > 2) & (components < Component.SCALAR) & find(known, nodes)[1]
        if bare.any():
            what = f"{deck.name}: {name!r} acts on rotations of node {nodes[bare][0]}, which has none here"
            _refuse(problems, deck.name, what)


def _refuse(problems: Problems, deck: str, what: str) -> None:
    problems.add(Problem(what=f"{what}; --engine calculix may assemble the deck", file=deck))
