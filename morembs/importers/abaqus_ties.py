"""*TIE, and contact pairs that are glued: nodes of one surface follow the faces of another by their shape functions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.abaqus_assembly import Assembly, Placed
from morembs.importers.abaqus_keywords import Card, number
from morembs.importers.abaqus_surfaces import Surfaces
from morembs.importers.projection import face_size, project
from morembs.model.constraints import Equations

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Parts of the mean size of the master's faces within which nodes are tied where a deck says nothing.
_TOLERANCE = {"abaqus": 0.05, "calculix": 0.025}
_OF_CONTACT = 0.05
SECTORS = ("CYCLIC SYMMETRY", "MULTISTAGE", "FLUID PERIODIC", "FLUID CYCLIC")


def glued(
    assembly: Assembly, surfaces: Surfaces, placed: Placed, card: Card, row: list[str], taken: set[int], dialect: str
) -> tuple[Equations | None, list[str], list[str]]:  # fmt: skip
    """The equations of one pair "slave, master", with notes and warnings.

    Slave nodes are moved to the master's faces, as the programs do unless ADJUST=NO; nodes that are ``taken`` follow
    something else already and are left to it. Nodes further away than the tolerance are not tied.

    Raises:
        InputError: a pair that cannot be glued, or of which no node is near enough.
    """
    if len(row) < 2 or not row[1]:
        raise InputError(f"{card} names {', '.join(row) or 'nothing'}; expected a slave and a master surface")
    contact = card.keyword == "CONTACT PAIR"
    slave, master = surfaces.of(placed, row[0], card), surfaces.of(placed, row[1], card)
    if not master.faces:
        slave, master = master, slave
    if not master.faces:
        raise InputError(f"{card}: neither {row[0]!r} nor {row[1]!r} has faces of solids; expected a master of faces")
    size = face_size(assembly.xyz, master.faces)
    tolerance = _tolerance(card, size, dialect, contact=contact)
    inner = np.unique(np.concatenate([faces.ravel() for _, faces in master.faces]))
    nodes = slave.nodes[~np.isin(slave.nodes, inner)]
    free = np.array([node not in taken for node in nodes.tolist()], dtype=bool)
    late, nodes = int((~free).sum()), nodes[free]
    found = project(assembly.xyz[nodes], assembly.xyz, master.faces)
    near = found.distance <= tolerance
    title = f"*{card.keyword} {card.options.get('NAME') or f'{row[0]} {row[1]}'}"
    notes, warnings = _said(assembly, title, nodes, found.distance, near, tolerance, late)
    if contact:
        warnings.append(
            f"the contact pair {row[0]}, {row[1]} was glued where its surfaces are within {tolerance:.3g} of each "
            f"other ({int(near.sum())} nodes) [contact-tied]"
        )
    if not near.any():
        if late or contact or not len(slave.nodes) or not len(nodes):
            warnings.append(f"{title} ties nothing: none of its nodes is free and near enough")
            return None, notes, warnings
        raise InputError(
            f"{card}: no node of {row[0]!r} is within {tolerance:.3g} of the faces of {row[1]!r} (the nearest is "
            f"{found.distance.min():.3g} away); check the surfaces, or give POSITION TOLERANCE"
        )
    if card.options.get("ADJUST", "YES").upper() != "NO":
        assembly.xyz[nodes[near]] = found.foot[near]
    taken.update(nodes[near].tolist())
    return _equations(title, nodes[near], found.nodes[near], found.weights[near]), notes, warnings


def _tolerance(card: Card, size: float, dialect: str, *, contact: bool) -> float:
    word = "ADJUST" if contact else "POSITION TOLERANCE"
    text = card.options.get(word, "")
    try:
        given = number(text, card) if text else 0.0
    except InputError:
        if not contact:  # ADJUST may also name a set
            raise
        given = 0.0
    share = _OF_CONTACT if contact else _TOLERANCE[dialect]
    return max(given, share * size) if contact or not text else given


def _said(
    assembly: Assembly, title: str, nodes: Ints, distance: Floats, near: NDArray[np.bool_], tolerance: float, late: int
) -> tuple[list[str], list[str]]:  # fmt: skip
    """Notes on what was moved, warnings of what was not tied."""
    notes, warnings = [], []
    moved = float(distance[near].max(initial=0.0))
    if moved > 0:
        notes.append(f"{title}: {int(near.sum())} nodes were moved to the faces they follow, by up to {moved:.3g}.")
    away = nodes[~near]
    if len(away):
        some = ", ".join(map(str, assembly.ids[away[:10]].tolist()))
        warnings.append(
            f"{title}: {len(away)} nodes are further than {tolerance:.3g} from the other surface and are not tied "
            f"({some}{', ...' if len(away) > 10 else ''})"
        )
    if late:
        warnings.append(f"{title}: {late} nodes follow something else already and were left to it")
    return notes, warnings


def _equations(title: str, nodes: Ints, on: Ints, weights: Floats) -> Equations:
    """u = sum of weights times u of the nodes ``on`` (n, w) the faces, in x, y and z."""
    used = weights != 0
    count = np.repeat(used.sum(axis=1), 3)
    rows = np.repeat(np.arange(len(nodes)), 3)
    terms, values = np.repeat(on, 3, axis=0)[used[rows]], np.repeat(weights, 3, axis=0)[used[rows]]
    component = np.tile(np.arange(3), len(nodes))
    return Equations(
        name=title, nodes=nodes[rows], components=component, offsets=np.concatenate([[0], np.cumsum(count)]),
        term_nodes=terms, term_components=np.repeat(component, count), coefficients=values,
    )  # fmt: skip


def is_sector(card: Card) -> bool:
    """Whether a *TIE joins the sides of a sector, and not two surfaces."""
    return any(word in card.options for word in SECTORS)


