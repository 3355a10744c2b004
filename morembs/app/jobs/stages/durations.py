"""Time of a whole job: what each stage takes for being there and for each degree of freedom, and its linear algebra.

Python's share is measured with one loop on every machine, as the rates of the BLAS are.
"""

from __future__ import annotations

from collections.abc import Mapping

from morembs.app.jobs.stages.forecast import Cost
from morembs.app.jobs.stages.stage import select_stages
from morembs.app.jobs.tables import Job
from morembs.linalg.sparse.threads import machine_slowness
from morembs.reducers import ProblemSummary

START = "start"
# Seconds of a step, and seconds for each 1000 degrees of freedom, on a machine of the usual speed of Python: fitted to
# the processor time of jobs of benchmarks/job_times.py. "start" is that of the interpreter and of what it loads, "spin
# modes" that of one speed.
STEPS: Mapping[str, tuple[float, float]] = {
    START: (2.0, 0.0),
    "read": (0.05, 0.0025),
    "assemble": (0.03, 0.008),
    "preload": (0.02, 0.05),
    "couple parts": (0.05, 0.1),
    "couple": (0.03, 0.012),
    "spin": (0.1, 0.02),
    "factorise": (0.04, 0.008),
    "reduce": (0.04, 0.022),
    "spin modes": (0.02, 0.13),
    "certify": (0.2, 0.005),
    "compare": (0.03, 0.012),
    "deliver": (0.01, 0.006),
    "response": (0.14, 0.02),
    "write": (0.11, 0.004),
    "witness": (0.07, 0.01),
    "effective mass": (0.005, 0.0001),
    "draw": (0.95, 0.005),
}


def known_seconds(job: Job, facts: ProblemSummary, factor_entries: int) -> dict[str, float]:
    """Time of the linear algebra of each step of a job, as far as known."""
    found = (stage.seconds(job, facts, factor_entries) for stage in select_stages(job))
    return {name: seconds for known in found for name, seconds in known.items()}


def stage_seconds(job: Job, facts: ProblemSummary, cost: Cost, known: Mapping[str, float]) -> dict[str, float]:
    """Time of each step of a job with such a ``cost``, in s; ``known`` is that of its linear algebra."""
    seconds = {START: least_seconds(START, facts.size)}
    counts: dict[str, int] = {}
    for stage in select_stages(job):
        names = stage.named_steps(job)
        for name in names:
            seconds[name] = seconds.get(name, 0.0) + least_seconds(name, facts.size)
        if names and (
            shifts := sum(each.count for found in stage.plan_factorisations(job, facts).values() for each in found)
        ):
            counts[names[-1]] = shifts
    for name, more in [("factorise", cost.seconds), *known.items()]:
        seconds[name] = seconds.get(name, 0.0) + more
    for name, count in counts.items():
        seconds[name] += cost.shift.seconds * count / sum(counts.values())
    return seconds


def least_seconds(name: str, size: int) -> float:
    """Time of a step in a job of ``size`` dofs without its linear algebra, at the speed of this machine, in s."""
    # Each reduction is a step with its own name; stages of other packages say all of their time by ``seconds``.
    once, each = STEPS.get(name) or STEPS.get(name.partition(" ")[0]) or (0.0, 0.0)
    return (once + each * size / 1000) * machine_slowness()
