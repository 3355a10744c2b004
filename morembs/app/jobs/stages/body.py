"""``[frame]``, ``[envelope]``, ``[stiffening]`` and ``[stress]``: the bodies with all that goes into their file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from morembs.app.jobs.compare import recommend_body
from morembs.app.jobs.stages.certificate import CERTIFICATES
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.full_modes import NOTES
from morembs.app.jobs.stages.reduction import REDUCED, reducers_of
from morembs.app.jobs.stages.spin import SPINS, SpinTable
from morembs.app.jobs.stages.stage import BODIES, JobStage, Results, Work
from morembs.app.jobs.stages.unreduced import PARTS
from morembs.app.jobs.tables import Job, JobTables, OptionalTable, OutputTable, SingleTable, Three
from morembs.app.report.frequencies import frequency_sections
from morembs.app.report.sections import Place, Section
from morembs.app.report.words import coordinate_words, frame_words, mass_section, ranking_words
from morembs.base.errors import InputError
from morembs.base.key_tables import declare_key
from morembs.base.limits import NotNegative, number
from morembs.body import Body, make_part
from morembs.body.build import BodyOptions, StressOptions, build_body
from morembs.body.delivery_check import delivered_warnings
from morembs.body.floating.frame import check_frame
from morembs.body.floating.stiffening import Envelope
from morembs.body.floating.stiffening_terms import why_no_stiffening
from morembs.fem.fe_model import has_places
from morembs.fem.selection import select_nodes
from morembs.reducers import ProblemSummary


@dataclass(frozen=True, kw_only=True)
class FrameTable(SingleTable):
    """``[frame]``: how the body frame follows the body."""

    kind: Literal["mean-axes", "center-of-mass", "tangent", "chord"] = "mean-axes"
    interfaces: list[str] = declare_key("names of the interfaces that the frame follows", [])
    origin: Three | Literal["center-of-mass"] | None = declare_key(
        'the origin of the frame, [x, y, z] or "center-of-mass"', None
    )


@dataclass(frozen=True, kw_only=True)
class EnvelopeTable(OptionalTable):
    """``[envelope]``: the largest loads in use, in the declared units (rad for angles)."""

    acceleration: Annotated[float, number("a number, zero or more (length/time2)", ge=0)] | None = None
    angular_acceleration: Annotated[float, number("a number, zero or more (rad/time2)", ge=0)] | None = None
    speed: Annotated[float, number("a number, zero or more (rad/time)", ge=0)] | None = None
    force: NotNegative | None = None
    moment: NotNegative | None = None


@dataclass(frozen=True, kw_only=True)
class StiffeningTable(OptionalTable):
    """``[stiffening]``: geometric stiffening of every body."""

    share: Annotated[float, number("a part from 0 to below 1", ge=0, lt=1)] = declare_key(
        "the part of the stiffness below which a term is left out, from 0 to 1", 0.01
    )


@dataclass(frozen=True, kw_only=True)
class StressTable(OptionalTable):
    """``[stress]``: stress shapes of every body."""

    nodes: str = declare_key('"skin", "all" or a selection such as "set:FILLET"', "skin")
    single: bool = True
    correction: bool = True
    jump: bool = True


class Deliver(JobStage):
    """One body for each reduced model."""

    tables = (FrameTable, EnvelopeTable, StiffeningTable, StressTable, OutputTable)
    needs = (PROBLEM, PARTS, REDUCED, CERTIFICATES, SPINS, NOTES)
    gives = (BODIES,)
    tells = (BODIES,)
    step = "deliver"

    def refuse_conflicts(self, tables: JobTables) -> None:
        for key in ("frame", "envelope", "stiffening"):
            if SpinTable.of(tables) is not None and key in tables.given:
                raise InputError(
                    f"[{key}] was given beside [spin]: a floating frame that spins in a simulator would count the "
                    "gyroscopic terms twice; leave one of them out (for stress stiffness alone take [preload])",
                    kind="conflict",
                    keyword=key,
                )

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse what the bodies cannot carry."""
        wanted, model = body_options(job), facts.model
        check_frame(wanted.kind, wanted.interfaces, list(facts.coupling.frame_columns))
        reason = why_no_stiffening(model) if wanted.stiffening is not None else ""
        if reason:
            raise InputError(f"[stiffening]: {reason}", keyword="stiffening")
        asked = wanted.kind != "mean-axes" or wanted.stiffening is not None or wanted.envelope is not None
        for name, reducer in job.reducers.items():
            if asked and reducer.two_sided:
                raise InputError(
                    f"[frame], [envelope] and [stiffening]: the body {name!r} comes from a two-sided reduction, whose "
                    "matrices are not symmetric; a floating frame needs a one-sided one",
                    kind="unsupported",
                    keyword="frame",
                )
        if asked and not (has_places(model) and rigid == 6):
            places = "" if has_places(model) else "coordinates without places and "
            raise InputError(
                f"[frame], [envelope] and [stiffening]: the model has {places}{rigid} rigid-body motions; a floating "
                "frame needs a free body with six (leave supports to the simulator)",
                kind="missing",
                keyword="frame",
            )
        if OutputTable.of(job).nodes == "skin" and model.mesh is None:
            raise InputError(
                'nodes = "skin" needs elements; this model has matrices only, take "all" or "interfaces"',
                kind="unsupported",
                keyword="nodes",
            )
        if wanted.stress is None:
            return ()
        if model.mesh is None:
            raise InputError(
                "[stress]: this model has matrices only, and stress needs elements; leave [stress] out",
                kind="unsupported",
                keyword="stress",
            )
        if wanted.stress.nodes not in ("skin", "all"):
            try:
                select_nodes(model, wanted.stress.nodes, length=wanted.stress.length)
            except InputError as error:
                raise error.restate(f"[stress]: {error}") from error
        return ()

    def run(self, work: Work) -> None:
        job, problem, parts = work.job, work[PROBLEM], work.get(PARTS)
        wanted, reduced = body_options(job), work[REDUCED]
        none = [None] * len(reduced)
        certificates, spins = work.get(CERTIFICATES) or none, work.get(SPINS) or none
        part, bodies = make_part(problem, OutputTable.of(job).nodes), []
        operator = wanted.stress.operator(problem) if wanted.stress is not None else None
        for body, certificate, spin, reducer in zip(
            reduced, certificates, spins, reducers_of(job).values(), strict=True
        ):
            switching = reducer.tabulate_static_modes(problem, body)
            variation = reducer.variation(problem, body)
            bodies.append(
                build_body(
                    problem,
                    body,
                    part,
                    wanted,
                    certificate=certificate,
                    operator=operator,
                    switching=switching,
                    variation=variation,
                    spin=spin,
                )
            )
        known = (problem if parts is None else parts.problem).known_frequencies_hz()
        delivered = tuple(replace(body, full_frequencies_hz=known) for body in bodies)
        work.tell(*delivered_warnings(delivered), heard=False)
        work.tell(*(work.get(NOTES) or ()), heard=False, stored=False)
        work.give(BODIES, delivered)

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        bodies = results[BODIES]
        part, first = bodies[0].part, bodies[0]
        return {
            "mass": part.mass,
            "center_of_mass": part.center_of_mass,
            "inertia": part.inertia,
            "frequencies_hz": first.frequencies_hz,
            "full_frequencies_hz": first.full_frequencies_hz,
            "bodies": {body.name: _document(body) for body in bodies},
        }

    def sections(self, document: Mapping[str, Any]) -> Sequence[Section]:
        if not document["bodies"]:
            return ()
        lines: list[str] = []
        for name, body in document["bodies"].items():
            lines.append(f"  {name}: {coordinate_words(body['mode_kind'])}")
            lines += [f"    {body['frame_words']}"] if body["frame_words"] else []
            lines += [f"    inertia terms: {ranking_words(body['ranking'])}"] if body["ranking"] else []
        return [Section(place=Place.SUMMARY, lines=lines), *frequency_sections(document), mass_section(document)]


def _document(body: Body) -> dict[str, Any]:
    """What a document tells of one body; other stages add their errors of it."""
    floating = body.floating
    tells = floating is not None and (floating.kind != "mean-axes" or floating.stiffening is not None)
    return {
        "order": body.reduced.order,
        "rigid_count": body.reduced.rigid_count,
        "frequencies_hz": body.frequencies_hz,
        "mode_kind": list(body.reduced.mode_kind),
        "recipe": dict(body.recipe),
        "frame": None if floating is None else floating.kind,
        "frame_words": frame_words(floating) if floating is not None and tells else None,
        "ranking": [[term.name, term.equation, term.share] for term in body.ranking],
        "largest_response_error": None,
        "certificate": None,
    }


def recommended_body(bodies: Sequence[Body]) -> Body:
    """The body with the smallest limit of its error, whose modes are drawn."""
    limits = {body.name: None if body.certificate is None else body.certificate.limit.upper for body in bodies}
    return next(body for body in bodies if body.name == recommend_body(limits))


def body_options(job: Job) -> BodyOptions:
    """What every body of the job carries, in SI units."""
    units, frame = job.units, FrameTable.of(job)
    given, origin = EnvelopeTable.of(job), frame.origin
    envelope = None
    if given is not None:
        force = units.mass * units.length / units.time**2
        scale = {
            "acceleration": units.length / units.time**2,
            "angular_acceleration": units.time**-2,
            "speed": 1 / units.time,
            "force": force,
            "moment": force * units.length,
        }
        values = given.values(without_none=True)
        envelope = Envelope(**{name: value * scale[name] for name, value in values.items()})
    stiffened, stress = StiffeningTable.of(job), StressTable.of(job)
    return BodyOptions(
        kind=frame.kind,
        interfaces=tuple(frame.interfaces),
        envelope=envelope,
        origin=None if origin == "center-of-mass" else [units.length * float(x) for x in origin or (0, 0, 0)],
        stiffening=None if stiffened is None else replace(envelope or Envelope(), share=stiffened.share),
        stress=None
        if stress is None
        else StressOptions(
            nodes=stress.nodes,
            single=stress.single,
            correction=stress.correction,
            jump=stress.jump,
            length=units.length,
        ),
    )
