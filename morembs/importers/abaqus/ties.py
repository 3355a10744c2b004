"""*TIE, and contact that is glued: nodes of one surface follow the faces of another by their shape functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import Mesh, Nodes
from morembs.fem.constraints import Equations
from morembs.fem.surface import outer_faces
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.data import number
from morembs.importers.abaqus.deck import Rows
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.abaqus.surfaces import Surfaces
from morembs.importers.decks.facing import Facing
from morembs.importers.decks.projection import face_size, project
from morembs.importers.decks.tables import Surface, Tie
from morembs.importers.tolerances import TOL

_SECTORS = ("CYCLIC SYMMETRY", "MULTISTAGE", "FLUID PERIODIC", "FLUID CYCLIC")
Pair = tuple[Placed, Card, list[str]]


def is_sector(card: Card) -> bool:
    """True if a *TIE joins the sides of a sector, and not two surfaces."""
    return card.keyword == "TIE" and any(word in card.options for word in _SECTORS)


class Glue:
    """The equations of *TIE and of glued contact, with notes and warnings.

    Slave nodes are moved to the master's faces, as the programs do unless ADJUST=NO; nodes that are ``taken`` follow
    something else already and are left to it. Other nodes are tied as the program of the deck does: Abaqus
    ties those whose nearest point of the master is within a tolerance, CalculiX those of ``Facing``.
    """

    def __init__(self, assembly: Assembly, surfaces: Surfaces, taken: set[int], dialect: str) -> None:
        self.assembly, self.surfaces, self.taken, self.dialect = assembly, surfaces, taken, dialect
        self.equations: list[Equations] = []
        self.ties: list[Tie] = []
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self._pairs: list[tuple[Pair, Surface, Surface]] = []

    def read(self, places: Sequence[tuple[Placed, Card, Rows]]) -> None:
        """The pairs "slave, master" of all cards; what cannot be glued is a problem of the deck."""
        problems = self.assembly.problems
        for placed, card, rows in places:
            for row in rows if card.keyword != "CONTACT" else []:
                with problems.collected(card, (f"--skip {card.keyword}",)):
                    self._pairs.append(((placed, card, row), *self._sides(placed, card, row)))
        of_ties = [master for (_, card, _), _, master in self._pairs if card.keyword == "TIE"]
        walks = bool(of_ties) and self.dialect == "calculix"
        facing = Facing(self.assembly.xyz, [master.faces for master in of_ties]) if walks else None
        count = 0
        for (_, card, row), slave, master in self._pairs:
            with problems.collected(card, (f"--skip {card.keyword}",)):
                tie = card.keyword == "TIE"
                self._glue(card, row, slave, master, facing if tie else None, count)
                count += tie
        if any(card.keyword == "CONTACT" for _, card, _ in places):
            self._everywhere()

    def _sides(self, placed: Placed, card: Card, row: list[str]) -> tuple[Surface, Surface]:
        """Slave and master.

        Raises:
            InputError: no two surfaces, or none of faces.
        """
        if len(row) < 2 or not row[1]:
            raise InputError(f"{card} names {', '.join(row) or 'nothing'}; expected a slave and a master surface")
        slave, master = self.surfaces.of(placed, row[0], card), self.surfaces.of(placed, row[1], card)
        if not master.faces:
            slave, master = master, slave
        if not master.faces:
            raise InputError(
                f"{card}: neither {row[0]!r} nor {row[1]!r} has faces of solids; expected a master of faces"
            )
        return slave, master

    def _glue(
        self, card: Card, row: list[str], slave: Surface, master: Surface, facing: Facing | None, count: int
    ) -> None:
        xyz, contact = self.assembly.xyz, card.keyword == "CONTACT PAIR"
        inner = np.unique(np.concatenate([faces.ravel() for _, faces in master.faces]))
        nodes = slave.nodes[~np.isin(slave.nodes, inner)]
        free = np.array([node not in self.taken for node in nodes.tolist()], dtype=bool)
        late, nodes = int((~free).sum()), nodes[free]
        given = _given_tolerance(card, contact=contact)
        if facing is None:
            least = TOL.tie_distance * face_size(xyz, master.faces)
            tolerance = max(given, least) if contact or not given else given
            projection = project(xyz[nodes], xyz, master.faces)
            near = projection.distance <= tolerance
        else:
            tolerance = given or facing.tolerance
            projection, near = facing.on(xyz[nodes], xyz, count, tolerance)
        title = f"*{card.keyword} {card.options.get('NAME') or f'{row[0]} {row[1]}'}"
        beyond = ", or beyond the border of its faces," if facing is not None else ""
        moves = card.options.get("ADJUST", "YES").upper() != "NO"
        gap = float(np.linalg.norm(projection.foot - xyz[nodes], axis=1)[near].max(initial=0.0))
        if gap > 0 and moves:
            self.notes.append(
                f"{title}: {int(near.sum())} nodes were moved to the faces they follow, by up to {gap:.3g}."
            )
        elif gap > TOL.tie_gap * np.ptp(xyz, axis=0).max():
            also = ", as in CalculiX" if self.dialect == "calculix" else ""
            self.warnings.append(
                f"{title}: {int(near.sum())} nodes follow faces up to {gap:.3g} away without being moved there "
                f"(ADJUST=NO): rotations of the body strain it{also} [tie-gap]"
            )
        self._say_left(title, nodes[~near], f"{tolerance:.3g} from the other surface{beyond}", late)
        if contact:
            self.warnings.append(
                f"the contact pair {row[0]}, {row[1]} was glued where its surfaces are within {tolerance:.3g} of each "
                f"other ({int(near.sum())} nodes) [contact-tied]"
            )
        if not near.any():
            if late or contact or not len(nodes):
                self.warnings.append(f"{title} ties nothing: none of its nodes is free and near enough")
                return
            raise InputError(
                f"{card}: no node of {row[0]!r} is within {tolerance:.3g} of the faces of {row[1]!r} (the nearest is "
                f"{project(xyz[nodes], xyz, master.faces).distance.min():.3g} away){beyond.rstrip(',')}; check the "
                "surfaces, or give POSITION TOLERANCE",
                kind="unsupported",
            )
        if moves:
            xyz[nodes[near]] = projection.foot[near]
        self.taken.update(nodes[near].tolist())
        self.equations.append(_equations(title, nodes[near], projection.nodes[near], projection.weights[near]))
        names = {id(surface): name for name, surface in self.surfaces.named.items()}
        tie = Tie(name=title, slave=names[id(slave)], master=names[id(master)], tolerance=given, moves=moves)
        self.ties.append(replace(tie, is_contact=contact))

    def _everywhere(self) -> None:
        """General contact: outer faces of bodies with those of others within the tolerance; the finer follow."""
        xyz, total = self.assembly.xyz, 0
        for pair in combinations(self._bodies(), 2):
            fine, coarse = sorted(pair, key=lambda faces: face_size(xyz, faces))
            tolerance = TOL.tie_distance * face_size(xyz, coarse)
            inner, nodes = (np.unique(np.concatenate([rows.ravel() for _, rows in faces])) for faces in (coarse, fine))
            box = xyz[inner].min(axis=0) - tolerance, xyz[inner].max(axis=0) + tolerance
            nodes = nodes[((xyz[nodes] >= box[0]) & (xyz[nodes] <= box[1])).all(axis=1)]
            nodes = np.array([node for node in nodes.tolist() if node not in self.taken], dtype=np.int64)
            projection = project(xyz[nodes], xyz, coarse)
            near = projection.distance <= tolerance
            if near.any():
                xyz[nodes[near]] = projection.foot[near]
                self.taken.update(nodes[near].tolist())
                title = f"*CONTACT {len(self.equations) + 1}"
                self.equations.append(_equations(title, nodes[near], projection.nodes[near], projection.weights[near]))
                total += int(near.sum())
        self.warnings.append(
            f"general contact was glued where outer faces of different bodies are within {TOL.tie_distance:.0%} of a "
            f"face of each other ({total} nodes) [contact-tied]"
        )

    def _bodies(self) -> list[list[tuple[str, Ints]]]:
        """The outer faces of the parts of the mesh that share no nodes."""
        ends = [(np.repeat(b.nodes[:, 0], b.nodes.shape[1]), b.nodes.ravel()) for b in self.assembly.blocks]
        first, nodes = (np.concatenate([pair[i] for pair in ends]) for i in (0, 1))
        links = sp.coo_array((np.ones(len(first), dtype=bool), (first, nodes)), shape=(len(self.assembly.ids),) * 2)
        part = connected_components(sp.csr_array(links), directed=False)[1]
        mesh = Mesh(nodes=Nodes(ids=self.assembly.ids, xyz=self.assembly.xyz), blocks=tuple(self.assembly.blocks))
        outer = outer_faces(mesh)
        return [
            [(kind, faces[part[faces[:, 0]] == body]) for kind, faces in outer.items() if body in part[faces[:, 0]]]
            for body in np.unique(part[first]).tolist()
        ]

    def _say_left(self, title: str, left: Ints, away: str, late: int) -> None:
        """Warnings of what is not tied."""
        if len(left):
            some = ", ".join(map(str, self.assembly.ids[left[:10]].tolist()))
            self.warnings.append(
                f"{title}: {len(left)} nodes are further than {away} and are not tied "
                f"({some}{', ...' if len(left) > 10 else ''})"
            )
        if late:
            self.warnings.append(f"{title}: {late} nodes follow something else already and were left to it")


def _given_tolerance(card: Card, *, contact: bool) -> float:
    """The tolerance that a card gives, 0 without."""
    text = card.options.get("ADJUST" if contact else "POSITION TOLERANCE", "")
    try:
        return number(text, card)
    except InputError:
        if not contact:  # ADJUST may also name a set
            raise
        return 0.0


def _equations(title: str, nodes: Ints, on: Ints, weights: Floats) -> Equations:
    """u = sum of weights times u of the nodes ``on`` (n, w) the faces, in x, y and z."""
    used = weights != 0
    count = np.repeat(used.sum(axis=1), 3)
    rows = np.repeat(np.arange(len(nodes)), 3)
    terms, values = np.repeat(on, 3, axis=0)[used[rows]], np.repeat(weights, 3, axis=0)[used[rows]]
    component = np.tile(np.arange(3), len(nodes))
    return Equations(
        name=title,
        nodes=nodes[rows],
        components=component,
        offsets=np.concatenate([[0], np.cumsum(count)]),
        term_nodes=terms,
        term_components=np.repeat(component, count),
        coefficients=values,
    )
