"""A deck, and what can be made of it: the mesh, what own assembly takes, a finite-element model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from morembs.base.units import Units, parse_units
from morembs.fem import FEModel, Mesh
from morembs.importers.decks.join import import_deck, mesh_of
from morembs.importers.decks.tables import DeckTables
from morembs.importers.imported import Imported
from morembs.importers.to_model import model_of


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Deck(DeckTables):
    """All of a deck that a linear model may need, by labels, as its tables (``DeckTables``) say."""

    def imported(self) -> Imported:
        """All that own assembly has of it: solids with their materials, couplings, masses and springs.

        Raises:
            DeckError: all that keeps the deck from becoming a model: an ``InputError`` with ``problems``.
        """
        return import_deck(self)

    def mesh(self) -> Mesh:
        """The mesh of its solids with its sets.

        Raises:
            DeckError: as ``imported``, or couplings, springs and point masses, which a mesh cannot carry.
        """
        return mesh_of(self)

    def to_model(self, units: Units | str | None = None, *, mass_integration: str = "element") -> FEModel:
        """The model of its solids in SI units.

        Args:
            units: of the deck, as ``parse_units`` gives them or takes them ("mm-t-s"); m-kg-s unless given.
            mass_integration: as of ``assemble``.

        Raises:
            DeckError: all that keeps the deck from becoming a model: an ``InputError`` with ``problems``.
        """
        given = parse_units(units) if isinstance(units, str) else units
        return model_of(self.imported(), given, mass_integration=mass_integration)

    def write(self, path: str | Path, format: str) -> tuple[str, ...]:
        """Write a flat deck of all that this one holds; sentences on what differs in it.

        Labels, and names of sets as far as the format has names, are kept; numbers in "nastran" have 11 digits.

        Args:
            format: "calculix", "abaqus" or "nastran".

        Raises:
            InputError: an unknown format, or what it cannot say.
            OutputError: the file cannot be written; an old one is kept.
        """
        # Not at the top: few decks are written.
        from morembs.importers.decks.writers import write_deck

        return write_deck(self, path, format)
