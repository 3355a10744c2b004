"""From the cards of a deck to the flat deck for CalculiX, and what stays outside of it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Bools
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.cards.deck import CARDS, FlatText
from morembs.importers.abaqus.cards.sections import SECTIONS, Sections
from morembs.importers.abaqus.cards.text import node_lines
from morembs.importers.abaqus.cards.ties import Flat, Ties
from morembs.importers.abaqus.constraints import Constraints, refuse_sector
from morembs.importers.abaqus.data import fields
from morembs.importers.abaqus.deck import PLAIN, SOLIDS, Contents, Rows, values
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.left_out import CUT, LOCKED, PRETENSION, notes_of
from morembs.importers.abaqus.names import Placed
from morembs.importers.abaqus.points import point_value
from morembs.importers.abaqus.reader import ACTING, KEPT
from morembs.importers.abaqus.supports import starts_anew
from morembs.importers.abaqus.ties import is_sector
from morembs.importers.abaqus.whole import skipped_warnings
from morembs.importers.abaqus.words import of_kind
from morembs.importers.decks.flat import Choices, FlatDeck, refuse_no_elements
from morembs.importers.decks.formulations import deck_warnings
from morembs.importers.decks.tables import DeckTables
from morembs.importers.decks.writers.calculix_mesh import numeral
from morembs.importers.imported import PointMass

# Keywords outside of steps that the flat deck has, or that go into the model in another way.
WRITTEN = KEPT - {"DASHPOT"}


def flat_deck(deck: Contents, tables: DeckTables, assembly: Assembly, choices: Choices) -> FlatDeck:
    """The deck that CalculiX reads; ``tables`` are its mesh and sets.

    Raises:
        InputError: the deck is no linear model, or names objects that it does not define.
    """
    if not assembly.solids and not any(nodes.shape[1] for *_, nodes in assembly.others):
        refuse_no_elements(deck.problems)
    constraints = Constraints(deck, assembly)
    constraints.surfaces.read()
    flat = Flat(deck=FlatText(assembly=assembly, deck=deck), constraints=constraints)
    writer = _Writer(deck, tables, assembly, choices, flat)
    for placed, card, _ in writer.cards:
        if card.keyword in ("ORIENTATION", "DISTRIBUTION"):
            flat.deck.name(card.keyword[0].lower() if card.keyword == "ORIENTATION" else "d", placed, card.need("NAME"))
    writer.sections.read(writer.cards)
    for placed, card, rows in writer.cards:
        with deck.problems.collected(card, (f"--skip {card.keyword}",)):
            writer.take(placed, card, rows)
    writer.ties.couplings(writer.places)
    own = "own assembly with --dialect abaqus (of its elements too)"
    constraints.refuse_references(flat.deck.equated, cure=own)
    writer.steps()
    held = (("BOUNDARY", int(node), True) for node in np.flatnonzero(flat.deck.held.any(axis=1)))
    constraints.refuse_references(held, cure="[[interface]] with nodes = 'coupling:NAME'")
    writer.cuts()
    writer.sections.complete()
    deck.problems.refuse()
    return _whole(deck, assembly, choices, flat)


def _whole(deck: Contents, assembly: Assembly, choices: Choices, flat: Flat) -> FlatDeck:
    in_solids, in_elements = _find_used(assembly)
    out = flat.deck
    return FlatDeck(
        name=deck.name,
        ids=assembly.ids,
        xyz=assembly.xyz,
        elements=out.labels,
        nodes="\n".join(node_lines(assembly)),
        cards=out.text(),
        steps="\n".join(out.steps),
        in_solids=in_solids,
        in_elements=in_elements,
        expands=any(code[0] in "SMBT" and not code.startswith("SPRING") for code, *_ in assembly.others),
        held=out.held,
        turned=frozenset(flat.turned),
        bodies=tuple(flat.bodies),
        turning=flat.turning,
        followers=frozenset(out.followers),
        average=tuple(flat.average),
        masses=tuple(flat.masses),
        surfaces={name: own.nodes for name, own in flat.constraints.surfaces.named.items()},
        notes=(*flat.notes, *_notes(deck, choices)),
        warnings=(*flat.warnings, *deck.warnings, *out.reversed, *_warnings(deck, flat)),
    )


def _find_used(assembly: Assembly) -> tuple[Bools, Bools]:
    """Which nodes are of solids, and which of elements that have stiffness."""
    used = assembly.in_solids.copy()
    for _, _, nodes in assembly.others:
        used[nodes] = True
    for element in assembly.discrete:
        used[element.nodes] |= element.code not in ("DCOUP3D", "ROTARYI", "MASS")
    return assembly.in_solids, used


def _notes(deck: Contents, choices: Choices) -> list[str]:
    """What was left out, a sentence each."""
    notes = ["The matrices are those of CalculiX."]
    in_steps = [card.keyword for step in deck.steps[choices.preload :] for card, _ in step]
    left_out = of_kind("load") if choices.keep else of_kind("load", "support")
    noted = [word for word in deck.noted if word not in WRITTEN or (word == "BOUNDARY" and not choices.keep)]
    notes += notes_of(dict.fromkeys([*noted, *(word for word in in_steps if word in left_out)]))
    if deck.steps:
        held = " but for what the first holds" if choices.keep and not choices.preload else ""
        held = f" beyond step {choices.preload}" if choices.preload else held
        notes.append(f"Steps are not applied{held}.")
    return notes


def _warnings(deck: Contents, flat: Flat) -> Iterator[str]:
    """In what elements differ from those of the deck, a sentence each."""
    yield from skipped_warnings(deck)
    hybrid = {code: count for code, count in deck.counts.items() if code in SOLIDS and "H" in code}
    yield from deck_warnings(hybrid, "calculix", guessed=False)
    if deck.dialects == {"abaqus"}:
        yield (
            "the deck is one of Abaqus, and CalculiX has other formulations and consistent masses: its frequencies "
            "are those of CalculiX [formulation-differs]"
        )
    plain = {(code, PLAIN[code]): count for code, count in deck.counts.items() if code in PLAIN and count}
    for (code, taken), count in {**plain, **flat.replaced}.items():
        yield f"{count} elements {code} are assembled as {taken} [hybrid-as-plain]"


class _Writer:
    def __init__(self, deck: Contents, tables: DeckTables, assembly: Assembly, choices: Choices, flat: Flat) -> None:
        self.deck, self.assembly, self.choices, self.flat = deck, assembly, choices, flat
        self.options, self.ties = deck.options, Ties(assembly, flat)
        top = assembly.top
        self.places = [*assembly.placed.values(), top]
        self._expanded = {node for _, _, nodes in assembly.others for node in nodes.ravel().tolist()}
        self.sections = Sections(deck, tables, assembly, flat, choices.materials, bool(choices.preload))
        self.cards = list(self._place_cards())

    def _place_cards(self) -> Iterator[tuple[Placed, Card, Rows]]:
        """Every card in every place that it has."""
        for scope, card, data in self.deck.cards:
            rows = [row for row in fields(data) if row]
            for placed in self.places:
                if any(scope is own for own in placed.contents):
                    yield placed, card, rows

    def take(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Write a card, or say why not."""
        word, out = card.keyword, self.flat.deck
        if word == PRETENSION and (self.options.pretension == "locked" or self.options.skips(word)):
            self.flat.notes.append(LOCKED.format(f" of node {card.options.get('NODE', '')}"))
        elif word in ("ORIENTATION", "DISTRIBUTION"):
            self._orientation(placed, card, rows)
        elif word == "BOUNDARY":
            self._boundary(placed, card, rows)
        elif word == "INITIAL CONDITIONS":
            # They choose a row of a table and are the begin of a preload; nothing else depends on them.
            if card.options.get("TYPE", "").upper() == "TEMPERATURE" and (self.choices.preload or self._tables()):
                out.card(placed, card, rows)
        elif word == "CONTACT PAIR":
            if self.options.contact == "tie":
                self.ties.glue(placed, card, rows)
        elif is_sector(card):
            refuse_sector(card, self.deck)
        elif word in ("MASS", "ROTARY INERTIA"):
            self._masses(placed, card, rows)
        elif word == "EQUATION":
            out.equation(placed, card, rows)
        elif word == "RIGID BODY":
            self.ties.rigid_body(placed, card)
        elif word == "MPC":
            self.ties.mpc(placed, card, rows)
        elif word == "KINEMATIC COUPLING":
            self.ties.kinematic_coupling(placed, card, rows)
        elif word == "DISTRIBUTING COUPLING":
            self.ties.distribute(placed, card, rows)
        elif word in SECTIONS:
            section = self.sections.write(placed, card, rows)
            if section is not None:
                self._plain(placed, *section)
        elif word == "DASHPOT":
            self.deck.leave_out(card)
        else:
            self._plain(placed, card, rows)

    def _tables(self) -> bool:
        """True if constants of a material take more than a line, so that they may depend on temperature."""
        return any(
            len([row for row in rows if row]) > 1
            for cards in self.deck.materials.values()
            for card, rows in cards
            if card.keyword in ("ELASTIC", "DENSITY")
        )

    def _plain(self, placed: Placed, card: Card, rows: Rows) -> None:
        if card.keyword == "SPRING":
            numbers = set(self.assembly.elements_of(placed, card.need("ELSET")).tolist())
            axial = any(element.code == "SPRINGA" and element.number in numbers for element in self.assembly.discrete)
            if axial and len(rows) > 1 and not any("." in text for text in rows[0]):
                # The line of directions, which one along its axis has none of.
                rows = rows[1:]
            # CalculiX knows a stiffness by its decimal point.
            first = [] if axial else rows[:1]
            rows = [*first, *([numeral(value) for value in values(row, card)] for row in rows[len(first) :])]
        if card.keyword == "BEAM SECTION" and len(rows) > 1 and not np.array_equal(placed.rotation, np.eye(3)):
            normal = placed.rotation @ np.array((values(rows[1], card) + [0.0] * 3)[:3])
            rows = [rows[0], [numeral(x) for x in normal], *rows[2:]]
        is_round = card.keyword == "BEAM SECTION" and card.options.get("SECTION", "").upper().startswith("CIRC")
        if is_round and self.deck.dialects == {"abaqus"} and rows:
            # Abaqus has the radius, CalculiX the axes of an ellipse.
            rows = [[numeral(2 * value) for value in values(rows[0], card)], *rows[1:]]
        if card.keyword == PRETENSION:
            self.flat.cuts.append(self.assembly.one_node(placed, card.need("NODE")))
        if card.keyword == "TRANSFORM":
            self.flat.turned |= set(self.assembly.nodes_of(placed, card.need("NSET")).tolist())
        self.flat.deck.card(placed, card, rows)

    def _masses(self, placed: Placed, card: Card, rows: Rows) -> None:
        """Point masses, which are added to the matrices: CalculiX loses those on nodes without stiffness, and has no
        rotary inertia. Only those on shells and beams are its own."""
        numbers = set(self.assembly.elements_of(placed, card.need("ELSET")).tolist())
        value, left = point_value(placed, card, rows), []
        for element in self.assembly.discrete:
            if element.number not in numbers:
                continue
            if card.keyword == "MASS" and element.nodes[0] in self._expanded:
                left.append(element.number)
                continue
            name = f"{card.options['ELSET']}:{element.label}"
            if card.keyword == "MASS":
                self.flat.masses.append(PointMass(name=name, node=element.nodes[0], mass=float(value[0, 0])))
            else:
                self.flat.masses.append(PointMass(name=name, node=element.nodes[0], mass=0.0, inertia=value))
        if left:
            out = self.flat.deck
            out.masses |= set(left)
            own = out.new_set("e", np.array(left))
            out.body.append((0, f"*MASS, ELSET={own}\n{numeral(value[0, 0])}"))

    def _orientation(self, placed: Placed, card: Card, rows: Rows) -> None:
        turned = not np.array_equal(placed.rotation, np.eye(3))
        if turned and card.keyword == "ORIENTATION" and rows:
            if not card.options.get("SYSTEM", "RECTANGULAR").upper().startswith("RECT"):
                raise InputError(
                    f"{card} is cylindrical in an instance that is turned; give it in the assembly", kind="unsupported"
                )
            points = np.array(values(rows[0], card)).reshape(-1, 3)
            origin = points[2] if len(points) > 2 else np.zeros(3)
            axes = (points[:2] - origin) @ placed.rotation.T
            rows = [[numeral(x) for x in axes.ravel()], *rows[1:]]
        out = self.flat.deck
        kinds = CARDS[card.keyword]
        if card.keyword == "ORIENTATION" and rows and rows[0][0][:1].isalpha():
            kinds = "d."
        out.body.append((-1, out.lines(placed, card, rows, kinds)))

    def _boundary(self, placed: Placed, card: Card, rows: Rows) -> None:
        # Steps of a preload let go of it themselves.
        first = self.deck.steps[0] if self.deck.steps and not self.choices.preload else []
        if self.choices.keep and not starts_anew(first):
            self.flat.deck.body.append((9, self.flat.deck.boundary(placed, card, rows)))

    def steps(self) -> None:
        """The boundary that the first step holds, or the steps of a preload."""
        top, out = self.assembly.top, self.flat.deck
        if self.choices.preload > len(self.deck.steps):
            raise InputError(
                f"--preload {self.choices.preload} was given; the deck has {len(self.deck.steps)} steps",
                keyword="preload",
            )
        for step in self.deck.steps[: self.choices.preload]:
            lines = ["*STEP" + (", NLGEOM" if "NLGEOM" in step[0][0].options else "")]
            for card, data in step[1:]:
                rows = fields(data)
                if card.keyword == "BOUNDARY":
                    # Also where it moves its nodes: motions after it are small ones about what it holds.
                    out.boundary(top, card, rows)
                if card.keyword in ACTING:
                    lines.append(out.lines(top, _plain_card(card), rows, CARDS[card.keyword]))
            out.steps += [*lines, "*END STEP"]
        if self.choices.keep and not self.choices.preload and self.deck.steps:
            for card, data in self.deck.steps[0]:
                if card.keyword == "BOUNDARY":
                    out.body.append((9, out.boundary(top, card, fields(data))))

    def cuts(self) -> None:
        """Say of each pre-tension section whether it is cut, or locked by a boundary on its node."""
        for node in self.flat.cuts:
            note = LOCKED if self.flat.deck.held[node, 0] else CUT
            self.flat.notes.append(note.format(f" of node {self.assembly.ids[node]}"))


def _plain_card(card: Card) -> Card:
    """A card of a step without options that belong to its history."""
    kept = {key: value for key, value in card.options.items() if key not in ("AMPLITUDE", "TIME DELAY", "LOAD CASE")}
    return Card(card.keyword, kept, card.file)
