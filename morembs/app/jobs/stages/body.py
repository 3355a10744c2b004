"""``[frame]``, ``[envelope]``, ``[stiffening]`` and ``[stress]``: the bodies with all that goes into their file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from morembs.app.jobs.compare import recommended
from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.certificate import CERTIFICATES
from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.full_modes import NOTES
from morembs.app.jobs.stages.reduction import REDUCED, reducers_of
from morembs.app.jobs.stages.spin import SPINS
from morembs.app.jobs.stages.stage import JobStage, Result, Work
from morembs.app.jobs.stages.unreduced import PARTS
from morembs.base.errors import InputError
from morembs.body import Body, make_part
from morembs.body.build import BodyOptions, StressOptions, build_body
from morembs.body.delivery_check import delivered_warnings
from morembs.body.floating.frame import check_frame
from morembs.body.floating.stiffening import Envelope
from morembs.body.floating.stiffening_terms import why_no_stiffening
from morembs.fem.fe_model import has_places
from morembs.fem.selection import select_nodes
from morembs.reducers import ProblemSummary

BODIES: Result[tuple[Body, ...]] = Result("bodies")


class Deliver(JobStage):
    """One body for each reduced model."""

    tables = ("frame", "envelope", "stiffening", "stress", "output")
    needs = (PROBLEM, PARTS, REDUCED, CERTIFICATES, SPINS, NOTES)
    gives = (BODIES,)

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse what the bodies cannot carry."""
        wanted, model = body_options(job), facts.model
        check_frame(wanted.kind, wanted.interfaces, list(facts.coupling.frame_columns))
        reason = why_no_stiffening(model) if wanted.stiffening is not None else ""
        if reason:
            raise InputError(f"[stiffening]: {reason}")
        asked = wanted.kind != "mean-axes" or wanted.stiffening is not None or wanted.envelope is not None
        for name, reducer in job.reducers.items():
            if asked and reducer.two_sided:
                raise InputError(
                    f"[frame], [envelope] and [stiffening]: the body {name!r} comes from a two-sided reduction, whose "
                    "matrices are not symmetric; a floating frame needs a one-sided one"
                )
        if asked and not (has_places(model) and rigid == 6):
            places = "" if has_places(model) else "coordinates without places and "
            raise InputError(
                f"[frame], [envelope] and [stiffening]: the model has {places}{rigid} rigid-body motions; a floating "
                "frame needs a free body with six (leave supports to the simulator)"
            )
        if job.tables.output.nodes == "skin" and model.mesh is None:
            raise InputError('nodes = "skin" needs elements; this model has matrices only, take "all" or "interfaces"')
        if wanted.stress is None:
            return ()
        if model.mesh is None:
            raise InputError("[stress]: this model has matrices only, and stress needs elements; leave [stress] out")
        if wanted.stress.nodes not in ("skin", "all"):
            try:
                select_nodes(model, wanted.stress.nodes, length=wanted.stress.length)
            except InputError as error:
                raise InputError(f"[stress]: {error}") from error
        return ()

    def run(self, work: Work) -> None:
        job, problem, parts = work.job, work[PROBLEM], work.get(PARTS)
        wanted, reduced = body_options(job), work[REDUCED]
        none = [None] * len(reduced)
        certificates, spins = work.get(CERTIFICATES) or none, work.get(SPINS) or none
        part, bodies = make_part(problem, job.tables.output.nodes), []
        with work.watch.stage("deliver"):
            operator = wanted.stress.operator(problem) if wanted.stress is not None else None
            for body, certificate, spin, reducer in zip(
                reduced, certificates, spins, reducers_of(job).values(), strict=True
            ):
                switching = reducer.switching(problem, body)
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


def recommended_body(bodies: Sequence[Body]) -> Body:
    """The body with the smallest limit of its error, whose modes are drawn."""
    limits = {body.name: None if body.certificate is None else body.certificate.limit.upper for body in bodies}
    return next(body for body in bodies if body.name == recommended(limits))


def body_options(job: Job) -> BodyOptions:
    """What every body of the job carries, in SI units."""
    units, tables = job.units, job.tables
    given, origin = tables.envelope, tables.frame.origin
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
    stiffened = tables.stiffening
    stress = tables.stress
    return BodyOptions(
        kind=tables.frame.kind,
        interfaces=tuple(tables.frame.interfaces),
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
