"""Fibres and cross-sections of shells and beams: which elements share those of a node, and along which directions.

CalculiX CrunchiX User's Manual, "Eight-node shell element" and "Three-node 3D beam element": elements at a node whose
normals (and, of beams, tangents) are within 20 degrees of those of the element with the lowest label, and that have its
thicknesses and offsets, share one fibre along the mean normal; the others begin again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Bools, Floats, Ints
from morembs.fem.elements import FACES
from morembs.importers.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Corners:
    """Nodes (m,) of elements, one of an element after the other: ``node`` rows of the deck, ``label`` of the element.

    ``normal`` (m, 3) of shells, or the second section axis of beams, whose axis is ``tangent`` (m, 3). ``alike``
    (m, 5): thicknesses, distances from the node to the middle, and a number for the profile, which corners that share
    a fibre have in common. ``is_beam``, ``is_linear``, ``is_middle`` (m,): of beams, of those with two nodes, at the
    third node of others; ``is_hinged`` (m,): of membranes and trusses, which share none; ``is_given`` (m,): the normal
    is said by the deck.
    """

    node: Ints
    label: Ints
    normal: Floats
    tangent: Floats
    alike: Floats
    is_beam: Bools
    is_linear: Bools
    is_middle: Bools
    is_hinged: Bools
    is_given: Bools

    def __getitem__(self, rows: Ints) -> Corners:
        return Corners(**{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class Fibres:
    """Fibres (g,) of shells and cross-sections of beams: rows of the ``node``, ``normal`` (g, 3) and, of beams, the
    ``first`` section axis (g, 3); ``of`` (m,) the fibre of each corner, ``member`` (g,) a corner of each.

    ``is_straight`` (n,) says of which nodes of the deck all normals are on one line.
    """

    node: Ints
    normal: Floats
    first: Floats
    of: Ints
    member: Ints
    is_straight: Bools


def shell_normals(shape: str, x: Floats) -> Floats:
    """Unit normals (e, k, 3) of faces with the node coordinates ``x`` (e, k, 3) at their nodes.

    Raises:
        InputError: a face without an area there.
    """
    kind = FACES[shape]
    _, dN = kind.shape(kind.reference)
    tangents = np.einsum("eka,qkr->eqra", x, dN, optimize=True)
    return _unit(np.cross(tangents[:, :, 0], tangents[:, :, 1]), "a shell has no normal at one of its nodes")


def beam_tangents(x: Floats) -> Floats:
    """Unit tangents (e, k, 3) of lines with the node coordinates ``x`` (e, k, 3), ends first, at their nodes.

    Raises:
        InputError: a line without a length there.
    """
    a, b = x[:, 0], x[:, 1]
    if x.shape[1] == 2:
        along = np.stack([b - a, b - a], axis=1)
    else:
        middle = x[:, 2]
        along = np.stack([4 * middle - 3 * a - b, a + 3 * b - 4 * middle, b - a], axis=1)
    return _unit(along, "a beam has no tangent at one of its nodes")


def second_axes(tangent: Floats, direction: Floats) -> Floats:
    """Second section axes (m, 3), across ``tangent`` (m, 3) and a ``direction`` (m, 3) near the first one.

    Raises:
        InputError: a direction along the tangent.
    """
    return _unit(np.cross(tangent, direction), "the first axis of a *BEAM SECTION is along one of its beams")


def fibres_of(corners: Corners, count: int) -> Fibres:
    """The fibres at ``count`` nodes.

    Raises:
        InputError: normals whose mean has no direction.
    """
    order = np.lexsort((corners.label, corners.is_beam, corners.node))
    own = corners[order]
    reference = np.flatnonzero(np.diff(own.node, prepend=-1))
    first_of = np.repeat(reference, np.diff(np.append(reference, len(order))))
    cosine = np.einsum("ma,ma->m", own.normal, own.normal[first_of])
    is_separate = _have_own_fibre(own, own[first_of], cosine, TOL.near_normal)
    hard = np.zeros(count, dtype=bool)
    hard[own.node[is_separate | own.is_given | (own.is_hinged & (first_of != np.arange(len(order))))]] = True
    straight = np.ones(count, dtype=bool)
    straight[own.node[own.is_beam | (np.abs(cosine) < TOL.same_normal)]] = False
    # Of most nodes all corners share one fibre.
    of = np.full(len(order), -1)
    easy = ~hard[own.node]
    of[easy] = np.cumsum(np.diff(own.node[easy], prepend=-1) != 0) - 1
    members = [reference[easy[reference]]]
    rows = np.flatnonzero(easy)
    means = [_means(own, rows, of[rows], own.normal[rows], members[0])]
    for number, (group, pivot, given) in enumerate(_groups(own, np.flatnonzero(~easy)), start=len(members[0])):
        of[group] = number
        members.append(np.array([pivot]))
        normals = np.where((group == pivot)[:, None] | (not given), own.normal[group], 0.0)
        means.append(_means(own, group, np.zeros(len(group), dtype=np.int64), normals, members[-1]))
    member = np.concatenate(members)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return Fibres(
        node=own.node[member],
        normal=np.concatenate([normal for normal, _ in means]),
        first=np.concatenate([first for _, first in means]),
        of=of[place],
        member=order[member],
        is_straight=straight,
    )


def _groups(own: Corners, rows: Ints) -> Iterator[tuple[Ints, int, bool]]:
    """Corners that share a fibre, that which it began with, and whether its normal was given, of the corners ``rows``,
    sorted by node, shells first, and label; of a corner in several the last counts."""
    key = 2 * own.node[rows] + own.is_beam[rows]
    for at in np.split(rows, np.flatnonzero(np.diff(key)) + 1):
        each, left = own[at], np.ones(len(at), dtype=bool)
        while left.any():
            given = left & each.is_given
            pivot = int(np.flatnonzero(given if given.any() else left)[0])
            base = own[np.full(len(at), at[pivot])]
            cosine = np.einsum("ma,ma->m", each.normal, base.normal)
            near = ~_have_own_fibre(each, base, cosine, TOL.same_normal if given.any() else TOL.near_normal)
            # A beam may leave the section of an earlier one for that of a later one; shells stay.
            near &= ~(each.is_hinged | base.is_hinged) & (left | each.is_beam)
            near[pivot] = True
            left &= ~near
            yield at[near], int(at[pivot]), bool(given.any())


def _have_own_fibre(each: Corners, base: Corners, cosine: Floats, least: float) -> Bools:
    """Which corners do not share the fibre of others (m,), with the cosines (m,) of their normals."""
    along = np.einsum("ma,ma->m", each.tangent, base.tangent)
    unlike = np.abs(each.alike - base.alike).max(axis=1, initial=0.0) >= TOL.same_thickness
    return np.asarray((cosine <= least) | unlike | (each.is_beam != base.is_beam) | (each.is_beam & (along <= least)))


def _means(own: Corners, rows: Ints, group: Ints, normals: Floats, pivot: Ints) -> tuple[Floats, Floats]:
    """Mean normals and first axes (g, 3) of corners ``rows`` (m,) in groups (m,), whose ``normals`` (m, 3) count;
    ``pivot`` (g,) a corner of each."""
    normal, tangent = np.zeros((len(pivot), 3)), np.zeros((len(pivot), 3))
    np.add.at(normal, group, normals)
    np.add.at(tangent, group, own.tangent[rows])
    beam = own.is_beam[pivot]
    tangent[beam] = _unit(tangent[beam], "tangents of beams at a node have no mean")
    along = np.einsum("ga,ga->g", normal, tangent)
    normal[beam] -= along[beam, None] * tangent[beam]
    normal = _unit(normal, "normals at a node have no mean")
    return normal, np.where(beam[:, None], np.cross(normal, tangent), 0.0)


def _unit(vectors: Floats, why: str) -> Floats:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not (size > TOL.least_normal).all():
        raise InputError(f"{why}; mend the mesh, or its section", kind="model")
    return np.asarray(vectors / size)
