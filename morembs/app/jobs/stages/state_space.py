"""``[state_space]``: a file for control design of one body."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from morembs.app.jobs.job import Job
from morembs.app.jobs.stages.body import BODIES, recommended_body
from morembs.app.jobs.stages.stage import JobStage, Work
from morembs.app.jobs.stages.write import WRITTEN
from morembs.base.errors import InputError, nearest
from morembs.fem import rigid_motion
from morembs.fem.fe_model import STRUCTURAL
from morembs.problem.damping import frequency_domain_only
from morembs.reducers import ProblemSummary


class StateSpace(JobStage):
    """The state space of one body, written beside the body file."""

    tables = ("state_space",)
    needs = (BODIES, WRITTEN)
    gives = (WRITTEN,)

    def is_asked(self, job: Job) -> bool:
        return job.tables.state_space is not None

    def writes(self, job: Job) -> Mapping[str, Path]:
        asked = job.tables.state_space
        return {} if asked is None else {"[state_space] path": job.result(asked.path)}

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse signals that there are not, and supports that leave the part loose."""
        asked = job.tables.state_space
        if asked is None:
            return ()
        # Not at the top: most jobs do without.
        from morembs.exporters.ports import ports_of, refuse_loose
        from morembs.exporters.state_space import signals
        from morembs.exporters.state_space_files import refuse_displacement

        if asked.body is not None and asked.body not in job.reducers:
            raise InputError(f"[state_space] body = {asked.body!r} was given; {nearest(asked.body, job.reducers)}")
        if facts.damping.structural:
            raise InputError(f"[state_space]: {frequency_domain_only({STRUCTURAL: facts.damping.structural})}")
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
        asked = work.job.tables.state_space
        if asked is None:
            return
        # Not at the top: most jobs do without.
        from morembs.exporters.state_space import state_space
        from morembs.exporters.state_space_files import write_state_space

        bodies = work[BODIES]
        with work.watch.more():
            body = recommended_body(bodies) if asked.body is None else next(b for b in bodies if b.name == asked.body)
            system = state_space(body, asked.inputs, asked.outputs, held=asked.held)
            path = work.job.result(asked.path)
            write_state_space(path, system if asked.step is None else system.discrete(asked.step))
