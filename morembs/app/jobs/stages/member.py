"""``[member]``: a planar part in place of a model, which the job reduces by global modal parameterisation."""

from __future__ import annotations

import glob
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morembs.app.jobs.solver import SolverTable
from morembs.app.jobs.stages.durations import START, least_seconds
from morembs.app.jobs.stages.member_cost import cost_of, counts_of
from morembs.app.jobs.stages.member_table import MemberTable, component_of, mesh_of
from morembs.app.jobs.stages.reduction import ReduceTable, named_tables
from morembs.app.jobs.stages.stage import JobForecast, JobStage, Result, Results, Work
from morembs.app.jobs.tables import HasTables, Job, JobTables, ModelTable, OutputTable
from morembs.app.jobs.tolerances import TOL
from morembs.app.report.sections import Place, Section
from morembs.base.arguments import fits, words
from morembs.base.errors import InputError
from morembs.base.memory import resident_bytes
from morembs.base.options import in_toml, read_options
from morembs.base.units import Units
from morembs.linalg.sparse.threads import blas_threads
from morembs.storage.checksums import whole_sum
from morembs.storage.contents import Content

if TYPE_CHECKING:
    from morembs.dynamics.gmp import AngleRange, ReducedMember
    from morembs.dynamics.nonlinear import NonlinearSolid, PlanarBeam

MEMBERS: Result[Mapping[str, ReducedMember]] = Result("members")
METHOD = "global-modal-parameterisation"
BESIDE = {"member", "model", "reduce", "solver", "output", "modes"}


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
            raise InputError(
                f"[{key}] was given beside [member], a part between two frames; leave it out",
                kind="conflict",
                keyword=key,
            )
        kept = {"model": {"units"}, "output": {"path"}, "solver": {"threads", "workers"}}
        for place, keys in kept.items():
            for key in sorted(tables.table(place).given - keys):
                expected = " and ".join(sorted(keys))
                raise InputError(
                    f"[{place}] {key} was given beside [member], which takes {expected} alone; leave it out",
                    kind="conflict",
                    keyword=key,
                )
        for name, table in named_tables(tables).items():
            if table.method != METHOD:
                raise InputError(
                    f'[[reduce]] {name!r}: method = {table.method!r} was given beside [member]; expected "{METHOD}"',
                    kind="conflict",
                    keyword="method",
                )
            options = _options(name, table, ModelTable.of(tables).parsed_units)
            formulation = options.get("formulation", "tangent")
            if MemberTable.require(tables).mesh is not None and formulation != "tangent":
                raise InputError(
                    f'[[reduce]] {name!r}: formulation = "{formulation}" was given for a mesh; expected "tangent"',
                    keyword="formulation",
                )

    def is_asked(self, job: Job) -> bool:
        return MemberTable.of(job) is not None

    def reads(self, job: Job) -> Mapping[str, Path]:
        return mesh_of(job)

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {"[output] path": job.output}

    def prepare(self, job: Job) -> None:
        component_of(job)

    def named_steps(self, job: Job) -> Sequence[str]:
        return (*(f"reduce {name}" for name in _all_options(job)), "write")

    def forecast(self, job: Job) -> JobForecast:
        part = cost_of(component_of(job))
        equilibria = {name: _equilibria(options) for name, options in _all_options(job).items()}
        tables_bytes = TOL.numbers_per_equilibrium * 8 * part.dofs * max(equilibria.values())
        peak = resident_bytes() + part.factor_bytes + tables_bytes
        times = {name: count * part.equilibrium_seconds for name, count in equilibria.items()}
        seconds = {name: least_seconds(name, part.dofs) for name in (START, *self.named_steps(job))}
        for name, more in times.items():
            seconds[f"reduce {name}"] += more
        return JobForecast(
            solver=part.solver,
            choice=f"{part.solver}, for the equilibria of {part.what}",
            nodes=part.nodes,
            elements=part.elements,
            dofs=part.dofs,
            coupled_dofs=part.dofs,
            rigid_modes=3,
            stiffness_nonzeros=part.stiffness_nonzeros,
            mass_nonzeros=part.mass_nonzeros,
            matrices_bytes=12 * (part.stiffness_nonzeros + part.mass_nonzeros),
            factor_entries=part.factor_entries,
            factor_flops=part.factor_flops,
            factor_bytes=part.factor_bytes,
            scratch_bytes=0,
            columns_bytes=tables_bytes,
            peak_memory_bytes=peak,
            factor_seconds=part.factor_seconds,
            threads=blas_threads(),
            shift_factor_entries=0,
            shift_factor_bytes=0,
            shift_seconds=0.0,
            processes=0,
            process_bytes=0,
            all_processes_bytes=peak,
            extent=part.extent,
            interface_nodes=part.interface_nodes,
            reduction_seconds=times,
            seconds=seconds,
        )

    def run(self, work: Work) -> None:
        from morembs.dynamics.gmp import ReducedMember
        from morembs.dynamics.gmp.stored import write_members

        job, members, kept = work.job, dict[str, ReducedMember](), list[Path]()
        inputs = [{"file": str(path), "sha256": Content.of(path).sha256} for path in mesh_of(job).values()]
        for name, options in _all_options(job).items():
            kept.append(_checkpoint(job, name, [each["sha256"] for each in inputs]))
            with work.watch.stage(f"reduce {name}"):
                try:
                    members[name] = _reduce_member(component_of(job), options, SolverTable.of(job).workers, kept[-1])
                except InputError as error:
                    raise error.restate(f"[[reduce]] {name!r}: {error}") from error
            report = members[name].report
            work.tell(*(f"{name}: {note}" for note in (report.notes if report is not None else ())))
        watch = work.watch
        with watch.stage("write"):
            write_members(
                job.output,
                {name: member.data for name, member in members.items()},
                recipe=job.tables.values(without_none=True, but={"output", "solver"}),
                provenance={
                    "job": job.text,
                    "changes": list(job.changes) or None,
                    "inputs": inputs or None,
                    "equilibria": {name: _count_equilibria(member) for name, member in members.items()},
                    "seconds": {stage.name: stage.seconds for stage in watch.stages},
                    "peak_memory_bytes": {stage.name: stage.peak_memory_bytes for stage in watch.stages},
                    "job_peak_memory_bytes": watch.peak_memory_bytes,
                },
            )
        for path in kept:
            path.unlink(missing_ok=True)
        work.give(MEMBERS, members)

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        nodes, elements, dofs = counts_of(component_of(job))
        return {
            "nodes": nodes,
            "elements": elements,
            "dofs": dofs,
            "bodies": {},
            "members": {name: _document(member) for name, member in results[MEMBERS].items()},
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


def _reduce_member(
    component: PlanarBeam | NonlinearSolid, options: Mapping[str, Any], workers: int, checkpoint: Path
) -> ReducedMember:
    from morembs.dynamics.gmp import ReducedMember, solid_member
    from morembs.dynamics.nonlinear import PlanarBeam

    if isinstance(component, PlanarBeam):
        return ReducedMember(component, **options, workers=workers, checkpoint=checkpoint)
    others = {key: value for key, value in options.items() if key != "formulation"}
    return solid_member(component, **others, workers=workers, checkpoint=checkpoint)


def _checkpoint(job: Job, name: str, sums: Sequence[str]) -> Path:
    """File of the equilibria of a reduction, from which a run that was killed goes on; those of other jobs go.

    It is of the output, not of the attempt at it; ``sums`` of the files that the job reads.
    """
    output = job.resolve(OutputTable.of(job).path)
    asked = job.tables.values(without_none=True, but={"output", "solver"})
    digest = hashlib.sha256(json.dumps([asked, sums], sort_keys=True, default=str).encode()).hexdigest()
    begin = f"{output.name}.{name}"
    path = output.with_name(f"{begin}.{digest[:12]}.equilibria")
    for left in output.parent.glob(f"{glob.escape(begin)}.{12 * '?'}.equilibria"):
        if left != path:
            left.unlink(missing_ok=True)
    return path


def _count_equilibria(member: ReducedMember) -> dict[str, int]:
    report = member.report
    if report is None:
        return {}
    return {"tables": report.equilibria, "solved": report.solved, "restored": report.restored}


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
    from morembs.dynamics.gmp.plan import EndAngle

    where, given = f"[[reduce]] {name!r}: ", table.options()
    reach = given.get("reach")
    if isinstance(reach, Mapping):
        given["reach"] = _envelope(reach, units, where)
    elif reach is not None and not fits(reach, EndAngle):
        raise InputError(
            f"{where}reach = {in_toml(reach)} was given; expected {words(EndAngle)}, or one of {{ angle = ... }}, "
            "{ moment = ... }, { load = ... }",
            keyword="reach",
        )
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
        raise error.restate(f"{where}{str(error).removeprefix('Plan: ')}") from error
    return options


def _envelope(given: Mapping[str, object], units: Units, where: str) -> AngleRange:
    from morembs.dynamics.gmp import AngleRange

    force = units.stress * units.length**2
    scale = {"angle": 1.0, "moment": force * units.length, "load": force}
    values = read_options(AngleRange, given, "reach", where=where, word="key")
    try:
        return AngleRange(**{key: scale[key] * value for key, value in values.items() if value is not None})
    except InputError as error:
        raise error.restate(f"{where}reach: {error}") from error


def _document(member: ReducedMember) -> dict[str, Any]:
    document, report = member.data.outline(), member.report
    if report is None:
        return document
    errors = dict(report.errors)
    counts = {"equilibria": report.equilibria, "solved": report.solved, "restored": report.restored}
    solved = {**counts, "symmetries": list(report.symmetries)}
    return {
        **document,
        **solved,
        "errors": errors,
        "error": max([document["error"], *errors.values()]),
        "notes": report.notes,
    }
