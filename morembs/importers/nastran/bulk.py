"""The cards of a file of Nastran bulk data, sorted by kind."""

from __future__ import annotations

import re
from pathlib import Path

from morembs.base.errors import InputError
from morembs.importers.abaqus.keywords import Card
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.nastran.cards import integer, real, tables
from morembs.importers.nastran.geometry import SOLIDS, Grids, Solids, Systems
from morembs.importers.nastran.names import NOTED, OF_TEMPERATURE, READ, REASONS, RESTRAINTS, SYSTEMS
from morembs.importers.nastran.properties import Rows, pad
from morembs.importers.nastran.tables import Table
from morembs.importers.nastran.text import BulkText

_PARAM = re.compile(r"^[ \t]*PARAM[ \t]*,[ \t]*(\w+)[ \t]*,[ \t]*([^\s,]+)", re.MULTILINE | re.IGNORECASE)
# Matrices of DMIG that case control adds to those of the elements.
_ADDED = re.compile(r"^[ \t]*([KMB]2(?:GG|PP)|K42GG|A2GG|TFL)[ \t]*=[ \t]*(\S+)", re.MULTILINE | re.IGNORECASE)


class Bulk:
    """Grids, solids, systems and the ``rows`` of cards that are read; unsupported cards are ``problems``.

    ``lines`` has the line of each row.
    """

    def __init__(self, path: Path, *, outside: bool, options: DeckOptions | None = None) -> None:
        self.file, self.options = path.name, options or DeckOptions()
        self.problems = Problems(path.name, self.options.flags)
        self.skipped: dict[str, int] = {}
        self.grids, self.solids, self.systems = Grids(path.name), Solids(path.name), Systems(path.name)
        self.rows: dict[str, Rows] = {name: [] for name in READ}
        self.lines: dict[str, list[int]] = {name: [] for name in READ}
        # The file and line of the first card of each name.
        self._first: dict[str, tuple[str, int]] = {}
        self.noted: dict[str, int] = {}
        refused: dict[str, list[Table]] = {}
        self.text = BulkText(path, outside=outside)
        for table in tables(self.text, {"GRID", *SOLIDS, *self.rows}):
            self._take(table, refused)
        self._refuse(refused)
        if len(self.rows["GRDSET"]) > 1:
            raise InputError(f"{path.name} has {len(self.rows['GRDSET'])} cards GRDSET; expected one")
        self.grids.sort(self.rows["GRDSET"][0] if self.rows["GRDSET"] else [])
        for name in SYSTEMS:
            for row in self.rows[name]:
                self.systems.add(name, pad(row, 4))
        self.grids.place(self.systems)

    def _take(self, table: Table, refused: dict[str, list[Table]]) -> None:
        name, count = table.name, len(table)
        self._first.setdefault(name, (table.file, int(table.lines.min()) if count else 0))
        if name not in ("GRID", *SOLIDS) and self.options.skips(name):
            self.skipped[name] = self.skipped.get(name, 0) + count
        elif name == "GRID":
            self.grids.add(table)
        elif name in SOLIDS:
            self.solids.add(table)
        elif name in self.rows:
            self.rows[name] += table.rows()
            self.lines[name] += table.lines.tolist()
            if name in RESTRAINTS:
                self.noted[name] = self.noted.get(name, 0) + count
        else:
            # Matrices that case control does not ask for are data only.
            idle = name == "DMIG" and self.text.head.strip() and not _ADDED.search(self.text.head)
            if idle or name in NOTED or name in OF_TEMPERATURE:
                self.noted[name] = self.noted.get(name, 0) + count
            else:
                refused.setdefault(name, []).append(table)

    def _refuse(self, refused: dict[str, list[Table]]) -> None:
        """A problem for each name of cards that cannot be carried.

        Raises:
            InputError: case control stands among them.
        """
        if "CEND" in refused:
            raise InputError(
                f"{self.file} has CEND and no BEGIN BULK behind it; put that line before the first card",
                kind="file",
                keyword="BEGIN BULK",
            )
        # Lines of a file that is no deck have names with other characters; they are not shown.
        named = {name: card_tables for name, card_tables in refused.items() if name.isalnum()}
        for name, card_tables in named.items():
            self.problems.add(self.refusal(name, sum(map(len, card_tables))))
        odd = [table for name, card_tables in refused.items() if name not in named for table in card_tables]
        if odd:
            line = int(odd[0].lines.min())
            what = (
                f"{self.file} has {sum(map(len, odd))} lines that begin no card (first: line {line}); expected Nastran "
                "bulk data"
            )
            self.problems.add(Problem(what=what, file=self.file, line=line, keyword="(no name)"))

    def refusal(self, name: str, count: int) -> Problem:
        """The problem that ``count`` cards of a name cannot be carried."""
        file, line = self._first[name]
        reason = f": {REASONS[name]}" if name in REASONS else ""
        what = (
            f"{file}, line {line}: {count} {name} cannot be read{reason}; --skip {name} leaves them out if the "
            "model is right without them"
        )
        return Problem(what=what, file=file, line=line, keyword=name, flags=(f"--skip {name}",))

    def cards(self, name: str) -> list[tuple[list[str], Card]]:
        """Fields of the cards of a name that is read, and where each stands."""
        return [
            (row, Card(name, {}, self.file, line)) for row, line in zip(self.rows[name], self.lines[name], strict=True)
        ]

    def choose(self, word: str, cure: str = "") -> tuple[set[int], bool]:
        """Numbers of the sets that case control asks for by a ``word`` (SPC, MPC), with the members of sums (SPCADD,
        MPCADD), and whether there is a case control.

        Raises:
            InputError: subcases that ask for different ones.
        """
        asked = {int(n) for n in re.findall(rf"(?im)^[ \t]*{word}[ \t]*=[ \t]*(\d+)", self.text.head)}
        if len(asked) > 1:
            raise InputError(
                f"{self.file}: subcases ask for the {word} sets {sorted(asked)}; expected one of them{cure}",
                kind="conflict",
            )
        for row in self.rows[f"{word}ADD"]:
            if row and integer(row[0], f"{self.file}: {word}ADD") in asked:
                asked |= {integer(text, f"{self.file}: {word}ADD") for text in row[1:] if text}
        return asked, bool(self.text.head.strip())

    def mass_scale(self) -> float:
        """PARAM WTMASS."""
        value = real(self.parameter("WTMASS", "1."), f"{self.file}: PARAM WTMASS")
        if not value > 0:
            raise InputError(f"{self.file}: PARAM WTMASS = {value:g} was given; expected a positive number")
        return value

    def parameter(self, name: str, default: str) -> str:
        """Value of a PARAM, in the bulk data or above them.

        Raises:
            InputError: it is given twice with different values.
        """
        cards = [*self.rows["PARAM"], *([key.upper(), text] for key, text in _PARAM.findall(self.text.head))]
        given = {pad(row, 2)[1].upper() for row in cards if row and row[0].upper() == name}
        if len(given) > 1:
            raise InputError(f"{self.file} gives PARAM {name} as {' and as '.join(sorted(given))}; expected one value")
        return given.pop() if given else default
