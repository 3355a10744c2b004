"""Shells and beams as solids on the nodes of their fibres and cross-sections.

CalculiX CrunchiX User's Manual: "Eight-node shell element" and "Three-node 3D beam element" with their figures. A fibre
has a node at the bottom, in the middle and on top; a cross-section has four at its corners and four between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from morembs.base.types import Bools, Floats, Ints
from morembs.importers.decks.expansion.normals import Corners, Fibres, beam_tangents, second_axes, shell_normals
from morembs.importers.decks.expansion.sections import Structure
from morembs.importers.decks.tables import DeckTables


@dataclass(frozen=True)
class Becomes:
    """The ``shape`` of the solid, and for each of its nodes that of the element and the one of its fibre."""

    shape: str
    nodes: tuple[tuple[int, int], ...]


def _layers(corners: int, *, middles: bool) -> tuple[tuple[int, int], ...]:
    sides = [[(i, layer) for i in range(corners)] for layer in (0, 2)]
    if not middles:
        return (*sides[0], *sides[1])
    edges = [[(corners + i, layer) for i in range(corners)] for layer in (0, 2)]
    return (*sides[0], *sides[1], *edges[0], *edges[1], *((i, 1) for i in range(corners)))


_BAR = ((0, 0), (1, 0), (1, 1), (0, 1), (0, 3), (1, 3), (1, 2), (0, 2))
_EDGES = ((2, 0), (1, 4), (2, 1), (0, 4), (2, 3), (1, 6), (2, 2), (0, 6), (0, 7), (1, 7), (1, 5), (0, 5))
# Most nodes of a fibre or cross-section.
WIDTH = len(_BAR)
_BECOMES: Mapping[str, Becomes] = MappingProxyType(
    {
        "tri3": Becomes("wedge6", _layers(3, middles=False)),
        "quad4": Becomes("hex8", _layers(4, middles=False)),
        "tri6": Becomes("wedge15", _layers(3, middles=True)),
        "quad8": Becomes("hex20", _layers(4, middles=True)),
        "line2": Becomes("hex8", _BAR),
        "line3": Becomes("hex20", (*_BAR, *_EDGES)),
    }
)


def solid_nodes(shape: str, fibre: Ints) -> tuple[str, Ints]:
    """Shape of the solids of elements and numbers (e, n) of their nodes, ``WIDTH`` for each fibre, in VTK order.

    Args:
        fibre: (e, k) of the nodes of the elements.
    """
    becomes = _BECOMES[shape]
    place, layer = np.array(becomes.nodes).T
    return becomes.shape, np.asarray(WIDTH * fibre[:, place] + layer)


def corners_of(part: Structure, xyz: Floats, nodes: Ints) -> Corners:
    """The nodes (e, k) of elements, rows of the deck at ``xyz`` (n, 3), one element after the other.

    Raises:
        InputError: an element without a size, or a beam along its first axis.
    """
    elements, section, x = part.elements, part.section, xyz[nodes]
    is_beam, size = section.kind == "beam", nodes.size
    alike = np.zeros((*nodes.shape, 5))
    alike[..., :2], alike[..., 4] = part.widths, part.is_round
    tangent = np.zeros(x.shape)
    if is_beam:
        tangent = beam_tangents(x)
        direction = np.array([0.0, 0.0, -1.0]) if section.direction is None else section.direction
        normal = second_axes(tangent, direction)
        if "offset" in elements.values:
            # OFFSET1 and OFFSET2 of the section are distances along the axes of each node, however these turn.
            line = beam_tangents(x[:, :2])[:, 0]
            second = second_axes(line, direction)
            axes = np.stack([np.cross(second, line), second], axis=-2)
            alike[..., 2:4] = np.einsum("eia,ea->ei", axes, elements.values["offset"][:, 0])[:, None]
    else:
        normal = shell_normals(elements.shape, x)
        alike[..., 2] = section.offset
        if "thickness" in elements.values:
            own = elements.values["thickness"]
            alike[..., 0] = np.where(np.isnan(own), alike[..., 0], own)
    given = elements.values.get("normal", np.full(x.shape, np.nan))
    is_given = ~np.isnan(given[..., 0])
    normal = np.where(is_given[..., None], given, normal)
    return Corners(
        node=nodes.ravel(),
        label=np.repeat(elements.ids, nodes.shape[1]),
        normal=normal.reshape(size, 3),
        tangent=tangent.reshape(size, 3),
        alike=alike.reshape(size, 5),
        is_beam=np.full(size, is_beam),
        is_linear=np.full(size, elements.shape == "line2"),
        is_middle=np.arange(size) % nodes.shape[1] == (2 if elements.shape == "line3" else -1),
        is_hinged=np.zeros(size, dtype=bool),
        is_given=is_given.ravel(),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class FibreNodes:
    """Nodes of fibres (g,): ``labels`` (g, WIDTH), 0 where no solid has one, and places ``xyz`` (g, WIDTH, 3).

    The node with the label ``parent`` (g,) is at the mean of the nodes with ``is_corner`` (g, WIDTH); nodes with
    ``is_there`` (g, WIDTH) count for a knot.
    """

    labels: Ints
    xyz: Floats
    parent: Ints
    is_there: Bools
    is_corner: Bools

    @classmethod
    def of(cls, deck: DeckTables, corners: Corners, fibres: Fibres, used: Ints) -> FibreNodes:
        """Nodes of fibres, with labels beyond those of the deck where solids have them: by the numbers ``used``."""
        count, own = len(fibres.node), corners[fibres.member]
        beam = own.is_beam[:, None]
        labels, made = np.zeros((count, WIDTH), dtype=np.int64), np.unique(used)
        labels.ravel()[made] = 10 ** len(str(int(deck.ids.max()))) + 1 + np.arange(len(made))
        axes = np.stack([np.where(beam, fibres.first, fibres.normal), fibres.normal], axis=1)
        local = _outline(own.alike[:, 4] > 0) * own.alike[:, None, :2]
        local[~own.is_beam] = 0.0
        local[~own.is_beam, :3, 0] = np.array([-0.5, 0.0, 0.5]) * own.alike[~own.is_beam, :1]
        middle = deck.xyz[fibres.node] + np.einsum("gi,gia->ga", own.alike[:, 2:4], axes)
        xyz = middle[:, None] + np.einsum("gli,gia->gla", local, axes)
        place = np.arange(WIDTH)
        # CalculiX turns those at the middle of a beam that no solid has as those at its first node: a knot of a curved
        # beam is in no plane.
        third = np.flatnonzero(own.is_middle)
        turned = axes[fibres.of[fibres.member[third] - 2]]
        around = np.einsum("gli,gia->gla", own.alike[third, None, 2:4] + local[third], turned)
        is_bare = (place > 3) & (labels[third] == 0)
        xyz[third] = np.where(is_bare[..., None], deck.xyz[fibres.node[third], None] + around, xyz[third])
        # CalculiX leaves those of linear beams that no solid has at the origin, where knots find them.
        xyz[own.is_linear[:, None] & (place > 3)] = 0.0
        return cls(
            labels=labels,
            xyz=xyz,
            parent=deck.ids[fibres.node],
            is_there=beam | (place < 3),
            is_corner=np.where(beam, place < 4, (place == 0) | (place == 2)),
        )


def _outline(is_round: Bools) -> Floats:
    """Places (g, WIDTH, 2) of the nodes of rectangles or ellipses along their axes, in widths."""
    sides = np.array([[-1, 0], [0, -1], [1, 0], [0, 1]]) / 2
    corners = np.array([sides[i] + sides[j] for i, j in ((0, 3), (0, 1), (1, 2), (2, 3))])
    shrunk = np.where(is_round, np.sqrt(0.5), 1.0)[:, None, None]
    return np.concatenate([shrunk * corners, np.broadcast_to(sides, (len(is_round), *sides.shape))], axis=1)
