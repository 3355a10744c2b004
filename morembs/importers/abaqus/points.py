"""Elements on single nodes of an input deck: point masses; springs and dashpots as entries of K and D."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.abaqus.deck import Contents, Rows, values
from morembs.importers.abaqus.equations import Axes
from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.names import Discrete, Placed
from morembs.importers.decks.algebra import along
from morembs.importers.discrete import spring
from morembs.importers.imported import DiscreteElement, PointMass
from morembs.importers.tolerances import TOL

_MATRIX = {"SPRING": "K", "DASHPOT": "D"}
_PROPERTY_OF = {
    "MASS": "MASS",
    "ROTARYI": "ROTARY INERTIA",
    "SPRING1": "SPRING",
    "SPRING2": "SPRING",
    "SPRINGA": "SPRING",
    "DASHPOT1": "DASHPOT",
    "DASHPOT2": "DASHPOT",
    "DASHPOTA": "DASHPOT",
}


class Points:
    """``masses``, and springs and dashpots as ``discrete`` elements, of all scopes, with ``warnings``."""

    def __init__(self, deck: Contents, assembly: Assembly, axes: Axes) -> None:
        self.deck, self.assembly = deck, assembly
        # Springs of CalculiX act along global directions whatever axes their nodes have.
        self.axes = Axes(assembly) if deck.dialect == "calculix" else axes
        self.masses: list[PointMass] = []
        self.discrete: list[DiscreteElement] = []
        self.warnings: list[str] = []

    def read(self) -> None:
        """All of them; what cannot be read is a problem of the deck."""
        given: dict[int, tuple[Placed, Card, Rows]] = {}
        problems, options = self.deck.problems, self.deck.options
        for placed in (*self.assembly.placed.values(), self.assembly.top):
            for scope in placed.contents:
                for card, rows in scope.properties:
                    if card.keyword != "SOLID SECTION":
                        with problems.collected(card):
                            self._read_properties(placed, card, rows, given)
        for element in self.assembly.discrete:
            if element.code == "DCOUP3D" or options.skips(element.code, _PROPERTY_OF[element.code]):
                continue
            placed, card, rows = given.get(element.number, (element.placed, Card("", {}, self.deck.name), []))
            with problems.collected(card, (f"--skip {element.code}",)):
                self._property(placed, element, card, rows)

    def _read_properties(
        self, placed: Placed, card: Card, rows: Rows, given: dict[int, tuple[Placed, Card, Rows]]
    ) -> None:
        for element in self.assembly.elements_of(placed, card.need("ELSET")).tolist():
            if element < self.assembly.solids or element in given:
                why = "has a property already" if element in given else "is a solid"
                raise InputError(f"{card} of {card.need('ELSET')!r} names an element that {why}", kind="unsupported")
            given[element] = placed, card, [row for row in rows if row]

    def _property(self, placed: Placed, element: Discrete, card: Card, rows: Rows) -> None:
        if card.keyword != _PROPERTY_OF[element.code]:
            raise InputError(
                f"{self.deck.name}: the element {element.label} of the type {element.code} has no property of its "
                f"kind; expected *{_PROPERTY_OF[element.code]}",
                kind="missing",
            )
        name = f"{card.options['ELSET']}:{element.label}"
        if element.code in ("MASS", "ROTARYI"):
            value = point_value(placed, card, rows)
            mass = PointMass(name=name, node=element.nodes[0], mass=float(value[0, 0]))
            spin = PointMass(name=name, node=element.nodes[0], mass=0.0, inertia=value)
            self.masses.append(mass if element.code == "MASS" else spin)
        else:
            self._spring(name, element, card, rows)

    def _spring(self, name: str, element: Discrete, card: Card, rows: Rows) -> None:
        """A spring or dashpot with the lines of its property.

        SPRING1 is between a node and the ground, SPRING2 between two nodes, each along given directions; SPRINGA acts
        along the line through its nodes.

        Raises:
            InputError: lines that do not fit, directions along an *ORIENTATION, or two ends at one place.
        """
        if card.options.get("ORIENTATION"):
            raise InputError(
                f"{card} acts along an *ORIENTATION, which is not supported; give it in global directions",
                kind="unsupported",
            )
        along_line, matrix = element.code.endswith("A"), _MATRIX[card.keyword]
        lines = [values(row, card) for row in rows if row]
        if not lines or (not along_line and len(lines) < 2):
            raise InputError(f"{card} has {len(lines)} lines; expected its directions and its constant below them")
        value, preload = _constant(card, lines if along_line else lines[1:], self.warnings)
        if along_line:
            self._along(name, element, card, value, preload)
            return
        directions = [int(d) - 1 for d in lines[0] if d]
        if len(directions) == 1 and len(element.nodes) == 2:
            directions *= 2
        if len(directions) != len(element.nodes) or not all(0 <= d < 6 for d in directions):
            raise InputError(
                f"{card} gives the directions {lines[0]}; expected one of 1 to 6 for each node of an element"
            )
        signs = (1.0, -1.0)
        ends = [
            (node, sign * self.axes.part(node, d))
            for node, d, sign in zip(element.nodes, directions, signs[: len(directions)], strict=True)
        ]
        self.discrete.append(spring(name, matrix, ends, value))

    def _along(self, name: str, element: Discrete, card: Card, value: float, preload: float) -> None:
        """A spring along its line, with the geometric stiffness of its force where the program counts that."""
        matrix = _MATRIX[card.keyword]
        a, b = (self.assembly.xyz[node] for node in element.nodes)
        part, length = along(b - a), float(np.linalg.norm(b - a))
        if part is None:
            raise InputError(
                f"{card}: the ends of the element {element.label} are at one place; expected a line", kind="model"
            )
        directions = [(part, value)]
        if preload and self.deck.dialect == "calculix":
            # A force turns with its line, which resists motions across it by force over length.
            _, _, axes = np.linalg.svd(part[None, :3])
            directions += [(np.append(axis, np.zeros(3)), preload / length) for axis in axes[1:]]
        elif preload:
            self.warnings.append(
                f"{card} of {card.options['ELSET']} has a force of {preload:g} at zero elongation; the stiffness that "
                "it adds across the line was left out, as Abaqus does without NLGEOM [spring-slope]"
            )
        for part, stiffness in directions:
            ends = [(element.nodes[0], -part), (element.nodes[1], part)]
            self.discrete.append(spring(name, matrix, ends, stiffness))


def _constant(card: Card, lines: list[list[float]], warnings: list[str]) -> tuple[float, float]:
    """The constant and no force; of a table of forces its slope and its force at zero."""
    if "NONLINEAR" not in card.options:
        if len(lines) > 1:
            warnings.append(
                f"{card} of {card.options['ELSET']} depends on temperature or frequency; its first line was taken "
                "[temperature-first-row]"
            )
        return lines[0][0], 0.0
    table = np.array([[*row, 0.0][:2] for row in lines])
    force, motion = table[np.argsort(table[:, 1], kind="stable")].T
    if len(table) < 2 or not (np.diff(motion) > 0).all():
        raise InputError(
            f"{card} is nonlinear and gives no table of forces over growing motions; expected one", kind="missing"
        )
    warnings.append(f"{card} of {card.options['ELSET']} is nonlinear; its slope at zero was taken [spring-slope]")
    i = int(np.searchsorted(motion, 0.0, side="right")) - 1
    # Beyond its table a force stays as it is.
    inside = 0 <= i < len(motion) - 1
    slope = float((force[i + 1] - force[i]) / (motion[i + 1] - motion[i])) if inside else 0.0
    return slope, float(np.interp(0.0, motion, force))


def point_value(placed: Placed, card: Card, rows: Rows) -> Floats:
    """Mass times the identity, or the inertia (3, 3) about the node."""
    if card.options.get("TYPE", "ISOTROPIC").upper() != "ISOTROPIC" or card.options.get("ORIENTATION"):
        raise InputError(
            f"{card} is given with TYPE or ORIENTATION; expected a plain mass, or inertia in global axes",
            kind="conflict",
        )
    row = values(rows[0], card) if rows else []
    if card.keyword == "MASS":
        if len(row) != 1 or not row[0] >= 0:
            raise InputError(f"{card} of {card.need('ELSET')!r} gives {row or 'nothing'}; expected one mass")
        return np.asarray(row[0] * np.eye(3))
    a = np.array([*row, *[0.0] * 6])[:6]
    J = np.array([[a[0], a[3], a[4]], [a[3], a[1], a[5]], [a[4], a[5], a[2]]])
    if not row or len(row) > 6 or np.linalg.eigvalsh(J)[0] < -TOL.negative_rotary_inertia * np.abs(J).max():
        raise InputError(
            f"{card} of {card.need('ELSET')!r} gives {row or 'nothing'}; expected I11, I22, I33, I12, I13, I23"
        )
    if not np.array_equal(placed.rotation, np.eye(3)):
        raise InputError(
            f"{card} is in an instance that is turned; give the rotary inertia in the assembly", kind="unsupported"
        )
    return J
