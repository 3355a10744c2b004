"""``[member]``: a planar beam in place of a model, which the job reduces by global modal parameterisation."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from morembs.app.jobs.solver import SolverTable
from morembs.app.jobs.stages.reduction import ReduceTable, named_tables
from morembs.app.jobs.stages.stage import JobForecast, JobStage, Result, Results, Work
from morembs.app.jobs.tables import HasTables, Job, JobTables, ModelTable, OptionalTable, Three
from morembs.app.jobs.tolerances import TOL
from morembs.app.report.sections import Place, Section
from morembs.base.errors import InputError
from morembs.base.key_tables import Table, described
from morembs.base.limits import NotNegative, PoissonRatio, Positive, length, number
from morembs.base.memory import resident_bytes
from morembs.base.options import read_options
from morembs.base.units import Units
from morembs.linalg.sparse.threads import blas_threads
from morembs.storage.checksums import whole_sum

if TYPE_CHECKING:
    from morembs.dynamics.gmp import AngleRange, ReducedMember
    from morembs.dynamics.nonlinear import PlanarBeam
    from morembs.dynamics.nonlinear import Section as BeamSection

MEMBERS: Result[Mapping[str, ReducedMember]] = Result("members")
METHOD = "global-modal-parameterisation"
BESIDE = {"member", "model", "reduce", "solver", "output", "modes"}
_LINE, _SECTION = ("length", "elements"), ("young", "density", "width", "height", "area", "second_moment")


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
    """``[member]``: a planar beam of one cross-section. Its frames are its first and last node."""

    length: Positive | None = described("the length of a straight beam", None)
    elements: Annotated[int, number("a count of elements from 1 to 100000", ge=1, le=100_000)] | None = None
    points: Annotated[list[Three], length("two or more", 2, sys.maxsize)] | None = described(
        "in place of length and elements, [x, y, direction of the axis in rad] of each node", None
    )
    young: Positive | None = described("Young's modulus", None)
    density: Positive | None = None
    poisson: PoissonRatio = 0.3
    width: Positive | None = described("of a rectangle, across the plane of motion", None)
    height: Positive | None = described("of a rectangle, in the plane of motion", None)
    area: Positive | None = described("in place of width and height, beside second_moment", None)
    second_moment: Positive | None = described("in place of width and height, beside area", None)
    section: SectionTable | None = described(
        "a table { EA = ..., GA = ..., EI = ..., mass = ..., rotary = ... } in place of young, density, width, height: "
        "force, force, force length2, mass/length, mass length",
        None,
    )

    def refuse_conflicts(self) -> None:
        line = [key for key in _LINE if key in self.given]
        if line != ([] if "points" in self.given else list(_LINE)):
            raise InputError(f"{_listed(self.given, _LINE, 'points')}; expected length and elements, or points")
        if self.section is None:
            given = {key for key in _SECTION if key in self.given}
            if given not in ({"young", "density", *pair} for pair in (_SECTION[2:4], _SECTION[4:])):
                raise InputError(
                    f"{_listed(self.given, _SECTION)}; expected young and density with width and height or with area "
                    "and second_moment, or section"
                )
        elif self.given & {*_SECTION, "poisson"}:
            raise InputError(f"section and {_listed(self.given, (*_SECTION, 'poisson'))}; expected one of them")

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


class ReduceMember(JobStage):
    """The reduced members of the job, and their file."""

    # Those of its reductions and its file come where the stages that it runs in place of have them.
    tables = (ModelTable, MemberTable)
    gives = (MEMBERS,)
    tells = (MEMBERS,)
    instead = (JobStage,)
    steps = ("reduce", "write")

    def refuse_conflicts(self, tables: JobTables) -> None:
        if MemberTable.of(tables) is None:
            return
        for key in sorted(tables.given - BESIDE):
            raise InputError(f"[{key}] was given beside [member], a beam between two frames; leave it out")
        kept = {"model": {"units"}, "output": {"path"}, "solver": {"threads", "workers"}}
        for place, keys in kept.items():
            for key in sorted(tables.table(place).given - keys):
                expected = " and ".join(sorted(keys))
                raise InputError(
                    f"[{place}] {key} was given beside [member], which takes {expected} alone; leave it out"
                )
        for name, table in named_tables(tables).items():
            if table.method != METHOD:
                raise InputError(
                    f'[[reduce]] {name!r}: method = {table.method!r} was given beside [member]; expected "{METHOD}"'
                )
            _options(name, table, ModelTable.of(tables).parsed_units)

    def is_asked(self, job: Job) -> bool:
        return MemberTable.of(job) is not None

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {"[output] path": job.output}

    def prepare(self, job: Job) -> None:
        _beam(job)

    def forecast(self, job: Job) -> JobForecast:
        beam = _beam(job)
        K, M = beam.tangent(beam.reference), beam.M
        begin = time.perf_counter()
        beam.tangent(beam.reference)
        seconds = TOL.tangents_per_equilibrium * (time.perf_counter() - begin)
        equilibria = {name: _equilibria(options) for name, options in _all_options(job).items()}
        tables_bytes = TOL.numbers_per_equilibrium * 8 * beam.size * max(equilibria.values())
        # Node by node nothing fills in, and each row meets the six before it.
        factor_bytes, nodes = 12 * K.nnz, beam.size // 3
        return JobForecast(
            solver="superlu",
            choice="superlu, for the equilibria of a chain of beam elements",
            nodes=nodes,
            elements=nodes - 1,
            dofs=beam.size,
            coupled_dofs=beam.size,
            rigid_modes=3,
            stiffness_nonzeros=K.nnz,
            mass_nonzeros=M.nnz,
            matrices_bytes=12 * (K.nnz + M.nnz),
            factor_entries=K.nnz,
            factor_flops=float(36 * beam.size),
            factor_bytes=factor_bytes,
            scratch_bytes=0,
            columns_bytes=tables_bytes,
            peak_memory_bytes=resident_bytes() + factor_bytes + tables_bytes,
            factor_seconds=0.0,
            threads=blas_threads(),
            shift_factor_entries=0,
            shift_factor_bytes=0,
            shift_seconds=0.0,
            processes=0,
            process_bytes=0,
            all_processes_bytes=resident_bytes() + factor_bytes + tables_bytes,
            extent=(_chord(beam), 0.0, 0.0),
            interface_nodes={"start": 1, "end": 1},
            reduction_seconds={name: count * seconds for name, count in equilibria.items()},
        )

    def run(self, work: Work) -> None:
        from morembs.dynamics.gmp import ReducedMember
        from morembs.dynamics.gmp.stored import write_members

        job, members = work.job, dict[str, ReducedMember]()
        beam, workers = _beam(job), SolverTable.of(job).workers
        for name, options in _all_options(job).items():
            with work.watch.stage(f"reduce {name}"):
                try:
                    members[name] = ReducedMember(beam, **options, workers=workers)
                except InputError as error:
                    raise InputError(f"[[reduce]] {name!r}: {error}") from error
            report = members[name].report
            work.tell(*(f"{name}: {note}" for note in (report.notes if report is not None else ())))
        with work.watch.stage("write"):
            write_members(job.output, {name: member.data for name, member in members.items()})
        work.give(MEMBERS, members)

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        beam, members = _beam(job), results[MEMBERS]
        nodes = beam.size // 3
        return {
            "nodes": nodes,
            "elements": nodes - 1,
            "dofs": beam.size,
            "bodies": {},
            "members": {name: _document(member) for name, member in members.items()},
            "output": str(job.output),
            "body_sha256": whole_sum(job.output),
        }

    def sections(self, document: Mapping[str, Any]) -> Sequence[Section]:
        if "members" not in document:
            return ()
        counts = f"{document['nodes']:,} nodes, {document['elements']:,} elements, {document['dofs']:,} degrees"
        rows = [
            (
                name,
                member["formulation"],
                str(member["coordinates"]),
                f"{member['reach']:.4g}",
                str(member["points"]),
                f"{member.get('solved', 0)} of {member.get('equilibria', 0)}",
                f"{member['error']:.1e}",
            )
            for name, member in document["members"].items()
        ]
        return [
            Section(place=Place.SUMMARY, lines=[f"planar member, {counts} of freedom"]),
            Section(
                title="global modal parameterisation",
                columns=("member", "formulation", "coordinates", "rad", "points", "equilibria solved", "largest error"),
                rows=rows,
            ),
        ]


def _listed(given: frozenset[str], *keys: Any) -> str:
    known = [key for each in keys for key in ([each] if isinstance(each, str) else each) if key in given]
    return f"{', '.join(known) or 'nothing of it'} was given"


def _beam(job: Job) -> PlanarBeam:
    return MemberTable.needed(job).beam(job.units)


def _chord(beam: PlanarBeam) -> float:
    start, end = beam.reference[:2], beam.reference[-3:-1]
    return math.hypot(*(end - start))


def _equilibria(options: Mapping[str, Any]) -> int:
    """About how many a member takes, or the time of."""
    if options.get("formulation") in ("linear", "foreshortened"):
        return TOL.equilibria_of_derivatives
    points: int | None = options.get("points_per_angle")
    return TOL.equilibria_of_a_member if points is None else points**2


def _all_options(job: HasTables) -> dict[str, dict[str, Any]]:
    """Of each member by name, the keywords of ``ReducedMember`` in SI units."""
    units = ModelTable.of(job).parsed_units
    return {name: _options(name, table, units) for name, table in named_tables(job).items()}


def _options(name: str, table: ReduceTable, units: Units) -> dict[str, Any]:
    from morembs.dynamics.gmp import Plan, ReducedMember

    where, given = f"[[reduce]] {name!r}: ", table.options()
    reach = given.get("reach")
    if isinstance(reach, Mapping):
        given["reach"] = _envelope(reach, units, where)
    options = read_options(
        ReducedMember,
        given,
        f"method {METHOD!r}",
        where=where,
        word="key",
        besides=("name", "method"),
        hidden=("workers", "checkpoint"),
    )
    try:
        Plan(**{key: value for key, value in options.items() if key not in ("modes", "formulation")})
    except InputError as error:
        raise InputError(f"{where}{error}") from error
    return options


def _envelope(given: Mapping[str, object], units: Units, where: str) -> AngleRange:
    from morembs.dynamics.gmp import AngleRange

    force = units.stress * units.length**2
    scale = {"angle": 1.0, "moment": force * units.length, "load": force}
    values = read_options(AngleRange, given, "reach", where=where, word="key")
    try:
        return AngleRange(**{key: scale[key] * value for key, value in values.items() if value is not None})
    except InputError as error:
        raise InputError(f"{where}reach: {error}") from error


def _document(member: ReducedMember) -> dict[str, Any]:
    told, report = member.data.outline(), member.report
    if report is None:
        return told
    errors = dict(report.errors)
    solved = {"equilibria": report.equilibria, "solved": report.solved, "symmetries": list(report.symmetries)}
    return {**told, **solved, "errors": errors, "error": max([told["error"], *errors.values()]), "notes": report.notes}
