"""Constraints of a deck for CalculiX: rigid bodies, couplings, *MPC and contact that is glued."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import count

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem.constraints import AverageElement
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.cards.deck import FlatText
from morembs.importers.abaqus.constraints import Constraints
from morembs.importers.abaqus.deck import Rows
from morembs.importers.abaqus.equations import mpc_sums
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Placed
from morembs.importers.imported import PointMass


@dataclass(eq=False)
class Flat:
    """The flat deck, and what the model gets from elsewhere: ``average`` elements; ``bodies``, the reference nodes of
    rigid bodies and couplings in the order of the deck; ``turning`` label of a rotation node -> its reference node;
    nodes whose conditions are in axes ``turned`` by *TRANSFORM; nodes of pre-tension sections (``cuts``); element types
    that are read as others, counted (``replaced``: as it is written, as it is taken); what is to be said."""

    deck: FlatText
    constraints: Constraints
    average: list[AverageElement] = field(default_factory=list)
    bodies: list[int] = field(default_factory=list)
    turning: dict[int, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    masses: list[PointMass] = field(default_factory=list)
    turned: set[int] = field(default_factory=set)
    cuts: list[int] = field(default_factory=list)
    replaced: dict[tuple[str, str], int] = field(default_factory=dict)


class Ties:
    """Writes constraints in the words of CalculiX, which has some otherwise than Abaqus and some not at all."""

    def __init__(self, assembly: Assembly, flat: Flat) -> None:
        self.assembly, self.flat = assembly, flat
        self._numbers = count(1)

    def rigid_body(self, placed: Placed, card: Card) -> None:
        """The card on nodes alone: CalculiX stops at elements of shells, and gives a body without reference no mass."""
        options, out = dict(card.options), self.flat.deck
        sets = [options[key] for key in ("NSET", "TIE NSET", "PIN NSET") if options.get(key)]
        own = [self.assembly.nodes_of(placed, text) for text in sets]
        if options.get("ELSET"):
            own.append(self.assembly.nodes_of_elements(self.assembly.elements_of(placed, options["ELSET"])))
        if not own:
            raise InputError(f"{card} names no nodes; expected NSET or ELSET", kind="missing")
        if not options.get("REF NODE"):
            raise InputError(f"{card} names no reference node; give it one: REF NODE=", kind="missing")
        reference = self.assembly.one_node(placed, options["REF NODE"])
        nodes = np.setdiff1d(np.concatenate(own), reference)
        out.followers.update(nodes.tolist())
        kept = {"NSET": out.new_set("n", nodes), "REF NODE": str(reference + 1)}
        if options.get("ROT NODE"):
            turning = self.assembly.one_node(placed, options["ROT NODE"])
            self.flat.turning[turning + 1] = reference + 1
            kept["ROT NODE"] = str(turning + 1)
        else:
            self.flat.bodies.append(reference + 1)
        out.body.append((3, "*RIGID BODY, " + ", ".join(f"{key}={value}" for key, value in kept.items())))

    def mpc(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Types that CalculiX has not or has otherwise: BEAM as a coupling, LINK, PIN, TIE and LINEAR as equations."""
        beams: dict[int, list[Ints]] = {}
        others = []
        for row in rows:
            kind = row[0].upper() if row else ""
            if kind == "BEAM":
                follow, lead = (self.assembly.pair(placed, text) for text in row[1:3])
                if len(lead) not in (1, len(follow)):
                    raise InputError(f"{card} BEAM: {row[2]!r} has {len(lead)} nodes; expected one, or one for each")
                for i, node in enumerate(follow):
                    beams.setdefault(int(lead[i if len(lead) > 1 else 0]), []).append(np.array([node]))
            elif kind in ("LINK", "PIN", "TIE", "LINEAR"):
                for title, terms in mpc_sums(self.assembly, placed, card, row):
                    if any(component > 2 for _, component, _ in terms):
                        raise InputError(
                            f"{title} joins rotations, of which CalculiX has none; give BEAM or PIN", kind="unsupported"
                        )
                    self.flat.deck.terms([(node + 1, c + 1, a) for node, c, a in terms if a], "MPC")
            else:
                others.append(row)
        for reference, nodes in beams.items():
            self._kinematic(reference, np.concatenate(nodes), [])
        if others:
            self.flat.deck.card(placed, card, others)

    def glue(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Contact that is glued."""
        adjust = card.options.get("ADJUST", "")
        options = {"NAME": f"contact {len(self.flat.warnings)}"}
        if adjust[:1].isdigit() or adjust[:1] == ".":
            options["POSITION TOLERANCE"] = adjust
        self.flat.deck.card(placed, Card("TIE", options, card.file), [row[:2] for row in rows])
        self.flat.warnings.append(f"*{card.keyword} was glued as *TIE does [contact-tied]")

    def kinematic_coupling(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Nodes that follow a reference node."""
        for row in rows:
            nodes = self.assembly.nodes_of(placed, row[0])
            self._kinematic(self.assembly.one_node(placed, card.need("REF NODE")), nodes, [row[1:]] if row[1:] else [])

    def _kinematic(self, reference: int, nodes: Ints, rows: Rows) -> None:
        """*COUPLING with *KINEMATIC, whose rotations CalculiX makes of displacements alone."""
        out, name = self.flat.deck, f"KS{next(self._numbers)}"
        own = out.new_set("n", np.setdiff1d(nodes, reference))
        out.followers.update(nodes.tolist())
        held = sorted({d for row in rows for d in range(int(row[0]), int(row[-1]) + 1) if d < 4} if rows else {1, 2, 3})
        self.flat.bodies.append(reference + 1)
        out.surfaces.append(f"*SURFACE, NAME={name}, TYPE=NODE\n{own}")
        dofs = "\n".join(f"{d}, {d}" for d in held)
        text = f"*COUPLING, REF NODE={reference + 1}, SURFACE={name}, CONSTRAINT NAME={name}\n*KINEMATIC\n{dofs}"
        out.body.append((5, text))

    def couplings(self, places: list[Placed]) -> None:
        """*COUPLING with *KINEMATIC for CalculiX, with *DISTRIBUTING as average elements."""
        for placed in places:
            for scope in placed.contents:
                for card, _, kind, kind_rows in scope.constraints:
                    if card.keyword != "COUPLING":
                        continue
                    self._coupling(placed, card, kind, [row for row in kind_rows if row])

    def _coupling(self, placed: Placed, card: Card, kind: Card | None, rows: Rows) -> None:
        if kind is None:
            raise InputError(f"{card} has neither *KINEMATIC nor *DISTRIBUTING; expected one")
        if kind.keyword == "DISTRIBUTING":
            self.flat.constraints.coupling(placed, card, kind, rows)
            self.flat.average = self.flat.constraints.ties.average
            return
        reference = self.assembly.one_node(placed, card.need("REF NODE"))
        self._kinematic(reference, self.flat.deck.nodes_of_surface(placed, card.need("SURFACE"), card), rows)

    def distribute(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Weights of nodes at the node of an element DCOUP3D."""
        self.flat.constraints.distributing_coupling(placed, card, rows)
        self.flat.average = self.flat.constraints.ties.average
