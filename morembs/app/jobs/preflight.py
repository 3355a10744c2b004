"""What is refused or warned of before a job factorises: one pass for ``check`` and for ``reduce``."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from morembs.app.jobs.inputs import (
    body_options,
    preload_of,
    refuse_reductions_that_do_not_fit,
    rotation_of,
    solver_of,
    units_of,
    wants_modes,
)
from morembs.app.jobs.job import Job
from morembs.base.budget import UNLIMITED, Budget
from morembs.base.errors import BudgetError, InputError, enough_megabytes, nearest
from morembs.base.progress import duration_words
from morembs.body.build import BodyOptions
from morembs.body.diagnostics.warnings import examined, examined_mesh
from morembs.body.floating.frame import check_frame
from morembs.body.floating.spinning_modes import refuse_damping
from morembs.body.floating.stiffening_terms import why_no_stiffening
from morembs.fem import FEModel, rigid_motion
from morembs.fem.fe_model import STRUCTURAL, has_places
from morembs.fem.interface import Coupling, Interface
from morembs.fem.selection import select_nodes
from morembs.linalg.sparse.select import lacks
from morembs.linalg.statics import COUNT_BYTES, COUNT_COLUMNS
from morembs.problem.damping import frequency_domain_only
from morembs.reducers import Facts
from morembs.reducers.cost import mode_seconds, response_seconds
from morembs.reducers.facts import Shifted

# Interface degrees of freedom beyond which methods that follow all responses take minutes.
MANY_INTERFACE_DOFS = 60
# Part of the dofs, and count, beyond which modes are no reduction any more or take very long.
MANY_MODES, MOST_MODES = 0.1, 1000
# Frequencies of a picture where no [response] asks for others.
BAND_POINTS = 400
# Models that take seconds whatever is asked of them.
SMALL = 3000
# What stays resident of a job when all that can rest does: bytes, and columns as long as there are dofs; measured. Of
# the bytes this much is there before modes are counted, and so much more takes the smallest count.
RESTING_BYTES, RESTING_COLUMNS = 70_000_000, 12
LOADED_BYTES, LEAST_COUNT = 16_000_000, 6_000_000


def require_room(job: Job, start: int, dofs: int, least: Callable[[], int]) -> None:
    """Refuse a memory budget that ``job`` with a model of ``dofs`` exceeds whatever it does.

    Args:
        start: resident memory of the process before any model was read.
        least: tells a budget that will do for the job.

    Raises:
        BudgetError: as said.
    """
    beside = resting_bytes(dofs)
    if wants_modes(job):
        count = COUNT_BYTES + LEAST_COUNT + 8 * COUNT_COLUMNS * dofs
        beside = max(beside, beside - RESTING_BYTES + LOADED_BYTES + count)
    needed = start + beside
    if job.memory is not None and job.memory < needed:
        enough = max(needed, least())
        raise BudgetError(
            f"[solver]: memory = {job.memory / 1e6:.0f} MB is below what this program itself needs: {start / 1e6:.0f} "
            f"MB before it reads a model, and {beside / 1e6:.0f} MB for what has to stay in memory of a job of this "
            f"size; give at least {enough_megabytes(enough)} MB",
            needed=enough,
        )


def resting_bytes(dofs: int) -> int:
    """What a job with ``dofs`` keeps in memory even when all that can rest does."""
    return RESTING_BYTES + RESTING_COLUMNS * 8 * dofs


def model_warnings(job: Job, model: FEModel, budget: Budget = UNLIMITED) -> tuple[str, ...]:
    """Warnings about the model of ``job``: about its units where it is meshed, about its matrices where they came.

    Raises:
        InputError: matrices that no reduction takes.
    """
    if job.tables.model.mesh is None:
        return examined(model, budget=budget)
    return examined_mesh(model, units_of(job))


def preflight(job: Job, facts: Facts, rigid: int) -> tuple[str, ...]:
    """Warnings about what the reductions of ``job`` will cost; ``rigid`` is the number of rigid-body motions.

    Raises:
        InputError: whatever ``reduce`` would refuse after the factorisation, as far as it can be told before.
    """
    _refuse_preload(job, facts.model, facts.interfaces, rigid)
    _refuse_spin(job, facts, rigid)
    refuse_reductions_that_do_not_fit(job, facts)
    _refuse_solver(job, facts)
    _refuse_delivery(job, body_options(job), facts.model, facts.coupling, rigid)
    _refuse_state_space(job, facts, rigid)
    return (*_many_motions(job, facts), *_many_modes(job, facts.size))


def shifted_of(job: Job, facts: Facts) -> dict[str, Shifted]:
    """What is factorised beside K, by the words for what asks for it."""
    tables = job.tables
    wanted = {f"[[reduce]] {name!r}": reducer.shifted(facts) for name, reducer in job.reducers.items()}
    for key in ("certify", "response"):
        if (asked := getattr(tables, key)) is not None:
            wanted[f"[{key}]"] = facts.at_frequencies(asked.points)
    if job.picture is not None and tables.certify is None and tables.response is None and facts.inputs:
        wanted["the picture"] = facts.at_frequencies(BAND_POINTS)
    return {words: each for words, found in wanted.items() for each in found}


def _refuse_solver(job: Job, facts: Facts) -> None:
    """Refuse a solver that does not take what is factorised beside K."""
    solver = type(solver_of(job))
    for words, each in shifted_of(job, facts).items():
        takes = f"it takes {' or '.join(solver.structures)} ones"
        reason = lacks(solver, each.structure) if each.structure in solver.structures else takes
        if reason:
            raise InputError(
                f"[solver]: solver = {solver.name!r} was given, and {words} factorises {each.structure} matrices "
                f'({reason}); take name = "auto" and no ranks'
            )


def _refuse_preload(job: Job, model: FEModel, interfaces: Sequence[Interface], rigid: int) -> None:
    load = preload_of(job)
    if load is None:
        return
    load.check(interfaces)
    reason = why_no_stiffening(model)
    if reason:
        raise InputError(f"preload: {reason}")
    if rigid != 6 or not has_places(model):
        raise InputError(f"preload: the body has {rigid} rigid-body motions; expected a free body with six")


def _refuse_spin(job: Job, facts: Facts, rigid: int) -> None:
    given = rotation_of(job)
    if given is None:
        return
    given[0].check(facts.model, [interface.name for interface in facts.interfaces])
    refuse_damping(facts.damping, rigid)
    for name, reducer in job.reducers.items():
        if reducer.two_sided:
            raise InputError(f"[spin]: the body {name!r} comes from a two-sided reduction; spin needs a one-sided one")


def _refuse_state_space(job: Job, facts: Facts, rigid: int) -> None:
    """Refuse signals that there are not, and supports that leave the part loose."""
    asked = job.tables.state_space
    if asked is None or job.state_space is None:
        return
    # Not at the top: most jobs do without.
    from morembs.exporters.ports import ports_of, refuse_loose
    from morembs.exporters.state_space import signals
    from morembs.exporters.state_space_files import refuse_displacement

    if asked.body is not None and asked.body not in job.reducers:
        raise InputError(f"[state_space] body = {asked.body!r} was given; {nearest(asked.body, job.reducers)}")
    if facts.damping.structural:
        raise InputError(f"[state_space]: {frequency_domain_only({STRUCTURAL: facts.damping.structural})}")
    refuse_displacement(job.state_space, asked.inputs)
    nodes = facts.model.nodes
    ports = ports_of(facts.interfaces, facts.coupling.columns, nodes.ids, nodes)
    _, supports = signals(ports, asked.inputs, asked.outputs, asked.held)
    if supports and rigid == 6:
        points = np.array([port.point for port in ports])
        moved = rigid_motion(points - points.mean(axis=0), np.array([port.component for port in ports]))
        refuse_loose(ports, sorted(supports), moved)


def _refuse_delivery(job: Job, wanted: BodyOptions, model: FEModel, coupling: Coupling, rigid: int) -> None:
    """Refuse what the bodies cannot carry."""
    check_frame(wanted.kind, wanted.interfaces, list(coupling.frame_columns))
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
            f"[frame], [envelope] and [stiffening]: the model has {places}{rigid} rigid-body motions; a floating frame "
            "needs a free body with six (leave supports to the simulator)"
        )
    if job.tables.output.nodes == "skin" and model.mesh is None:
        raise InputError('nodes = "skin" needs elements; this model has matrices only, take "all" or "interfaces"')
    if wanted.stress is None:
        return
    if model.mesh is None:
        raise InputError("[stress]: this model has matrices only, and stress needs elements; leave [stress] out")
    if wanted.stress.nodes not in ("skin", "all"):
        try:
            select_nodes(model, wanted.stress.nodes, length=wanted.stress.length)
        except InputError as error:
            raise InputError(f"[stress]: {error}") from error


def _many_motions(job: Job, facts: Facts) -> list[str]:
    if facts.inputs <= MANY_INTERFACE_DOFS:
        return []
    took = {
        repr(name): reducer.seconds(facts) or 0.0 for name, reducer in job.reducers.items() if reducer.follows_responses
    }
    compared = [f"[{key}]" for key in ("certify", "response") if getattr(job.tables, key) is not None]
    took |= {name: response_seconds(facts.size, facts.inputs) for name in compared}
    if not took:
        return []
    words = ", ".join(f"{name} about {duration_words(seconds)}" for name, seconds in took.items())
    return [
        f"the responses to all {facts.inputs} interface degrees of freedom are followed, which takes long: {words} at "
        "the speed of this machine now, within a factor of three. Give the interface a rigid or average coupling (6 "
        'degrees of freedom), or take method = "craig-bampton" with interface_up_to_hz and no [certify]'
    ]


def _many_modes(job: Job, size: int) -> list[str]:
    warnings = []
    for name, reducer in job.reducers.items():
        modes = reducer.mode_count
        if size > SMALL and modes > min(MANY_MODES * size, MOST_MODES):
            took = duration_words(mode_seconds(size, modes, 0))
            warnings.append(
                f"[[reduce]] {name!r}: modes = {modes:,} of {size:,} dofs are many; to find them takes about {took} at "
                "the speed of this machine now, within a factor of three; ask for tens to a few hundred, or give "
                "up_to_hz two to three times the highest frequency of interest"
            )
    return warnings
