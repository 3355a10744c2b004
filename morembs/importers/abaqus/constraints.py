"""Couplings, rigid bodies, equations, ties, springs and point masses of an input deck, as rows of all its nodes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.constraints import AverageElement, Equations, RigidElement, Term, solved_for_first
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.data import number
from morembs.importers.abaqus.deck import Contents, Rows, values
from morembs.importers.abaqus.equations import Axes, equations_of, mpc_sums, solve
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.left_out import CUT, LOCKED, PRETENSION
from morembs.importers.abaqus.names import Placed
from morembs.importers.abaqus.points import Points
from morembs.importers.abaqus.references import problems_of_references
from morembs.importers.abaqus.surfaces import Surfaces
from morembs.importers.abaqus.ties import Glue, is_sector
from morembs.importers.abaqus.words import CONTACT
from morembs.importers.decks.problems import Problem
from morembs.importers.decks.tables import Tie
from morembs.importers.imported import DiscreteElement, PointMass

_ALL = (0, 1, 2, 3, 4, 5)
_NONE = np.empty(0, dtype=np.int64)
SECTOR = "CYCLIC SYMMETRY MODEL"
_NONLINEAR_MPC = ("PLANE", "STRAIGHT", "MEANROT", "DIST")


@dataclass
class DeckTies:
    """What the lines of a deck tie to the mesh; rows are those of all nodes."""

    rigid: list[RigidElement] = field(default_factory=list)
    average: list[AverageElement] = field(default_factory=list)
    equations: list[Equations] = field(default_factory=list)
    masses: list[PointMass] = field(default_factory=list)
    discrete: list[DiscreteElement] = field(default_factory=list)
    ties: list[Tie] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


class Constraints:
    """Reads what stands in the scopes of an assembly; what cannot be read is a problem of the deck."""

    def __init__(self, deck: Contents, assembly: Assembly) -> None:
        self.assembly = assembly
        self.deck, self.problems, self.options = deck, deck.problems, deck.options
        self.ties = DeckTies()
        self.surfaces, self.axes = Surfaces(assembly), Axes(assembly)
        self._sums: dict[str, list[tuple[str, list[Term]]]] = {"*EQUATION": [], "*MPC": []}
        self._turning: dict[int, int] = {}
        self.references: dict[int, str] = {}
        self._distributing = {
            element.number: element.nodes[0] for element in assembly.discrete if element.code == "DCOUP3D"
        }

    def read(self) -> DeckTies:
        """All of them, ties last: they leave alone what follows something else."""
        self.surfaces.read()
        self.axes.read()
        self._cut_bolts()
        self.ties.notes += self.surfaces.notes
        points = Points(self.deck, self.assembly, self.axes)
        points.read()
        self.ties.masses, self.ties.discrete = points.masses, points.discrete
        self.ties.warnings += points.warnings
        pairs: list[tuple[Placed, Card, Rows]] = []
        for placed in (*self.assembly.placed.values(), self.assembly.top):
            for scope in placed.contents:
                for card, rows, kind, kind_rows in scope.constraints:
                    rows = [row for row in rows if row]
                    if card.keyword == PRETENSION:
                        continue
                    if is_sector(card):
                        refuse_sector(card, self.deck)
                        continue
                    if card.keyword in ("TIE", *CONTACT):
                        pairs.append((placed, card, rows))
                        continue
                    with self.problems.collected(card, (f"--skip {card.keyword}",)):
                        self._read_card(placed, card, rows, kind, [row for row in kind_rows if row])
        if self.deck.dialect == "calculix":
            terms = ((name[1:], term[0], False) for name, sums in self._sums.items() for _, own in sums for term in own)
            self.refuse_references(terms, cure="--dialect abaqus (of its elements too)")
        for name, sums in self._sums.items():
            if sums:
                with self.problems.collected(Card(name[1:], {}, self.deck.name)):
                    self.ties.equations.append(solve(name, map(self._with_rotations, sums), self.axes))
        glue = Glue(self.assembly, self.surfaces, self._followers(), self.deck.dialect)
        glue.read(pairs)
        self.ties.equations += glue.equations
        self.ties.ties = glue.ties
        self.ties.notes += glue.notes
        self.ties.warnings += glue.warnings
        return self.ties

    def _cut_bolts(self) -> None:
        """*PRE-TENSION SECTION, before anything else names the nodes of the cut."""
        for placed in (*self.assembly.placed.values(), self.assembly.top):
            for scope in placed.contents:
                for card, rows, *_ in scope.constraints:
                    if card.keyword == PRETENSION:
                        with self.problems.collected(card, ("--pretension locked",)):
                            self._pretension(placed, card, [row for row in rows if row])

    def _pretension(self, placed: Placed, card: Card, rows: Rows) -> None:
        """A bolt that is locked, or cut: u of one face = u of the other + normal * u_1 of the node of the section
        (CalculiX CrunchiX User's Manual, *PRE-TENSION SECTION).

        Raises:
            InputError: no faces, a normal of no length, or no elements on one of the sides.
        """
        assembly, reference = self.assembly, self.assembly.one_node(placed, card.need("NODE"))
        of = f" of node {assembly.ids[reference]}"
        if self.options.pretension == "locked":
            self.ties.notes.append(LOCKED.format(of))
            return
        surface = self.surfaces.of(placed, card.need("SURFACE"), card)
        cut = np.unique(np.concatenate([_NONE, *(faces.ravel() for _, faces in surface.faces)]))
        normal = placed.rotation @ np.array(values(rows[0], card)[:3]) if rows else _normal(assembly.xyz[cut])
        if not len(cut) or len(normal) != 3 or not np.linalg.norm(normal) > 0:
            raise InputError(
                f"{card} names no faces, or gives no normal; expected a surface of faces and a direction",
                kind="missing",
            )
        normal = normal / np.linalg.norm(normal)
        other = assembly.copy(cut)
        row = np.arange(len(assembly.ids))
        row[cut] = other
        counts = np.zeros(2, dtype=np.int64)
        for i, block in enumerate(assembly.blocks):
            touching = np.isin(block.nodes, cut).any(axis=1)
            middle = assembly.xyz[block.nodes].mean(axis=1) - assembly.xyz[cut].mean(axis=0)
            above = touching & (middle @ normal > 0)
            counts += [above.sum(), (touching & ~above).sum()]
            assembly.blocks[i] = replace(block, nodes=np.where(above[:, None], row[block.nodes], block.nodes))
        if not counts.all():
            raise InputError(f"{card} has elements on one side of its surface only; expected a cut through a bolt")
        sums = [
            (f"{card}", [(int(new), c, 1.0), (int(old), c, -1.0), (reference, 0, -float(normal[c]))])
            for old, new in zip(cut, other, strict=True)
            for c in range(3)
        ]
        self.ties.equations.append(solved_for_first(f"*{PRETENSION}{of}", sums))
        self.ties.notes.append(CUT.format(of))

    def refuse_references(self, named: Iterable[tuple[str, int, bool]], *, cure: str) -> None:
        """What acts on references of distributing couplings becomes a problem of the deck, as of the function below."""
        self.problems.entries += problems_of_references(
            self.deck.name, named, self.ties.average, self.references, self.assembly.ids, self.assembly.xyz, cure=cure
        )

    def _with_rotations(self, given: tuple[str, list[Term]]) -> tuple[str, list[Term]]:
        """A sum with rotations of rigid bodies at their references, where it has displacements of rotation nodes."""
        title, terms = given
        return title, [
            (self._turning[node], 3 + c, value) if node in self._turning and c < 3 else (node, c, value)
            for node, c, value in terms
        ]

    def _read_card(self, placed: Placed, card: Card, rows: Rows, kind: Card | None, kind_rows: Rows) -> None:
        if card.keyword == "COUPLING":
            self.coupling(placed, card, kind, kind_rows)
        elif card.keyword == "KINEMATIC COUPLING":
            self._kinematic_coupling(placed, card, rows)
        elif card.keyword == "DISTRIBUTING COUPLING":
            self.distributing_coupling(placed, card, rows)
        elif card.keyword == "RIGID BODY":
            self._rigid_body(placed, card)
        elif card.keyword == "EQUATION":
            self._sums["*EQUATION"] += equations_of(self.assembly, self.axes, placed, card, rows)
        else:
            self._mpc(placed, card, rows)

    def _followers(self) -> set[int]:
        """Nodes that follow something in a displacement."""
        nodes: set[int] = set()
        for rigid in self.ties.rigid:
            nodes.update(rigid.slaves.tolist() if set(rigid.components) & {0, 1, 2} else [])
        nodes.update(average.reference for average in self.ties.average)
        for given in self.ties.equations:
            nodes.update(given.nodes[given.components < 3].tolist())
        return nodes

    def coupling(self, placed: Placed, card: Card, kind: Card | None, rows: Rows) -> None:
        """*COUPLING with its kind: *KINEMATIC or *DISTRIBUTING."""
        name = card.options.get("CONSTRAINT NAME", "")
        if kind is None:
            raise InputError(f"{card} {name!r} has neither *KINEMATIC nor *DISTRIBUTING; expected one")
        reference = self.assembly.one_node(placed, card.need("REF NODE"))
        nodes, weights = self.surface(placed, card.need("SURFACE"), card)
        components = _components(rows, kind)
        if card.options.get("ORIENTATION") and components not in (_ALL, (0, 1, 2)):
            raise InputError(f"{card} {name!r} ties some directions of an *ORIENTATION; expected all, or global axes")
        if card.options.get("INFLUENCE RADIUS"):
            away = np.linalg.norm(self.assembly.xyz[nodes] - self.assembly.xyz[reference], axis=1)
            near = away <= number(card.options["INFLUENCE RADIUS"], card)
            nodes, weights = nodes[near], weights[near]
        nodes, weights = nodes[nodes != reference], weights[nodes != reference]
        title = self._title(placed, name or card.options["SURFACE"])
        if not len(nodes):
            raise InputError(f"{card} {name!r} ties no nodes; check its surface", kind="unsupported")
        if kind.keyword == "KINEMATIC":
            self.ties.rigid.append(RigidElement(name=title, master=reference, slaves=nodes, components=components))
            return
        method = kind.options.get("WEIGHTING METHOD", "UNIFORM").upper()
        if method != "UNIFORM":
            raise InputError(f"{kind} of {name!r} weighs by {method}; expected UNIFORM", kind="unsupported")
        if not (weights >= 0).all() or not weights.sum() > 0:
            raise InputError(
                f"{card} {name!r} has weights that are not positive; check its surface", kind="unsupported"
            )
        self.references[reference] = card.keyword
        self.ties.average.append(
            AverageElement(name=title, reference=reference, nodes=nodes, weights=weights, components=components)
        )
        self.ties.notes.append(
            f"The distributing coupling {title} weighs nodes of faces by their share of the area, each node of a face "
            "alike, and nodes of a node surface by the numbers given there."
        )

    def _kinematic_coupling(self, placed: Placed, card: Card, rows: Rows) -> None:
        reference = self.assembly.one_node(placed, card.need("REF NODE"))
        if card.options.get("ORIENTATION"):
            raise InputError(f"{card} uses an *ORIENTATION; expected directions along the global axes")
        groups: dict[tuple[int, ...], list[Ints]] = {}
        for row in rows:
            nodes = self.assembly.nodes_of(placed, row[0])
            groups.setdefault(_components([row[1:]] if row[1:] else [], card), []).append(nodes)
        for components, parts in groups.items():
            self._rigid(self._title(placed, "kinematic coupling"), reference, np.concatenate(parts), components, card)

    def distributing_coupling(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Nodes and weights in lines; the reference is the node of the DCOUP3D of its element set."""
        elements = self.assembly.elements_of(placed, card.need("ELSET")).tolist()
        references = [self._distributing[number_] for number_ in elements if number_ in self._distributing]
        if len(references) != 1:
            raise InputError(f"{card} of {card.need('ELSET')!r} has {len(references)} elements DCOUP3D; expected one")
        weights: dict[int, float] = {}
        for row in rows:
            for node in self.assembly.nodes_of(placed, row[0]).tolist():
                weights[node] = number(row[1], card) if len(row) > 1 and row[1] else 1.0
        weights.pop(references[0], None)
        nodes = np.array(sorted(weights), dtype=np.int64)
        given = np.array([weights[node] for node in nodes.tolist()])
        if not len(nodes) or not (given >= 0).all() or not given.sum() > 0:
            raise InputError(
                f"{card} of {card.need('ELSET')!r} has no nodes with positive weights; check its lines", kind="missing"
            )
        title = self._title(placed, card.options["ELSET"])
        self.references[references[0]] = card.keyword
        self.ties.average.append(AverageElement(name=title, reference=references[0], nodes=nodes, weights=given))

    def _rigid_body(self, placed: Placed, card: Card) -> None:
        options = card.options
        if "ANALYTICAL SURFACE" in options:
            self.ties.notes.append(f"{card} moves an analytical surface and was left out.")
            return
        parts = [
            self.assembly.nodes_of(placed, options[key]) for key in ("NSET", "TIE NSET", "PIN NSET") if options.get(key)
        ]
        if options.get("ELSET"):
            parts.append(self.assembly.nodes_of_elements(self.assembly.elements_of(placed, options["ELSET"])))
        if not parts:
            raise InputError(f"{card} names no nodes; expected NSET or ELSET", kind="missing")
        slaves = np.unique(np.concatenate(parts))
        title = self._title(placed, options.get("NSET") or options.get("ELSET") or "rigid body")
        if not len(slaves):
            self.ties.notes.append(f"{card} ({title}) has no nodes of solids and was left out.")
            return
        if options.get("REF NODE"):
            reference = self.assembly.one_node(placed, options["REF NODE"])
            if options.get("POSITION", "INPUT").upper() != "INPUT":
                self.ties.notes.append(f"The reference node of the rigid body {title} stays where the deck has it.")
        else:
            reference = self.assembly.new_node(self.assembly.xyz[slaves].mean(axis=0))
            self.ties.notes.append(
                f"The rigid body {title} names no reference node; node {self.assembly.ids[reference]} was put at its "
                "mean place."
            )
        self._rigid(title, reference, slaves, _ALL, card)
        if options.get("ROT NODE"):
            # What acts on its three translations acts on the rotations of the body.
            turning = self.assembly.one_node(placed, options["ROT NODE"])
            follow = [[(turning, c, 1.0), (reference, 3 + c, -1.0)] for c in range(3)]
            sums = [(f"{card} ({title}), which turns as node {self.assembly.ids[turning]},", terms) for terms in follow]
            self.ties.equations.append(solve(f"*RIGID BODY {title}", sums, self.axes))
            self._turning[turning] = reference

    def _mpc(self, placed: Placed, card: Card, rows: Rows) -> None:
        for row in rows:
            kind = row[0].upper()
            if kind in ("LINEAR", "LINK", "PIN", "TIE"):
                self._sums["*MPC"] += mpc_sums(self.assembly, placed, card, row)
                continue
            if kind != "BEAM" or len(row) != 3:
                why = "is not linear" if kind in _NONLINEAR_MPC else "cannot be carried"
                raise InputError(
                    f"{card} of the type {row[0]!r} {why}; expected LINEAR, LINK, PIN, TIE, or BEAM with two nodes or "
                    "sets; --skip MPC leaves all *MPC out"
                )
            slaves, masters = (self.assembly.nodes_of(placed, text) for text in row[1:])
            if len(masters) == 1:
                self._rigid(self._title(placed, "MPC BEAM"), int(masters[0]), slaves, _ALL, card)
            else:
                raise InputError(
                    f"{card} BEAM: {row[2]!r} has {len(masters)} nodes; expected one that the others follow"
                )

    def _rigid(self, title: str, master: int, slaves: Ints, components: tuple[int, ...], card: Card) -> None:
        slaves = np.unique(slaves[slaves != master])
        if not len(slaves):
            raise InputError(f"{card} ties no nodes to its reference node; check its sets", kind="unsupported")
        self.ties.rigid.append(RigidElement(name=title, master=master, slaves=slaves, components=components))

    def _title(self, placed: Placed, name: str) -> str:
        """A name that is not taken yet."""
        title = f"{placed.name}.{name}" if placed.name and len(self.assembly.placed) > 1 else name
        taken = {element.name for element in self.ties.rigid} | {element.name for element in self.ties.average}
        count, first = 1, title
        while title in taken:
            count += 1
            title = f"{first} {count}"
        return title

    def surface(self, placed: Placed, name: str, card: Card) -> tuple[Ints, Floats]:
        """Rows of the nodes of a surface, and their weights."""
        surface = self.surfaces.of(placed, name, card)
        return surface.nodes, surface.weights


def _normal(xyz: Floats) -> Floats:
    """The normal of the plane next to points (n, 3)."""
    return np.linalg.svd(xyz - xyz.mean(axis=0))[2][2] if len(xyz) else np.zeros(3)


def refuse_sector(card: Card, deck: Contents) -> None:
    """A *TIE of the sides of a sector is a problem, unless sectors are to be taken as they are."""
    if deck.options.skips(SECTOR):
        deck.skip(Card(SECTOR, {}, card.file))
        return
    what = (
        f"{card} joins the sides of a sector, which stands for a whole turn and is another body; --skip {SECTOR!r} "
        "takes the sector alone, with free sides"
    )
    deck.problems.add(
        Problem(what=what, file=card.file, line=card.line, keyword=card.keyword, flags=(f"--skip {SECTOR}",))
    )


def _components(rows: Rows, card: Card) -> tuple[int, ...]:
    """Components 0 to 5 of lines "first, last"; all of them without a line."""
    components: set[int] = set()
    for row in rows:
        ends = [int(text) if text in ("1", "2", "3", "4", "5", "6") else 0 for text in row[:2]]
        if not ends or 0 in ends or ends[0] > ends[-1]:
            raise InputError(f"{card}: {', '.join(row)!r} was given; expected the first and the last direction, 1 to 6")
        components |= set(range(ends[0] - 1, ends[-1]))
    return tuple(sorted(components)) if components else _ALL
