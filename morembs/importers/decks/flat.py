"""A deck as CalculiX reads it, with all that a model needs beside the matrices that come of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from morembs.base.types import Bools, Floats, Ints
from morembs.fem.constraints import AverageElement
from morembs.fem.material import Material
from morembs.importers.decks.problems import Problem, Problems
from morembs.importers.imported import PointMass


@dataclass(frozen=True, kw_only=True)
class Choices:
    """How a deck is to be taken: ``keep`` what the boundary holds, the steps up to ``preload`` before (0: none);
    ``materials`` of element sets, "all" for all elements that have none."""

    keep: bool = False
    preload: int = 0
    materials: tuple[Material, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class FlatDeck:
    """A deck with labels from 1 without gaps: those of the nodes and elements of the deck in their order.

    Nodes are rows (n,) of those of the deck, but in ``bodies`` and ``turning``, which have labels of the flat deck.
    """

    # The name of the file of the deck, labels (n,) and coordinates (n, 3) of its nodes, labels of its elements.
    name: str
    ids: Ints
    xyz: Floats
    elements: Ints
    # Text: nodes; all other cards outside of steps; steps of a preload.
    nodes: str
    cards: str
    steps: str = ""
    # Nodes (n,) of solids, and of all elements with stiffness; whether CalculiX makes solids of some elements.
    in_solids: Bools
    in_elements: Bools
    expands: bool
    # Displacements (n, 3) that the boundary holds, and nodes where these are along axes of their own.
    held: Bools
    turned: frozenset[int] = frozenset()
    # Reference nodes of rigid bodies and couplings in the order of the deck; rotation node -> its reference node;
    # nodes that follow others.
    bodies: tuple[int, ...] = ()
    turning: Mapping[int, int] = field(default_factory=dict)
    followers: frozenset[int] = frozenset()
    # What is added to the matrices, and surfaces as nodes of their names.
    average: tuple[AverageElement, ...] = ()
    masses: tuple[PointMass, ...] = ()
    surfaces: Mapping[str, Ints] = field(default_factory=dict)
    # Sentences on the model, as of ``Imported``.
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def text(self, extra: str, step: str, nodes: str = "", *, preloaded: bool = True) -> str:
        """The whole deck with ``nodes`` behind its nodes, ``extra`` cards before its steps, if ``preloaded``, and
        ``step``."""
        steps = [self.steps] if self.steps and preloaded else []
        return "\n".join([self.nodes, nodes, self.cards, extra, *steps, step, ""])


# What makes the flat deck of a deck whose file has cards that programs of its family read as they stand.
Cards = Callable[[Choices], FlatDeck]


def refuse_no_elements(problems: Problems) -> None:
    """Refuse a deck without elements that have stiffness and mass, with what else is wrong with it.

    Raises:
        DeckError: always.
    """
    what = f"{problems.source} has no solids, shells, membranes, beams or trusses, so CalculiX has nothing to assemble"
    problems.add(Problem(what=what, file=problems.source, keyword="ELEMENT"))
    problems.refuse()
