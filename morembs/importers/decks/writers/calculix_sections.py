"""Materials and sections of a deck in the words of CalculiX and Abaqus."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.decks.algebra import unit
from morembs.importers.decks.tables import Elements, Section
from morembs.importers.decks.writers.axes import is_isotropic, refuse_own_axes
from morembs.importers.decks.writers.calculix_mesh import Line, MeshText, numeral, numerals
from morembs.importers.tolerances import TOL

# Profiles of PBARL as those of *BEAM SECTION, whose first width lies along the first axis of the section.
_OF_PBARL: dict[str, tuple[str, Callable[[Sequence[float]], tuple[float, ...]]]] = {
    "BAR": ("RECT", lambda d: (d[1], d[0])),
    "ROD": ("CIRC", lambda d: (d[0],)),
    "TUBE": ("PIPE", lambda d: (d[0], d[0] - d[1])),
}
# Profiles of *BEAM SECTION that each program has here.
_PROFILES = {
    "calculix": ("RECT", "CIRC", "ELLIPSE", "PIPE", "BOX"),
    "abaqus": ("RECT", "CIRC", "PIPE", "BOX", "I", "L", "HEX"),
}


def elastic_lines(C: Floats) -> list[str]:
    """*ELASTIC of the stiffness C (6, 6); by Young's modulus and Poisson's ratio where these say it all."""
    lam, mu = C[0, 1], C[3, 3]
    if is_isotropic(C):
        return ["*ELASTIC", numerals([mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))])]
    # Columns of the upper triangle, shear in the order 12, 13, 23.
    order = [0, 1, 2, 5, 4, 3]
    constants = [C[order[i], order[j]] for j in range(6) for i in range(j + 1)]
    rows = range(0, len(constants), Line.CONSTANTS)
    return ["*ELASTIC, TYPE=ANISO", *(numerals(constants[i : i + Line.CONSTANTS]) for i in rows)]


@dataclass(eq=False)
class SectionText(MeshText):
    """Materials, orientations and sections."""

    def material(self, stiffness: Floats, density: float | None, text: str) -> tuple[str, list[str]]:
        """Name of a material, and the lines that define it unless it has been defined."""
        key = np.asarray(stiffness).tobytes(), density
        if key in self._materials:
            return self._materials[key], []
        name = self._materials[key] = self.name("MATERIAL", stem=text)
        mass = [] if density is None else ["*DENSITY", numeral(density)]
        return name, [f"*MATERIAL, NAME={name}", *elastic_lines(stiffness), *mass]

    def section_lines(self) -> Iterator[str]:
        """Materials, orientations and sections; of an element in several the last one holds."""
        owner = np.full(len(self.elements), -1)
        kinds = np.concatenate([np.empty(0, dtype=object), *(np.full(len(p.ids), p.kind, object) for p in self.parts)])
        for number, section in enumerate(self.deck.sections):
            rows = self.rows_of_set(section.set)
            owner[rows[kinds[rows] == section.kind]] = number
        for number, section in enumerate(self.deck.sections):
            rows = np.flatnonzero(owner == number)
            if len(rows):
                for own, members in self._variants(section, rows):
                    yield from self._section(own, members)

    def normal_lines(self) -> Iterator[str]:
        """Normals of elements at their nodes, where these have some of their own."""
        lines, start = ["*NORMAL"], 0
        for part in self.parts:
            numbers = self.numbers[start : start + len(part.ids)]
            start += len(part.ids)
            normals = part.values.get("normal", np.empty((0, 0, 3)))
            for i, k in np.argwhere(np.isfinite(normals).all(axis=2)).tolist():
                lines.append(f"{numbers[i]}, {self.node(part.nodes[i, k])}, {numerals(normals[i, k])}")
        if len(lines) > 1:
            yield "\n".join(lines)

    def _variants(self, section: Section, rows: Ints) -> Iterator[tuple[Section, Ints]]:
        """Sections with the own values of elements in ``rows``, each with the rows that share it."""
        # Offsets of beams are looked at together, and normals have cards of their own.
        alike = (("beam", "offset"), ("beam", "normal"), ("shell", "normal"), ("membrane", "normal"))
        if all((part.kind, name) in alike for part in self.parts for name in part.values):
            yield section, rows
            return
        groups: dict[tuple[object, ...], tuple[Section, list[int]]] = {}
        start = 0
        for part in self.parts:
            for row in rows[(rows >= start) & (rows < start + len(part.ids))].tolist():
                own = self._own(part, section, row - start)
                key = tuple((name, np.asarray(value).tobytes()) for name, value in own.items())
                groups.setdefault(key, (replace(section, **own), []))[1].append(row)  # type: ignore[arg-type]
            start += len(part.ids)
        yield from ((own, np.array(members)) for own, members in groups.values())

    def _own(self, part: Elements, section: Section, i: int) -> dict[str, object]:
        """Values of the element in row ``i`` of a part that differ from its section.

        Raises:
            InputError: values that a section of the program cannot have.
        """
        given = {name: value[i] for name, value in part.values.items() if np.isfinite(value[i]).any()}
        what = f"{self.deck.name}: {part.code} {part.ids[i]}"
        own: dict[str, object] = {}
        if part.kind == "beam":
            if given.get("released", np.zeros(1)).any():
                raise InputError(
                    f"{what} has pins, which decks written for {self.program} cannot have; leave them out, or write "
                    "for Nastran",
                    kind="unsupported",
                )
            return {"direction": given["direction"]} if "direction" in given else {}
        if "thickness" in given:
            if np.ptp(given["thickness"]) > 0:
                raise InputError(
                    f"{what} varies in thickness over its corners, which decks written for {self.program} cannot "
                    "have; give it one thickness",
                    kind="unsupported",
                )
            own["thickness"] = float(given["thickness"].flat[0])
        if "offset" in given:
            own["offset"] = float(given["offset"])
        names = [ply.material for ply in section.plies] or [section.material]
        stiff = [C for name in names if (C := self.deck.materials[name].stiffness) is not None]
        if given.keys() & {"angle", "direction"} and not all(elastic_lines(C)[0] == "*ELASTIC" for C in stiff):
            raise InputError(
                f"{what} has material axes of its own, which decks written for {self.program} cannot have; give "
                "them to its section",
                kind="unsupported",
            )
        return own

    def _section(self, section: Section, rows: Ints) -> Iterator[str]:
        if section.kind == "solid":
            if section.stiffness is None:
                self.warnings.append(f"the set {section.set} has no material: {section.lacks}")
                return
            name, lines = self.material(section.stiffness, section.density, section.material)
            yield from lines
            axes = ""
            if self.dialect == "abaqus" and elastic_lines(section.stiffness)[0] != "*ELASTIC":
                # Abaqus asks for axes where they matter.
                axes, lines = self._axes(np.eye(3))
                yield from lines
            axes = f", ORIENTATION={axes}" if axes else ""
            yield f"*SOLID SECTION, ELSET={self.element_set(rows)}, MATERIAL={name}{axes}"
            return
        options, data = [f"ELSET={self.element_set(rows)}"], list[str]()
        refuse_own_axes(self.deck, section, self.program, self._what(section))
        if section.nonstructural:
            raise InputError(
                f"{self._what(section)} has nonstructural mass, which decks written for {self.program} cannot have; "
                "add it to the density",
                kind="unsupported",
            )
        if section.plies:
            for ply in section.plies:
                name, lines = self._material(section, ply.material)
                yield from lines
                axis, lines = self._orientation(section, ply.angle)
                yield from lines
                data.append(f"{numeral(ply.thickness)}, 3, {name}{f', {axis}' if axis else ''}")
            options.append("COMPOSITE")
        else:
            name, lines = self._material(section, section.material)
            yield from lines
            options.append(f"MATERIAL={name}")
            axis, lines = self._orientation(section, 0.0)
            yield from lines
            options += [f"ORIENTATION={axis}"] if axis else []
        yield from self._structure(section, rows, options, data)

    def _in_words(self, section: Section) -> Section:
        """A section of bulk data as the program has it.

        Raises:
            InputError: it has none.
        """
        plate, name = section.plate, section.profile.removeprefix("PBARL ")
        if plate is not None:
            same = plate.membrane == plate.bending and plate.shear in ("", plate.bending)
            if not (same and plate.inertia_ratio == 1.0):
                raise InputError(
                    f"{self._what(section)} bends unlike a plate of its thickness, which {self.program} cannot say",
                    kind="unsupported",
                )
            if not plate.shear or plate.shear_ratio != TOL.shear_thickness:
                self.warnings.append(
                    f"{self._what(section)} has a transverse shear stiffness of its own (of bulk data MID3 and TS/T), "
                    f"which {self.program} has not here: shear is that of a plate [formulation-differs]"
                )
        if name != section.profile and name in _OF_PBARL:
            profile, dimensions = _OF_PBARL[name]
            return replace(section, profile=profile, dimensions=dimensions(section.dimensions))
        if section.kind == "truss" and any(section.dimensions[1:]):
            self.warnings.append(
                f"{self._what(section)} resists torsion, which trusses of {self.program} do not [formulation-differs]"
            )
        return section

    def _structure(self, section: Section, rows: Ints, options: list[str], data: list[str]) -> Iterator[str]:
        """The card of a section of shells, membranes, beams or trusses."""
        section = self._in_words(section)
        thickness = sum(ply.thickness for ply in section.plies) or section.thickness
        if section.kind in ("shell", "membrane"):
            if not thickness > 0:
                raise InputError(f"{self._what(section)} has no thickness; expected one", kind="missing")
            if section.offset:
                options.append(f"OFFSET={numeral(-section.offset / thickness)}")
            word, data = f"{section.kind.upper()} SECTION", data or [numeral(thickness)]
        elif section.kind == "truss":
            word, data = "SOLID SECTION", [numeral(section.dimensions[0])]
        elif section.kind == "beam":
            if section.profile not in _PROFILES[self.dialect] or section.direction is None:
                known = ", ".join(_PROFILES[self.dialect])
                raise InputError(
                    f"{self._what(section)} has the profile {section.profile!r}; {self.program} has {known}",
                    kind="unsupported",
                )
            self._refuse_circle(section, rows)
            word = "BEAM SECTION"
            options += [f"SECTION={section.profile.replace('ELLIPSE', 'CIRC')}", *self._offsets(section, rows)]
            is_ellipse = section.profile == "CIRC" and self.dialect == "calculix"
            data = [numerals([2 * section.dimensions[0]] if is_ellipse else section.dimensions)]
            data.append(numerals(section.direction))
        else:
            raise InputError(
                f"{self._what(section)} is for elements that {self.program} lacks; leave these elements out",
                kind="unsupported",
            )
        yield "\n".join([f"*{word}, {', '.join(options)}", *data])

    def _refuse_circle(self, section: Section, rows: Ints) -> None:
        """Refuse circular profiles of beams of two nodes, which CalculiX does not read.

        Raises:
            InputError: in these cases.
        """
        shapes = np.concatenate([np.full(len(part.ids), part.shape, object) for part in self.parts])[rows]
        is_round = section.profile in ("CIRC", "ELLIPSE", "PIPE")
        if self.dialect == "calculix" and is_round and (shapes == "line2").any():
            raise InputError(
                f"{self._what(section)} has the profile {section.profile!r}, which CalculiX lacks for beams of two "
                "nodes; give it another, such as RECT, or write the deck for Abaqus",
                kind="unsupported",
            )

    def _what(self, section: Section) -> str:
        return f"{self.deck.name}: {section.code or 'the section'} of the set {section.set}"

    def _material(self, section: Section, name: str) -> tuple[str, list[str]]:
        given = self.deck.materials.get(name)
        if given is None or given.stiffness is None:
            raise InputError(
                f"{self._what(section)} names the material {name!r}, which has no linear stiffness in space",
                kind="unsupported",
            )
        G, mu = given.constants.get("G", 0.0), float(given.stiffness[3, 3])
        if {"E", "NU"} <= given.constants.keys() and G and abs(G / mu - 1) > TOL.disagreeing_poisson:
            self.warnings.append(
                f"{self._what(section)} has the material {name!r} whose G = {G:g} does not fit E and NU; "
                f"{self.program} takes G = {mu:g} [formulation-differs]"
            )
        return self.material(given.stiffness, given.density, name)

    def _orientation(self, section: Section, angle: float) -> tuple[str, list[str]]:
        """Name of the material axes of a section or ply ("": those of the program), and the lines that define it."""
        axes = section.axes
        if axes is None:
            if angle:
                raise InputError(
                    f"{self._what(section)} has plies at angles to axes that each element has of its own",
                    kind="unsupported",
                )
            return "", []
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        return self._axes(np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ axes)

    def _axes(self, axes: Floats) -> tuple[str, list[str]]:
        """Name of an orientation along the rows of ``axes`` (3, 3), and the lines that define it unless it has been."""
        key = "ORIENTATION", "", axes.tobytes()
        if key in self._sets:
            return self._sets[key], []
        name = self._sets[key] = self.name("ORIENTATION")
        return name, [f"*ORIENTATION, NAME={name}", numerals(axes[:2].ravel())]

    def _offsets(self, section: Section, rows: Ints) -> list[str]:
        """OFFSET1 and OFFSET2 of beams, in widths of the profile along its axes."""
        vectors = np.concatenate(
            [part.values.get("offset", np.zeros((len(part.ids), 2, 3))) for part in self.parts if part.kind == "beam"]
        )
        vectors = np.nan_to_num(vectors)
        ends = np.concatenate(
            [self.nodes.rows(part.nodes[:, :2], "elements name") for part in self.parts if part.kind == "beam"]
        )
        beams = np.concatenate([np.full(len(part.ids), part.kind == "beam") for part in self.parts])
        own = (np.cumsum(beams) - 1)[rows]
        if not vectors[own].any() or section.direction is None:
            return []
        along = unit(self.deck.xyz[ends[own, 1]] - self.deck.xyz[ends[own, 0]])
        first = unit(section.direction - (along @ section.direction)[:, None] * along)
        second = np.cross(along, first)
        widths = (
            (*section.dimensions, *section.dimensions)[:2]
            if section.profile != "CIRC"
            else (2 * section.dimensions[0],) * 2
        )
        parts = (
            np.stack([np.einsum("kex,kx->ke", vectors[own], axis) for axis in (first, second)])
            / np.array(widths)[:, None, None]
        )
        # Offsets are the place of the node, measured from the axis.
        mean = -parts.reshape(2, -1).mean(axis=1)
        if np.abs(parts + mean[:, None, None]).max() > TOL.same_offset:
            raise InputError(
                f"{self._what(section)} has offsets that differ by element, which {self.program} has not",
                kind="unsupported",
            )
        return [f"OFFSET{i}={numeral(value)}" for i, value in enumerate(mean.tolist(), start=1) if value]
