"""From the tables of a deck to the flat deck for CalculiX, and what stays outside of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.abaqus_assembly import Assembly, Placed
from morembs.importers.abaqus_constraints import Constraints
from morembs.importers.abaqus_deck import Rows, values
from morembs.importers.abaqus_keywords import Card, number
from morembs.importers.abaqus_words import NOTED, SILENT
from morembs.importers.engines.calculix_deck import CARDS, FlatDeck, numeral
from morembs.importers.engines.calculix_read import EngineDeck
from morembs.model.constraints import AverageElement

Ints = NDArray[np.int64]
# Cards that are the linear model itself, or go into it in another way; those of steps only with a preload.
_PLAIN = set(CARDS) - {"BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE", "STATIC", "ORIENTATION", "DISTRIBUTION",
                       "DISTRIBUTING COUPLING", "SOLID SECTION"}  # fmt: skip
_IN_STEPS = ("STATIC", "BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE")
# Left out with a warning: the body is that of the deck without them.
_WARNED = {"CYCLIC SYMMETRY MODEL": "the body is the sector alone", "ROTARY INERTIA": "CalculiX has none"}
_CONTACT = ("CONTACT PAIR", "CONTACT", "CLEARANCE", "CONTACT DAMPING", "GAP CONDUCTANCE", "GAP HEAT GENERATION")
_HARMLESS = NOTED | SILENT | {
    "STATIC", "DASHPOT", "SURFACE SECTION", "SUBMODEL", "CONTROLS", "DISTRIBUTION TABLE", "VIEWFACTOR", "DESIGN VARIABLES", "END",
    "NO ANALYSIS", "MODEL CHANGE", "VALUES AT INFINITY", "CONSTRAINT", "OBJECTIVE", "TIMEPOINTS", "CHANGE FRICTION",
    "CHANGE SURFACE BEHAVIOR", "CHANGE MATERIAL", "CHANGE CONTACT TYPE", "DESIGNVARIABLES", "FLUID SECTION",
    "GEOMETRIC TOLERANCES", "ROBUST DESIGN", "CORRELATION LENGTH", "SENSITIVITY", "FEASIBLE DIRECTION",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Choices:
    """How a deck is to be taken: ``density`` by material or set ("all"), ``contact`` refuse, skip or tie, ``skip``
    keywords, ``keep`` the boundary, the steps up to ``preload`` before (0: none)."""

    density: Mapping[str, float] = field(default_factory=dict)
    contact: str = "refuse"
    skip: frozenset[str] = frozenset()
    keep: bool = False
    preload: int = 0


@dataclass(eq=False)
class Flat:
    """The flat deck, and what the model gets from elsewhere: ``average`` elements; ``bodies``, the reference nodes of
    rigid bodies and couplings in the order of the deck; ``turning`` label of a rotation node -> its reference node;
    ``loose`` nodes that only such cards name; what is to be said."""

    deck: FlatDeck
    constraints: Constraints
    average: list[AverageElement] = field(default_factory=list)
    bodies: list[int] = field(default_factory=list)
    turning: dict[int, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def flat_deck(deck: EngineDeck, assembly: Assembly, choices: Choices) -> Flat:
    """The deck that CalculiX reads.

    Raises:
        InputError: what it holds is no linear model, or names what is not there.
    """
    constraints = Constraints(deck, assembly)
    constraints.surfaces.read()
    flat = Flat(deck=FlatDeck(assembly=assembly, deck=deck), constraints=constraints)
    writer = _Writer(deck, assembly, choices, flat)
    for placed, card, rows in writer.cards():
        if card.keyword in ("ORIENTATION", "DISTRIBUTION"):
            flat.deck.name(card.keyword[0].lower() if card.keyword == "ORIENTATION" else "d", placed, card.need("NAME"))
    for placed, card, rows in writer.cards():
        writer.take(placed, card, rows)
    writer.couplings()
    writer.steps()
    writer.materials()
    deck.problems.refuse()
    if flat.problems:
        raise InputError(f"{deck.name}: {'; '.join(dict.fromkeys(flat.problems))}")
    return flat


class _Writer:
    def __init__(self, deck: EngineDeck, assembly: Assembly, choices: Choices, flat: Flat) -> None:
        self.deck, self.assembly, self.choices, self.flat = deck, assembly, choices, flat
        self._constraints = flat.constraints
        self._couplings = count(1)
        top = assembly.top
        self.places = [*assembly.placed.values(), top]

    def cards(self) -> Iterator[tuple[Placed, Card, Rows]]:
        """Every card in every place that it has."""
        for scope, card, rows in self.deck.cards:
            for placed in self.places:
                if any(scope is own for own in placed.contents):
                    yield placed, card, rows

    def take(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Write a card, or say why not."""
        word, flat, out = card.keyword, self.flat, self.flat.deck
        if word in self.choices.skip:
            flat.warnings.append(f"*{word} was left out as --skip asks for [keywords-skipped]")
        elif word in ("ORIENTATION", "DISTRIBUTION"):
            self._orientation(placed, card, rows)
        elif word == "BOUNDARY":
            self._boundary(placed, card, rows)
        elif word == "INITIAL CONDITIONS":
            if card.options.get("TYPE", "").upper() == "TEMPERATURE":
                out.card(placed, card, rows)
        elif word in _CONTACT:
            self._contact(placed, card, rows)
        elif word in _WARNED or (word == "TIE" and "CYCLIC SYMMETRY" in card.options):
            reason = _WARNED.get(word, "the body is the sector alone")
            flat.warnings.append(f"*{word} was left out: {reason} [keywords-skipped]")
        elif word == "EQUATION":
            out.equation(placed, card, rows)
        elif word == "KINEMATIC COUPLING":
            self._kinematic_coupling(placed, card, rows)
        elif word == "DISTRIBUTING COUPLING":
            self._distributing(placed, card, rows)
        elif word == "SOLID SECTION":
            self._section(placed, card, rows)
        elif word in _PLAIN and word not in _IN_STEPS:
            self._plain(placed, card, rows)
        elif word in _HARMLESS:
            self.deck.noted[word] = self.deck.noted.get(word, 0) + 1
        else:
            flat.problems.append(
                f"*{word} is not known here, so stiffness or mass may depend on it; take it out of the deck, or give "
                f"--skip \"{word}\""
            )

    def _plain(self, placed: Placed, card: Card, rows: Rows) -> None:
        if card.keyword == "SPRING":
            numbers = self.assembly.elements_of(placed, card.need("ELSET"))
            start = len(self.flat.deck.labels) - sum(len(ids) for _, ids, _ in self.assembly.others)
            codes = np.concatenate([np.full(len(ids), code) for code, ids, _ in self.assembly.others])
            if len(numbers) and codes[numbers[0] - start] == "SPRINGA" and (len(rows) == 1 or "NONLINEAR" in card.options):
                rows = [[], *rows]
        if card.keyword == "RIGID BODY":
            self._rigid_body(placed, card)
        if card.keyword == "BEAM SECTION" and len(rows) > 1 and not np.array_equal(placed.rotation, np.eye(3)):
            normal = placed.rotation @ np.array((values(rows[1], card) + [0.0] * 3)[:3])
            rows = [rows[0], [numeral(x) for x in normal], *rows[2:]]
        self.flat.deck.card(placed, card, rows)

    def _section(self, placed: Placed, card: Card, rows: Rows) -> None:
        if card.options.get("ELSET") and not len(self.assembly.elements_of(placed, card.options["ELSET"])):
            return
        self.flat.deck.card(placed, card, rows)

    def _rigid_body(self, placed: Placed, card: Card) -> None:
        options = card.options
        if options.get("REF NODE"):
            reference = self.assembly.one_node(placed, options["REF NODE"])
            if options.get("ROT NODE"):
                self.flat.turning[self.assembly.one_node(placed, options["ROT NODE"]) + 1] = reference + 1
            else:
                self.flat.bodies.append(reference + 1)

    def _orientation(self, placed: Placed, card: Card, rows: Rows) -> None:
        turned = not np.array_equal(placed.rotation, np.eye(3))
        if turned and card.keyword == "ORIENTATION" and rows:
            if not card.options.get("SYSTEM", "RECTANGULAR").upper().startswith("RECT"):
                raise InputError(f"{card} is cylindrical in an instance that is turned; give it in the assembly")
            points = np.array(values(rows[0], card)).reshape(-1, 3)
            origin = points[2] if len(points) > 2 else np.zeros(3)
            axes = (points[:2] - origin) @ placed.rotation.T
            rows = [[numeral(x) for x in axes.ravel()], *rows[1:]]
        out = self.flat.deck
        kinds = "d." if rows and card.keyword == "ORIENTATION" and "DEFINITION" in card.options else None
        if rows and card.keyword == "ORIENTATION" and len(rows[0]) == 1:
            kinds = "d."
        if card.keyword == "DISTRIBUTION":
            rows = [row for row in rows if row and row[0]]
        out.body.append((-1, out.lines(placed, card, rows, kinds or CARDS[card.keyword])))

    def _boundary(self, placed: Placed, card: Card, rows: Rows) -> None:
        if self.choices.keep:
            self.flat.deck.body.append((9, self.flat.deck.boundary(placed, card, rows)))
        else:
            self.deck.noted["BOUNDARY"] = 1

    def _contact(self, placed: Placed, card: Card, rows: Rows) -> None:
        contact, flat = self.choices.contact, self.flat
        if card.keyword not in ("CONTACT PAIR", "CONTACT"):
            return
        if contact == "refuse" or (contact == "tie" and card.keyword == "CONTACT"):
            flat.problems.append(f"*{card.keyword} is not linear; give --contact skip or tie")
        elif contact == "skip":
            flat.warnings.append(f"*{card.keyword} was left out, so its surfaces may come apart [contact-skipped]")
        else:
            adjust = card.options.get("ADJUST", "")
            options = {"NAME": f"contact {len(flat.warnings)}"}
            if adjust and adjust.upper() not in ("NO", "YES") and not adjust[0].isalpha():
                options["POSITION TOLERANCE"] = adjust
            flat.deck.card(placed, Card("TIE", options, card.file), [row[:2] for row in rows])
            flat.warnings.append(f"*{card.keyword} was glued as *TIE does [contact-tied]")

    def _kinematic_coupling(self, placed: Placed, card: Card, rows: Rows) -> None:
        for row in rows:
            nodes = self.assembly.nodes_of(placed, row[0])
            self._kinematic(self.assembly.one_node(placed, card.need("REF NODE")), nodes, [row[1:]] if row[1:] else [])

    def _kinematic(self, reference: int, nodes: Ints, rows: Rows) -> None:
        """*COUPLING with *KINEMATIC, whose rotations CalculiX makes of displacements alone."""
        out, name = self.flat.deck, f"KS{next(self._couplings)}"
        own = out.new_set("n", np.setdiff1d(nodes, reference))
        held = sorted({d for row in rows for d in range(int(row[0]), int(row[-1]) + 1) if d < 4} if rows else {1, 2, 3})
        self.flat.bodies.append(reference + 1)
        out.surfaces.append(f"*SURFACE, NAME={name}, TYPE=NODE\n{own}")
        dofs = "\n".join(f"{d}, {d}" for d in held)
        text = f"*COUPLING, REF NODE={reference + 1}, SURFACE={name}, CONSTRAINT NAME={name}\n*KINEMATIC\n{dofs}"
        out.body.append((5, text))

    def couplings(self) -> None:
        """*COUPLING with *KINEMATIC for CalculiX, with *DISTRIBUTING as average elements."""
        for placed in self.places:
            for scope in placed.contents:
                for card, _, kind, kind_rows in scope.constraints:
                    self._coupling(placed, card, kind, [row for row in kind_rows if row])

    def _coupling(self, placed: Placed, card: Card, kind: Card | None, rows: Rows) -> None:
        if kind is None:
            raise InputError(f"{card} has neither *KINEMATIC nor *DISTRIBUTING; expected one")
        if kind.keyword == "DISTRIBUTING":
            self._constraints.coupling(placed, card, kind, rows)
            self.flat.average = self._constraints.found.average
            return
        reference = self.assembly.one_node(placed, card.need("REF NODE"))
        nodes, _ = self._constraints.surface(placed, card.need("SURFACE"), card)
        self._kinematic(reference, nodes, rows)

    def _distributing(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Weights of nodes at the node of an element DCOUP3D."""
        numbers = self.assembly.elements_of(placed, card.need("ELSET"))
        start = len(self.flat.deck.labels) - sum(len(ids) for _, ids, _ in self.assembly.others)
        nodes = np.concatenate([nodes[:, 0] if code == "DCOUP3D" else np.full(len(ids), -1)
                                for code, ids, nodes in self.assembly.others])  # fmt: skip
        reference = int(nodes[numbers[0] - start])
        own = [self.assembly.nodes_of(placed, row[0]) for row in rows]
        weights = [np.full(len(rows_), number(row[1], card) if len(row) > 1 else 1.0)
                   for rows_, row in zip(own, rows, strict=True)]  # fmt: skip
        self.flat.average.append(
            AverageElement(
                name=card.options["ELSET"], reference=reference, nodes=np.concatenate(own),
                weights=np.concatenate(weights),
            )
        )  # fmt: skip

    def steps(self) -> None:
        """The boundary that the first step holds, or the steps of a preload."""
        top, out = self.assembly.top, self.flat.deck
        if self.choices.preload > len(self.deck.steps):
            raise InputError(f"--preload {self.choices.preload} was given; the deck has {len(self.deck.steps)} steps")
        for step in self.deck.steps[: self.choices.preload]:
            lines = ["*STEP" + (", NLGEOM" if "NLGEOM" in step[0][0].options else "")]
            lines += [
                out.lines(top, _plain_card(card), rows, CARDS[card.keyword])
                for card, rows in step[1:]
                if card.keyword in _IN_STEPS
            ]
            out.steps += [*lines, "*END STEP"]
        if self.choices.keep and not self.choices.preload and self.deck.steps:
            for card, rows in self.deck.steps[0]:
                if card.keyword == "BOUNDARY":
                    out.body.append((9, out.boundary(top, card, rows)))

    def materials(self) -> None:
        """Materials that sections name, with their stiffness and density only."""
        out = self.flat.deck
        for (kind, _, key), name in list(out.names.items()):
            if kind != "m":
                continue
            if key not in self.deck.materials:
                self.flat.problems.append(f"a section names the material {key!r}, which is not defined")
                continue
            given = {card.keyword: (card, rows) for card, rows in self.deck.materials[key]}
            if "ELASTIC" not in given:
                self.flat.problems.append(
                    f"material {key} is {', '.join('*' + word for word in given) or 'empty'} only; expected *ELASTIC, or "
                    "give --material young=..,poisson=..,density=..,set=.."
                )
                continue
            lines = [f"*MATERIAL, NAME={name}"]
            words = ["ELASTIC", "DENSITY"] + (["EXPANSION"] if self.choices.preload else [])
            for word in words:
                if word in given:
                    card, rows = given[word]
                    lines.append(out.lines(self.assembly.top, card, [row for row in rows if row], "."))
            if "DENSITY" not in given:
                density = self.choices.density.get(key, self.choices.density.get("all"))
                if density is None:
                    self.flat.problems.append(f"material {key} has no *DENSITY; give it: --density X")
                    continue
                lines.append(f"*DENSITY\n{numeral(density)}")
                self.flat.warnings.append(f"material {key} has the density {density:g} that was given [density-given]")
            out.body.append((-2, "\n".join(lines)))


def _plain_card(card: Card) -> Card:
    """A card of a step without options that belong to its history."""
    kept = {key: value for key, value in card.options.items() if key not in ("AMPLITUDE", "TIME DELAY", "LOAD CASE")}
    return Card(card.keyword, kept, card.file)
