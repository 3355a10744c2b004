"""What is refused or warned of before a job factorises: one pass for ``check`` and for ``reduce``."""

from __future__ import annotations

from collections.abc import Sequence

from morembs.body.build import Delivery
from morembs.budget import UNLIMITED, Budget
from morembs.diagnostics.warnings import examined, examined_mesh
from morembs.errors import BudgetError, InputError, enough_megabytes, nearest
from morembs.floating.frame import check_frame
from morembs.floating.stiffening_terms import why_no_stiffening
from morembs.interface import Coupling, Interface
from morembs.jobs.duration import duration_words, mode_seconds, response_seconds
from morembs.jobs.inputs import (
    WITH_RESPONSES,
    check_candidates,
    damping_of,
    delivery_of,
    modelling,
    preload_of,
    refuse_reductions_that_do_not_fit,
    units_of,
    wants_modes,
)  # fmt: skip
from morembs.jobs.job import Job
from morembs.linalg.statics import COUNT_BYTES, COUNT_COLUMNS
from morembs.model import FEModel
from morembs.model.selection import select_nodes
from morembs.problem.damping import Damping
from morembs.reducers import Balanced, Gramian, Irka, Krylov, Reducer, StaticModesSwitching
from morembs.responses.damped_reference import DENSE

# Interface motions beyond which methods that follow all responses take minutes.
MANY_MOTIONS = 60
# Part of the dofs, and count, beyond which modes are no reduction any more or take very long.
MANY_MODES, MOST_MODES = 0.1, 1000
# Models that take seconds whatever is asked of them.
SMALL = 3000
# What stays resident of a job when all that can rest does: bytes, and columns as long as there are dofs; measured. Of
# the bytes this much is there before modes are counted, and so much more takes the smallest count.
RESTING_BYTES, RESTING_COLUMNS = 70_000_000, 12
LOADED_BYTES, LEAST_COUNT = 16_000_000, 6_000_000
# Variants of balanced truncation with one space for trial and test.
ONE_SIDED = ("fv", "pv")


def require_room(job: Job, start: int, dofs: int = 0) -> None:
    """Refuse a memory budget that ``job`` with a model of ``dofs`` exceeds whatever it does.

    Args:
        start: resident memory of the process before any model was read.

    Raises:
        BudgetError: as said.
    """
    beside = resting_bytes(dofs)
    if wants_modes(job):
        count = COUNT_BYTES + LEAST_COUNT + 8 * COUNT_COLUMNS * dofs
        beside = max(beside, beside - RESTING_BYTES + LOADED_BYTES + count)
    needed = start + beside
    if job.memory is not None and job.memory < needed:
        raise BudgetError(
            f"[solver]: memory = {job.memory / 1e6:.0f} MB is below what this program itself needs: {start / 1e6:.0f} "
            f"MB before it reads a model, and {beside / 1e6:.0f} MB for what has to stay in memory of the smallest "
            f"such job; give at least {enough_megabytes(needed)} MB",
            needed=needed,
        )


def resting_bytes(dofs: int) -> int:
    """What a job with ``dofs`` keeps in memory even when all that can rest does."""
    return RESTING_BYTES + RESTING_COLUMNS * 8 * dofs


def model_warnings(job: Job, model: FEModel, budget: Budget = UNLIMITED) -> tuple[str, ...]:
    """Warnings about the model of ``job``: about its units where it is meshed, about its matrices where they came.

    Raises:
        InputError: matrices that no reduction takes.
    """
    if job.tables.model.file is not None:
        return examined(model, budget=budget)
    return examined_mesh(model, units_of(job))


def preflight(
    job: Job, model: FEModel, interfaces: Sequence[Interface], coupling: Coupling, rigid: int
) -> tuple[str, ...]:
    """Warnings about what the reductions of ``job`` will cost.

    Args:
        model: nodes, dofs, mesh and materials are looked at; K and M may be empty.
        rigid: number of rigid-body motions.

    Raises:
        InputError: whatever ``reduce`` would refuse after the factorisation, as far as it can be told before.
    """
    size, inputs = coupling.T.shape[1], coupling.B.shape[1]
    _refuse_preload(job, model, interfaces, rigid)
    check_candidates(job, model, interfaces)
    refuse_reductions_that_do_not_fit(job, size, inputs)
    _refuse_interfaces_of_krylov(job, coupling)
    _refuse_damping(job, damping_of(job), model.D is not None, size)
    _refuse_delivery(job, delivery_of(job), model, coupling, rigid)
    return (*_many_motions(job, size, inputs), *_many_modes(job, size))


def _refuse_preload(job: Job, model: FEModel, interfaces: Sequence[Interface], rigid: int) -> None:
    load = preload_of(job)
    if load is None:
        return
    load.check(interfaces)
    reason = why_no_stiffening(model)
    if reason:
        raise InputError(f"preload: {reason}")
    if rigid != 6:
        raise InputError(f"preload: the body has {rigid} rigid-body motions; expected a free body with six")


def _refuse_interfaces_of_krylov(job: Job, coupling: Coupling) -> None:
    for name, reducer in modelling(job).items():
        if isinstance(reducer, Krylov):
            for key, given in (("inputs", reducer.inputs), ("outputs", reducer.outputs)):
                for one in given or []:
                    if one not in coupling.columns:
                        raise InputError(
                            f"[[reduce]] {name!r}: {key} name the interface {one!r}, which there is not; "
                            f"{nearest(one, list(coupling.columns))}"
                        )


def _refuse_damping(job: Job, damping: Damping, own: bool, size: int) -> None:
    """Refuse reductions and comparisons for which the damping has no meaning; ``own``: the model has a matrix D."""
    for name, reducer in modelling(job).items():
        reason = why_not_with(reducer, damping, own, size)
        if reason:
            raise InputError(f"[[reduce]] {name!r}: {reason}")
    compared = [key for key in ("certify", "response") if getattr(job.tables, key) is not None]
    reason = _why_no_response(damping, own, size)
    if compared and reason:
        raise InputError(f"[{compared[0]}]: {reason}")


def _why_no_response(damping: Damping, own: bool, size: int) -> str:
    """Why the full model has no frequency response; "" where it has one."""
    if not own or not (damping.is_modal or (damping.is_rayleigh and size > DENSE)):
        return ""
    kind = "modal" if damping.is_modal else "Rayleigh"
    return (
        f"{kind} damping beside a damping matrix of the model has no frequency response here; add alpha M + beta K to "
        "the matrix, or leave one of them out"
    )


def why_not_with(reducer: Reducer, damping: Damping, own: bool, size: int) -> str:
    """Why ``reducer`` does not take this damping of ``size`` coupled dofs; "" where it does.

    ``own`` says that the model has a damping matrix.
    """
    method = f'method "{reducer.method}"'
    follows = reducer.method in WITH_RESPONSES
    whole_band = isinstance(reducer, Balanced) and reducer.band_hz is None
    if isinstance(reducer, Balanced) and own:
        if not whole_band:
            return "band_hz needs proportional damping, and this model has its own damping matrix; leave band_hz away"
        if damping.is_modal:
            return f"{method} takes a damping matrix of the model or modal damping, not both; leave one of them out"
    elif follows:
        # Direct solutions take Rayleigh damping beside a matrix at no size.
        direct = isinstance(reducer, Gramian) and reducer.direct
        reason = _why_no_response(damping, own, DENSE + 1 if direct else size)
        if reason:
            return f"{method}: {reason}"
    if damping.structural and (whole_band or isinstance(reducer, Irka)):
        return (
            f"{method} needs viscous damping, and structural damping has no matrix; replace it by rayleigh or modal "
            'damping, or take method = "gramian"'
        )
    if whole_band and damping.is_modal and not all(ratio for _, ratio in damping.steps):
        return (
            f"{method} integrates over all resonances, and the modal damping table leaves some undamped; give "
            "band_hz = [lower, upper], or no ratio of zero"
        )
    if whole_band and not own and not damping.is_viscous:
        return (
            f"{method} integrates over all resonances, which are infinite without damping; add [damping], or give "
            'band_hz = [lower, upper], or take method = "gramian"'
        )
    if isinstance(reducer, Gramian) and reducer.direct and damping.is_modal:
        return f"{method}: modal damping is known mode by mode only; take direct = false"
    return ""


def is_two_sided(reducer: Reducer) -> bool:
    """Whether the equations are tested with another space than that of the coordinates."""
    if isinstance(reducer, Krylov):
        return reducer.two_sided
    return isinstance(reducer, Balanced) and reducer.variant not in ONE_SIDED


def _refuse_delivery(job: Job, wanted: Delivery, model: FEModel, coupling: Coupling, rigid: int) -> None:
    """Refuse what the bodies cannot carry."""
    check_frame(wanted.kind, wanted.interfaces, list(coupling.frame_columns))
    reason = why_no_stiffening(model) if wanted.stiffening is not None else ""
    if reason:
        raise InputError(f"[stiffening]: {reason}")
    asked = wanted.kind != "mean-axes" or wanted.stiffening is not None or wanted.envelope is not None
    for name, reducer in modelling(job).items():
        if is_two_sided(reducer) and isinstance(job.reducers[name], StaticModesSwitching):
            raise InputError(
                f"[[reduce]] {name!r}: static modes switching needs a symmetric constant basis; leave two_sided out"
            )
        if asked and is_two_sided(reducer):
            raise InputError(
                f"[frame], [envelope] and [stiffening]: the body {name!r} comes from a two-sided reduction, whose "
                "matrices are not symmetric; a floating frame needs a one-sided one"
            )
    if asked and rigid != 6:
        raise InputError(
            f"[frame], [envelope] and [stiffening]: the model has {rigid} rigid-body motions; a floating frame needs "
            "a free body with six (leave supports to the simulator)"
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


def _many_motions(job: Job, size: int, inputs: int) -> list[str]:
    if inputs <= MANY_MOTIONS:
        return []
    took = {
        repr(name): response_seconds(size, inputs, reducer.method)
        for name, reducer in modelling(job).items()
        if reducer.method in WITH_RESPONSES
    }
    compared = [f"[{key}]" for key in ("certify", "response") if getattr(job.tables, key) is not None]
    took |= {name: response_seconds(size, inputs) for name in compared}
    if not took:
        return []
    words = ", ".join(f"{name} about {duration_words(seconds)}" for name, seconds in took.items())
    return [
        f"the responses to all {inputs} interface motions are followed, which takes long: {words} at the speed of this "
        "machine now, within a factor of three. Give the interface a rigid or average coupling (6 motions), or take "
        'method = "craig-bampton" with interface_up_to_hz and no [certify]'
    ]


def _many_modes(job: Job, size: int) -> list[str]:
    found = []
    for name, reducer in modelling(job).items():
        modes = getattr(reducer, "modes", None) or 0
        if size > SMALL and modes > min(MANY_MODES * size, MOST_MODES):
            took = duration_words(mode_seconds(size, modes, 0))
            found.append(
                f"[[reduce]] {name!r}: modes = {modes:,} of {size:,} dofs are many; to find them takes about {took} at "
                "the speed of this machine now, within a factor of three; ask for tens to a few hundred, or give "
                "up_to_hz two to three times the highest frequency of interest"
            )
    return found
