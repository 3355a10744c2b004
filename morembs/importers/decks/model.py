"""A deck, and what can be made of it: the mesh, what own assembly takes, a finite-element model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from morembs.base.arguments import check_value
from morembs.base.units import Units, parse_units
from morembs.fem import FEModel, Mesh
from morembs.fem.material import Material
from morembs.importers.advice import PYTHON, advising
from morembs.importers.decks.join import import_deck, mesh_of
from morembs.importers.decks.materials import complete
from morembs.importers.decks.tables import DeckTables
from morembs.importers.imported import Imported
from morembs.importers.to_model import model_of


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Deck(DeckTables):
    """All of a deck that a linear model may need, by labels, as its tables (``DeckTables``) say.

    >>> from morembs.importers.decks.tables import Elements, Section
    >>> solids = Elements(code="C3D8", kind="solid", shape="hex8", ids=np.arange(1, 5), nodes=nodes.ids[cells])
    >>> section = Section(set="BAR", stiffness=steel.stiffness, density=steel.density)
    >>> deck = Deck(name="bar.inp", program="Abaqus", ids=nodes.ids, xyz=nodes.xyz, elements=(solids,),
    ...             element_sets={"BAR": np.array([[1, 4]])}, sections=(section,))
    >>> deck
    Deck: file bar.inp; program Abaqus; nodes 20; elements 4 C3D8; sections 1; problems none
    >>> deck.to_model().K.shape
    (60, 60)
    """

    @advising(PYTHON)
    def with_materials(self, materials: Sequence[Material] = ()) -> Self:
        """The deck with data of the user in its sections: ``materials``, and densities of the options of its reading.

        Args:
            materials: of element sets that lack stiffness or density, or that are in no section ("all": of all such),
                in the units of the deck. Each is whole: its density is that of the elements.

        Raises:
            InputError: a material or density for a set that is not there or lacks none, or both for one set.
        """
        check_value("materials", materials, Sequence[Material])
        return complete(self, materials)

    def convert(self, materials: Sequence[Material] = ()) -> Imported:
        """All that own assembly has of it: solids with their materials, couplings, masses and springs.

        Args:
            materials: as of ``with_materials``.

        Raises:
            DeckError: all that keeps the deck from becoming a model: an ``InputError`` with ``problems``.
        """
        check_value("materials", materials, Sequence[Material])
        return import_deck(self, materials)

    @advising(PYTHON)
    def mesh(self) -> Mesh:
        """The mesh of its solids with its sets.

        Raises:
            DeckError: as ``imported``, or couplings, springs, point masses, shells and beams, which a mesh
                cannot carry.
        """
        return mesh_of(self)

    @advising(PYTHON)
    def to_model(
        self, units: Units | str | None = None, *, materials: Sequence[Material] = (), mass_integration: str = "element"
    ) -> FEModel:
        """The model of its solids in SI units.

        Args:
            units: of the deck, as ``parse_units`` gives them or takes them ("mm-t-s"); m-kg-s unless given.
            materials: as of ``with_materials``.
            mass_integration: as of ``assemble``.

        Raises:
            DeckError: all that keeps the deck from becoming a model: an ``InputError`` with ``problems``.
        """
        given = parse_units(units) if isinstance(units, str) else units
        return model_of(self.convert(materials), given, mass_integration=mass_integration)

    @advising(PYTHON)
    def write(self, path: str | Path, format: str) -> tuple[str, ...]:
        """Write a flat deck of all that this one holds; sentences on what differs in it.

        Labels, and names of sets as far as the format has names, are kept; numbers in "nastran" have 11 digits.
        Densities that were given with the deck are written.

        Args:
            format: "calculix", "abaqus" or "nastran".

        Raises:
            DeckError: the deck has ``problems``, which the written deck would not show.
            InputError: an unknown format, or features that it does not have.
            OverwriteError: ``path`` is a file that the deck was read from.
            OutputError: the file cannot be written; an old one is kept.
        """
        # Not at the top: few decks are written.
        from morembs.importers.decks.writers import write_deck

        return write_deck(self, path, format)
