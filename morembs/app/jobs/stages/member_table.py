"""``[member]``: a planar beam, or the mesh of a planar part, and the nonlinear component that it is."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from morembs.app.jobs.tables import Job, OptionalTable, Three
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key
from morembs.base.limits import NotNegative, PoissonRatio, Positive, length, number, text
from morembs.base.units import Units

if TYPE_CHECKING:
    from morembs.dynamics.nonlinear import NonlinearSolid, PlanarBeam
    from morembs.dynamics.nonlinear import Section as BeamSection

_LINE, _SECTION = ("length", "elements"), ("young", "density", "width", "height", "area", "second_moment")
_MESH = ("thickness", "start", "end")


@dataclass(frozen=True, kw_only=True)
class SectionTable(Table):
    """Stiffness and mass of a cross-section."""

    EA: Positive
    GA: Positive
    EI: Positive
    mass: Positive
    rotary: NotNegative = 0.0


@dataclass(frozen=True, kw_only=True)
class MemberTable(OptionalTable):
    """``[member]``: a planar beam of one cross-section, whose frames are its first and last node, or the mesh of a part
    that moves in the plane of x and y."""

    length: Positive | None = declare_key("the length of a straight beam", None)
    elements: Annotated[int, number("a count of elements from 1 to 100000", ge=1, le=100_000)] | None = None
    points: Annotated[list[Three], length("two or more", 2, sys.maxsize)] | None = declare_key(
        "in place of length and elements, [x, y, direction of the axis in rad] of each node", None
    )
    young: Positive | None = declare_key("Young's modulus", None)
    density: Positive | None = None
    poisson: PoissonRatio = 0.3
    width: Positive | None = declare_key("of a rectangle, across the plane of motion", None)
    height: Positive | None = declare_key("of a rectangle, in the plane of motion", None)
    area: Positive | None = declare_key("in place of width and height, beside second_moment", None)
    second_moment: Positive | None = declare_key("in place of width and height, beside area", None)
    section: SectionTable | None = declare_key(
        "a table { EA = ..., GA = ..., EI = ..., mass = ..., rotary = ... } in place of young, density, width, height: "
        "force, force, force length2, mass/length, mass length",
        None,
    )

    mesh: Annotated[str, text('the path of a mesh file such as "strip.msh"')] | None = declare_key(
        "in place of a beam: the file of a mesh, of plane elements with thickness, or of solids", None
    )
    thickness: Positive | None = declare_key("of a mesh of plane elements", None)
    start: str | None = declare_key('nodes of a mesh that move with the frame at the start, such as "set:LEFT"', None)
    end: str | None = declare_key("nodes that move with the frame at the end", None)

    def refuse_conflicts(self) -> None:
        if self.mesh is not None:
            self._refuse_conflicts_of_mesh()
            return
        if of_mesh := [key for key in _MESH if key in self.given]:
            raise InputError(
                f"{', '.join(of_mesh)} was given without mesh; expected mesh, or leave it out", kind="missing"
            )
        line = [key for key in _LINE if key in self.given]
        if line != ([] if "points" in self.given else list(_LINE)):
            raise InputError(
                f"{_list_given(self.given, _LINE, 'points')}; expected length and elements, or points", keyword="points"
            )
        if self.section is None:
            given = {key for key in _SECTION if key in self.given}
            if given not in ({"young", "density", *pair} for pair in (_SECTION[2:4], _SECTION[4:])):
                raise InputError(
                    f"{_list_given(self.given, _SECTION)}; expected young and density with width and height or with "
                    "area and second_moment, or section",
                    kind="missing",
                    keyword="section",
                )
        elif self.given & {*_SECTION, "poisson"}:
            raise InputError(
                f"section and {_list_given(self.given, (*_SECTION, 'poisson'))}; expected one of them",
                kind="conflict",
                keyword="section",
            )

    def _refuse_conflicts_of_mesh(self) -> None:
        for key in sorted(self.given - {"mesh", "young", "density", "poisson", *_MESH}):
            raise InputError(
                f"{key} was given beside mesh, which has its own shape; leave it out", kind="conflict", keyword=key
            )
        missing = [key for key in ("young", "density", "start", "end") if getattr(self, key) is None]
        if missing:
            raise InputError(
                f"{', '.join(missing)} is missing beside mesh; expected young, density, start and end", kind="missing"
            )

    def solid(self, file: Path, units: Units) -> NonlinearSolid:
        """The mesh of ``file`` in SI units, its frames on the x axis from the origin.

        Raises:
            InputError: no such mesh, no such nodes, or frames at one place.
        """
        # Not at the top: most jobs have no member.
        from morembs.dynamics.nonlinear import NonlinearSolid
        from morembs.fem.assembly import assemble
        from morembs.fem.interface import make_interface
        from morembs.fem.material import isotropic
        from morembs.fem.selection import select_nodes
        from morembs.importers import read_mesh
        from morembs.importers.plane_mesh import read_plane_mesh

        thickness = self.thickness
        mesh = read_mesh(file, units) if thickness is None else read_plane_mesh(file, thickness * units.length, units)
        young, density = (self.young or 0.0) * units.stress, (self.density or 0.0) * units.density
        material = isotropic(set="all", young=young, poisson=self.poisson, density=density)
        model = assemble(mesh, [material])
        rows = {"start": self.start or "", "end": self.end or ""}
        nodes = {}
        for name, words in rows.items():
            try:
                nodes[name] = select_nodes(model, words, length=units.length)
            except InputError as error:
                raise error.restate(f"[member] {name}: {error}") from error
        first, last = (make_interface(model, name=n, nodes=k, coupling="rigid").point for n, k in nodes.items())
        chord = last - first
        long = float(np.hypot(chord[0], chord[1]))
        if not long > abs(chord[2]):
            raise InputError(
                f"[member]: the centers of start and end are {chord[0]:.3g}, {chord[1]:.3g}, {chord[2]:.3g} m apart "
                "along x, y, z; expected two places of one plane of x and y",
                keyword="member",
            )
        c, s = chord[0] / long, chord[1] / long
        turned = (mesh.nodes.xyz - first) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        model = assemble(replace(mesh, nodes=replace(mesh.nodes, xyz=turned)), [material])
        return NonlinearSolid(
            model, [make_interface(model, name=n, nodes=k, coupling="rigid") for n, k in nodes.items()]
        )

    def beam(self, units: Units) -> PlanarBeam:
        """The beam in SI units.

        Raises:
            InputError: points that are no beam.
        """
        # Not at the top: most jobs have no member.
        from morembs.dynamics.nonlinear import PlanarBeam

        section = self._section(units)
        if self.points is None:
            return PlanarBeam.straight((self.length or 0.0) * units.length, self.elements or 0, section)
        return PlanarBeam.along([[units.length * x, units.length * y, turn] for x, y, turn in self.points], section)

    def _section(self, units: Units) -> BeamSection:
        from morembs.dynamics.nonlinear import Section as BeamSection

        if self.section is not None:
            force, given = units.stress * units.length**2, self.section
            return BeamSection(
                EA=given.EA * force,
                GA=given.GA * force,
                EI=given.EI * force * units.length**2,
                mass=given.mass * units.mass / units.length,
                rotary=given.rotary * units.mass * units.length,
            )
        width, height = self.width or 0.0, self.height or 0.0
        return BeamSection.of(
            E=(self.young or 0.0) * units.stress,
            A=(self.area or width * height) * units.length**2,
            I=(self.second_moment or width * height**3 / 12) * units.length**4,
            density=(self.density or 0.0) * units.density,
            nu=self.poisson,
        )


def _list_given(given: frozenset[str], *keys: Any) -> str:
    known = [key for each in keys for key in ([each] if isinstance(each, str) else each) if key in given]
    return f"{', '.join(known) or 'nothing of it'} was given"


def mesh_of(job: Job) -> Mapping[str, Path]:
    """The file of the mesh, where the member has one."""
    name = MemberTable.require(job).mesh
    return {} if name is None else {"[member] mesh": job.resolve(name)}


@lru_cache(maxsize=1)
def component_of(job: Job) -> PlanarBeam | NonlinearSolid:
    """The beam or the solid of the job, made once.

    Raises:
        InputError: points that are no beam, or a mesh of no planar part.
    """
    table = MemberTable.require(job)
    files = list(mesh_of(job).values())
    return table.solid(files[0], job.units) if files else table.beam(job.units)
