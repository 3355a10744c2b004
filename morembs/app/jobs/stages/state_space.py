"""``[state_space]``: a file for control design of one body."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from morembs.app.jobs.stages.body import recommended_body
from morembs.app.jobs.stages.spin import SpinTable
from morembs.app.jobs.stages.stage import BODIES, JobStage, Work
from morembs.app.jobs.stages.write import WRITTEN
from morembs.app.jobs.tables import Job, JobTables, OptionalTable
from morembs.base.errors import InputError, nearest
from morembs.base.key_tables import declare_key
from morembs.base.limits import length, number, text
from morembs.fem import rigid_motion
from morembs.fem.fe_model import STRUCTURAL
from morembs.problem.damping import frequency_domain_only
from morembs.reducers import ProblemSummary


@dataclass(frozen=True, kw_only=True)
class StateSpaceTable(OptionalTable):
    """``[state_space]``: a file for control design of one body."""

    path: Annotated[str, text("the path of a .npz or .mat file", r"\.(npz|mat)$")]
    inputs: Annotated[list[str], length('inputs such as ["base:acceleration", "tip:force:z"]', 1, sys.maxsize)]
    outputs: Annotated[list[str], length('outputs such as ["base:reaction", "tip:displacement"]', 1, sys.maxsize)]
    held: list[str] = declare_key("names of the interfaces at rest", [])
    step: Annotated[float, number("a step in s for the zero-order hold", gt=0, lt=1e12)] | None = None
    body: str | None = declare_key("the name of a reduction", None)


class StateSpace(JobStage):
    """The state space of one body, written beside the body file."""

    tables = (StateSpaceTable,)
    needs = (BODIES, WRITTEN)
    gives = (WRITTEN,)

    def refuse_conflicts(self, tables: JobTables) -> None:
        if SpinTable.of(tables) is not None and StateSpaceTable.of(tables) is not None:
            raise InputError(
                "[state_space] was given beside [spin], but would be of the body at rest; leave one out",
                kind="conflict",
                keyword="state_space",
            )

    def is_asked(self, job: Job) -> bool:
        return StateSpaceTable.of(job) is not None

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {"[state_space] path": job.result(StateSpaceTable.require(job).path)}

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse signals that there are not, and supports that leave the part loose."""
        asked = StateSpaceTable.require(job)
        # Not at the top: most jobs do without.
        from morembs.exporters.ports import ports_of, refuse_loose
        from morembs.exporters.state_space import signals
        from morembs.exporters.state_space_files import refuse_displacement

        if asked.body is not None and asked.body not in job.reducers:
            raise InputError(
                f"[state_space] body = {asked.body!r} was given; {nearest(asked.body, job.reducers)}",
                kind="unknown",
                keyword="body",
            )
        if facts.damping.structural:
            raise InputError(
                f"[state_space]: {frequency_domain_only({STRUCTURAL: facts.damping.structural})}", keyword="state_space"
            )
        refuse_displacement(job.result(asked.path), asked.inputs)
        nodes = facts.model.nodes
        ports = ports_of(facts.interfaces, facts.coupling.columns, nodes.ids, nodes)
        _, supports = signals(ports, asked.inputs, asked.outputs, asked.held)
        if supports and rigid == 6:
            points = np.array([port.point for port in ports])
            moved = rigid_motion(points - points.mean(axis=0), np.array([port.component for port in ports]))
            refuse_loose(ports, sorted(supports), moved)
        return ()

    def run(self, work: Work) -> None:
        asked = StateSpaceTable.require(work.job)
        # Not at the top: most jobs do without.
        from morembs.exporters.state_space import state_space
        from morembs.exporters.state_space_files import write_state_space

        bodies = work[BODIES]
        with work.watch.more():
            body = recommended_body(bodies) if asked.body is None else next(b for b in bodies if b.name == asked.body)
            system = state_space(body, asked.inputs, asked.outputs, held=asked.held)
            path = work.job.result(asked.path)
            write_state_space(path, system if asked.step is None else system.discrete(asked.step))
