"""``[preload]``: loads whose stress stiffens the body before it is reduced."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import scipy.sparse as sp

from morembs.app.jobs.stages.couple import INTERFACES, PROBLEM, VARIED, make_problem
from morembs.app.jobs.stages.stage import MODEL, JobStage, Work
from morembs.app.jobs.stages.unreduced import SubstructureTable
from morembs.app.jobs.tables import Job, JobTables, OptionalTable, Six, Three
from morembs.base.errors import InputError
from morembs.base.key_tables import declare_key
from morembs.base.limits import Finite
from morembs.body.floating.preload import Preload, Preloaded, apply_preload
from morembs.body.floating.stiffening_terms import why_no_stiffening
from morembs.fem import FEModel
from morembs.fem.fe_model import has_places
from morembs.reducers import ProblemSummary

if TYPE_CHECKING:
    from morembs.parametric.terms import VariedModel


@dataclass(frozen=True, kw_only=True)
class PreloadTable(OptionalTable):
    """``[preload]``: loads in the declared units whose stress stiffens the body before it is reduced."""

    wrench: dict[str, Six] = declare_key("a table { interface = [fx, fy, fz, mx, my, mz] }", {})
    speed: Finite = declare_key("a number (rad/time)", 0.0)
    axis: Three | None = declare_key("the direction of the axis of rotation, [x, y, z]", None)
    point: Three = declare_key("a point of the axis, [x, y, z]", [0.0, 0.0, 0.0])
    acceleration: Three = declare_key("the acceleration of the body less gravity, [x, y, z]", [0.0, 0.0, 0.0])
    held: list[str] = declare_key("names of the interfaces that carry the loads", [])
    follows: list[str] = declare_key("names of the interfaces that the loads turn with", [])

    def refuse_conflicts(self) -> None:
        Preload(**{**self.values(), "held": tuple(self.held), "follows": tuple(self.follows)})


class PreloadStress(JobStage):
    """The stress of the preload in the model, and the problem of that."""

    tables = (PreloadTable,)
    needs = (MODEL, VARIED, INTERFACES, PROBLEM)
    gives = (MODEL, VARIED, PROBLEM)
    step = "preload"

    def refuse_conflicts(self, tables: JobTables) -> None:
        if SubstructureTable.of(tables) and PreloadTable.of(tables) is not None:
            raise InputError(
                "[preload] was given for an assembly of bodies, which have no elements; leave it out", keyword="preload"
            )

    def is_asked(self, job: Job) -> bool:
        return PreloadTable.of(job) is not None

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse loads on nothing, and bodies that carry no stress or are held."""
        preload_of(job).check(facts.interfaces)
        reason = why_no_stiffening(facts.model)
        if reason:
            raise InputError(f"preload: {reason}", kind="unsupported", keyword="preload")
        if rigid != 6 or not has_places(facts.model):
            raise InputError(
                f"preload: the body has {rigid} rigid-body motions; expected a free body with six",
                kind="model",
                keyword="preload",
            )
        return ()

    def run(self, work: Work) -> None:
        preload, varied = preload_of(work.job), work.get(VARIED)
        with work[PROBLEM] as problem:
            found = apply_preload(problem, preload)
            model = found.model
            if varied is not None:
                varied = add_preload(varied, work[MODEL], preload, found)
                model = varied.model(varied.box.nominal)
                work.give(VARIED, varied)
            work.give(MODEL, model)
            work.give(PROBLEM, make_problem(work, model, varied))
        work.recipe |= dict(found.notes)


def add_preload(varied: VariedModel, bare: FEModel, preload: Preload, found: Preloaded) -> VariedModel:
    """``varied`` with the stress of its ``preload``, ``found`` for the ``bare`` model of nominal values.

    Raises:
        InputError: other parameters that change the stress, or loads beyond buckling.
    """
    # Not at the top: most jobs have no parameters.
    from morembs.parametric.added import with_preload

    inertial = preload.axis is not None or any(preload.acceleration)
    for parameter in varied.parameters if inertial else ():
        if parameter.kind == "density":
            raise InputError(
                f"parameter {parameter.name} changes the loads of a [preload] with a speed or an acceleration; leave "
                "one of them out",
                kind="conflict",
            )
    return with_preload(varied, sp.csr_array(found.model.K - bare.K), found.critical_factor)


def preload_of(job: Job) -> Preload:
    """The preload in SI units, of a job that has one."""
    given, units = PreloadTable.require(job), job.units
    force, acceleration = units.mass * units.length / units.time**2, units.length / units.time**2
    scale = [force] * 3 + [force * units.length] * 3
    return Preload(
        wrench={name: [value * s for value, s in zip(f, scale, strict=True)] for name, f in given.wrench.items()},
        speed=given.speed / units.time,
        axis=given.axis,
        point=[units.length * value for value in given.point],
        acceleration=[acceleration * value for value in given.acceleration],
        held=tuple(given.held),
        follows=tuple(given.follows),
    )
