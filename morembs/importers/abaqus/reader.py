"""Puts the keywords of an input deck where they belong: parts, instances, the assembly, materials."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.importers.abaqus.blocks import line_records, other_records, set_parts, solid_records
from morembs.importers.abaqus.data import fields, node_rows
from morembs.importers.abaqus.deck import (
    DISCRETE,
    KINDS,
    PLAIN,
    SOLIDS,
    STRUCTURES,
    Contents,
    Instance,
    Members,
    Rows,
    Scope,
    join,
    width_of,
)
from morembs.importers.abaqus.generate import GENERATING, generate
from morembs.importers.abaqus.keywords import Card, cards
from morembs.importers.abaqus.left_out import PRETENSION, refusal_of
from morembs.importers.abaqus.words import (
    CONSTRAINTS,
    CONTACT,
    GAPS,
    LEFT_OUT,
    MATERIAL,
    PROPERTIES,
    SECTIONS,
    STRUCTURAL,
)
from morembs.importers.decks.algebra import points_of
from morembs.importers.decks.expansion.sections import SOLIDS as EXPANDED
from morembs.importers.decks.formulations import dialect_of, dialects_of_comments
from morembs.importers.decks.includes import open_text
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.tolerances import TOL

# Keywords of steps that load a body or hold it, and those outside of steps that programs read as they stand.
ACTING = ("STATIC", "BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE")
KEPT = {
    *SECTIONS,
    *("SOLID SECTION", "SPRING", "DASHPOT", "MASS", "ROTARY INERTIA", "GAP", "NODAL THICKNESS", "NORMAL"),
    *("TIE", "RIGID BODY", "MPC", "EQUATION", "KINEMATIC COUPLING", "DISTRIBUTING COUPLING", "CONTACT PAIR"),
    *(PRETENSION, "ORIENTATION", "DISTRIBUTION", "TRANSFORM", "INITIAL CONDITIONS", "BOUNDARY"),
}
_OF_ENGINE = re.compile(r"S[3468]|B3[123]|M3D|T3D")
# Elements that have neither stiffness nor mass.
_EMPTY = ("SFM3D",)


def read_deck(
    path: Path,
    *,
    outside: bool = False,
    dialect: str = "auto",
    options: DeckOptions | None = None,
    is_for_calculix: bool = False,
) -> Contents:
    """The deck of a file; ``outside`` allows to include files from beyond its folder.

    ``dialect`` "auto" looks at keywords and at comments of the head; where they do not tell one program, a deck without
    parts is read as one of CalculiX. What a model cannot carry is among its ``problems``; where it
    ``is_for_calculix``, keywords that CalculiX does not have.

    Raises:
        InputError: the text is not an input deck.
    """
    options = options or DeckOptions()
    deck = Contents(path.name, options, Problems(path.name, options.flags))
    warnings: list[str] = []
    with deck.problems.ending():
        reader = DeckReader(deck, is_for_calculix=is_for_calculix)
        for card, pieces in cards(path, outside=outside, warnings=warnings):
            reader.take(card, pieces)
        deck.warnings += warnings if reader.open != ["STEP"] else []
        if reader.open == ["STEP"]:
            # Nothing of a step is applied, so its end does not matter.
            reader.open.clear()
            deck.noted["END STEP"] = 0
        if reader.open:
            raise InputError(
                f"{path.name} ends inside *{reader.open[-1]}: the part, assembly, instance or step is not ended "
                f"(*END {reader.open[-1]} is missing); the file may be cut off",
                kind="file",
                keyword=path.name,
            )
    if not is_for_calculix:
        _others(deck)
    with open_text(path) as file:
        deck.dialects |= dialects_of_comments(file.read(TOL.head_bytes))
    dialects = deck.dialects if dialect == "auto" else {dialect}
    deck.guessed = len(dialects) != 1
    deck.dialect = ("abaqus" if deck.parts else "calculix") if deck.guessed else next(iter(dialects))
    return deck


def _others(deck: Contents) -> None:
    """A problem where there are elements that a model cannot carry; those to be skipped are counted."""
    known = {*SOLIDS, *DISCRETE}
    expanded = {code for code in deck.counts if PLAIN.get(code, code) in EXPANDED and not deck.options.skips(code)}
    unknown = {code: n for code, n in deck.counts.items() if code not in known | expanded and n}
    for code in list(unknown):
        if code.startswith(_EMPTY):
            deck.noted[f"ELEMENT, TYPE={code}"] = unknown.pop(code)
        elif deck.options.skips(code) or (code in GAPS and deck.options.contact == "skip"):
            deck.skipped[f"elements {code}"] = unknown.pop(code)
    if not unknown:
        return
    listed = ", ".join(f"{n} of the type {code!r}" for code, n in unknown.items())
    gaps = set(unknown) <= GAPS
    flags = ("--contact skip",) if gaps else tuple(f"--skip {code}" for code in unknown)
    flag = "--contact skip" if gaps else f"--skip {','.join(unknown)}"
    cure = f"; if the model is right without these elements, leave them out with {flag}"
    if not any(count for code, count in deck.counts.items() if code in expanded or code in SOLIDS):
        # Without them nothing would be left.
        flags, cure = (), ""
    deck.unsupported = Problem(
        what=f"{deck.name} has elements that are not supported: {listed}; expected solids ({', '.join(KINDS)} and "
        f"their variants), {', '.join([*EXPANDED, *DISCRETE])}{cure}"
        f"{'; --engine calculix may assemble them' if all(map(_OF_ENGINE.match, unknown)) else ''}",
        file=deck.name,
        keyword="ELEMENT",
        flags=flags,
    )
    deck.problems.add(deck.unsupported)
    deck.unknown = frozenset(unknown)


class DeckReader:
    """Puts each card where it belongs; ``is_for_calculix``: what that takes is no problem."""

    def __init__(self, deck: Contents, *, is_for_calculix: bool) -> None:
        self.deck, self.is_for_calculix = deck, is_for_calculix
        self.open: list[str] = []
        self.scope = deck.top
        self.material: list[tuple[Card, Rows]] | None = None

    def take(self, card: Card, pieces: Iterator[bytes]) -> None:
        """One card with its data; what keeps it from being read is a problem of the deck, unless nothing makes sense
        after it."""
        word, deck = card.keyword, self.deck
        dialect = dialect_of(word, card.options)
        deck.dialects |= {dialect} if dialect else set()
        if word == "STEP":
            # CalculiX takes steps that are not ended, and ends of steps that were not begun.
            self.open = [scope for scope in self.open if scope != "STEP"]
            self._begin(word, card)
            deck.steps.append([])
        if self.open and self.open[-1] == "STEP":
            if word == "END STEP":
                self.open.pop()
            deck.in_steps[word] = deck.in_steps.get(word, 0) + 1
            deck.steps[-1].append((card, b"".join(pieces) if word in ACTING else b""))
            return
        if word in KEPT and (word == PRETENSION or not deck.options.skips(word)):
            data = b"".join(pieces)
            pieces = iter([data])
            deck.cards.append((self.scope, card, data))
        if word == "END STEP":
            return
        if word in STRUCTURAL:
            self._structure(card, pieces)
        elif word in ("NODE", "ELEMENT"):
            {"NODE": self._nodes, "ELEMENT": self._elements}[word](card, pieces)
        elif deck.options.skips(word):
            deck.skip(card)
        elif word in LEFT_OUT:
            deck.leave_out(card)
            if word in SECTIONS:
                self.scope.sections.append((card, fields(b"".join(pieces))))
        else:
            with deck.problems.collected(card):
                self._rest(card, pieces)

    def _rest(self, card: Card, pieces: Iterator[bytes]) -> None:
        word = card.keyword
        if word in MATERIAL and self.material is not None:
            self.material.append((card, fields(b"".join(pieces))))
        elif word in ("NSET", "ELSET"):
            self._set(card, pieces)
        elif word in GENERATING:
            for code, count in generate(self.scope, card, fields(b"".join(pieces))).items():
                self.deck.counts[code] += count
        elif word == "MATERIAL":
            self._material(card)
            _refuse_data(card, pieces)
        else:
            self._small(card, fields(b"".join(pieces)))

    def _begin(self, word: str, card: Card) -> None:
        allowed = {"PART": [], "ASSEMBLY": [], "INSTANCE": ["ASSEMBLY"], "STEP": []}[word]
        if self.open != allowed:
            where = f"inside *{self.open[-1]}" if self.open else "outside of an *ASSEMBLY"
            raise InputError(
                f"{card} stands {where}; check that each part, instance and step is ended", kind="unsupported"
            )
        self.open.append(word)

    def _structure(self, card: Card, pieces: Iterator[bytes]) -> None:
        word, deck = card.keyword, self.deck
        if word != "INSTANCE":
            _refuse_data(card, pieces)
        if word.startswith("END "):
            if not self.open or self.open[-1] != word[4:]:
                raise InputError(
                    f"{card} has no keyword before it that it ends; check the order of the keywords", kind="unsupported"
                )
            self.open.pop()
            self.scope = deck.top
            return
        self._begin(word, card)
        if word == "ASSEMBLY":
            return
        name = card.need("NAME")
        known = deck.parts if word == "PART" else deck.instances
        if name.upper() in known:
            raise InputError(f"{card}: the name {name!r} is given twice; expected each name once", kind="conflict")
        self.scope = Scope(name)
        if word == "PART":
            deck.parts[name.upper()] = self.scope
        else:
            part = card.options.get("PART", "")
            if part and part.upper() not in deck.parts:
                raise InputError(
                    f"{card}: the instance {name!r} is of the part {part!r}, which is not defined", kind="unknown"
                )
            deck.instances[name.upper()] = Instance(self.scope, part.upper(), card, fields(b"".join(pieces)))

    def _nodes(self, card: Card, pieces: Iterator[bytes]) -> None:
        system = card.options.get("SYSTEM", "R").upper()
        if system not in ("R", "C"):
            raise InputError(f"{card} uses SYSTEM={system}; expected R (rectangular) or C (cylindrical)")
        for piece in pieces:
            ids, xyz = node_rows(piece, card) if piece else (np.empty(0, dtype=np.int64), np.empty((0, 3)))
            if system == "C":
                xyz = points_of("C", xyz)
            self.scope.node_ids.append(ids)
            self.scope.xyz.append(xyz)
            join(self.scope.node_sets, card.options.get("NSET", ""), Members(ids, [], [], ""))

    def _elements(self, card: Card, pieces: Iterator[bytes]) -> None:
        code = card.options.get("TYPE", "").upper()
        counts, name = self.deck.counts, card.options.get("ELSET", "")
        counts.setdefault(code or "(none)", 0)
        if code in SOLIDS:
            for rows in solid_records(card, pieces, code):
                counts[code] += len(rows)
                self.scope.elements.setdefault(code, []).append(rows)
                join(self.scope.element_sets, name, Members(rows[:, 0].copy(), [], [], ""))
            return
        plain = PLAIN.get(code, code)
        if plain in STRUCTURES and not self._skips(code):
            rows = line_records(card, pieces, code, width_of(plain))
            counts[code] += len(rows)
            self.scope.others.append((plain, rows))
            join(self.scope.element_sets, name, Members(rows[:, 0].copy(), [], [], ""))
            return
        others = []
        for given, nodes in other_records(card, pieces, code):
            counts[code or "(none)"] += 1
            if code in DISCRETE:
                self.scope.discrete.append((given, nodes, code))
            elif given:
                others.append(given)
            if given:
                join(self.scope.element_sets, name, Members(np.array([given]), [], [], ""))
        if others:
            self.scope.others.append((code, np.array(others, dtype=np.int64)[:, None]))

    def _skips(self, code: str) -> bool:
        """True if elements of a type are left out as asked."""
        options = self.deck.options
        return options.skips(code) or (code in GAPS and options.contact == "skip" and not self.is_for_calculix)

    def _set(self, card: Card, pieces: Iterator[bytes]) -> None:
        sets = self.scope.node_sets if card.keyword == "NSET" else self.scope.element_sets
        name, instance = card.need(card.keyword), card.options.get("INSTANCE", "")
        for part in set_parts(card, pieces, instance):
            join(sets, name, part)

    def _material(self, card: Card) -> None:
        name = card.need("NAME")
        if name.upper() in self.deck.materials:
            raise InputError(f"{card}: the name {name!r} is given twice; expected each material once", kind="conflict")
        self.material = self.deck.materials.setdefault(name.upper(), [])

    def _small(self, card: Card, rows: Rows) -> None:
        word, scope = card.keyword, self.scope
        if word == "SURFACE":
            scope.surfaces.append((card, rows))
        elif word in PROPERTIES:
            if word == "SOLID SECTION" and not self.is_for_calculix and len([row for row in rows if row]) > 1:
                raise InputError(f"{card} has several data lines; expected one, its thickness, or none")
            scope.properties.append((card, rows))
        elif word == "ORIENTATION":
            name = card.need("NAME").upper()
            if name in scope.orientations:
                raise InputError(
                    f"{card}: the name {name!r} is given twice; expected each orientation once", kind="conflict"
                )
            scope.orientations[name] = (card, rows)
        elif word == "TRANSFORM":
            scope.transforms.append((card, rows))
        elif word in CONTACT:
            self._contact(card, rows)
        elif word in CONSTRAINTS or (
            word == PRETENSION and (self.is_for_calculix or self.deck.options.pretension != "auto")
        ):
            scope.constraints.append((card, rows, None, []))
        elif word in ("KINEMATIC", "DISTRIBUTING"):
            if not scope.constraints or scope.constraints[-1][0].keyword != "COUPLING" or scope.constraints[-1][2]:
                raise InputError(f"{card} has no *COUPLING before it; expected one for each", kind="missing")
            scope.constraints[-1] = (*scope.constraints[-1][:2], card, rows)
        else:
            what, flag = refusal_of(card), "--pretension locked" if word == PRETENSION else f"--skip {word}"
            self.deck.problems.add(Problem(what=what, file=card.file, line=card.line, keyword=word, flags=(flag,)))

    def _contact(self, card: Card, rows: Rows) -> None:
        """Contact is refused, left out, or glued."""
        deck, contact = self.deck, self.deck.options.contact
        if contact == "skip":
            deck.skip(card)
        elif contact == "tie" and (not self.is_for_calculix or card.keyword == "CONTACT PAIR"):
            self.scope.constraints.append((card, rows, None, []))
        else:
            own = " (in own assembly)" if self.is_for_calculix and card.keyword == "CONTACT" else ""
            cure = f"--contact skip leaves it out; --contact tie glues it{own}"
            what = f"{card} cannot be read: contact is not linear; {cure}"
            deck.problems.add(
                Problem(what=what, file=card.file, line=card.line, keyword=card.keyword, flags=("--contact skip",))
            )


def _refuse_data(card: Card, pieces: Iterator[bytes]) -> None:
    if any(piece.strip() for piece in pieces):
        raise InputError(
            f"{card} is followed by data lines, and takes none; a keyword above them is missing", kind="missing"
        )
