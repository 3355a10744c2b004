"""Complex modes of full models that spin, and reduced bodies that have them over a range of speeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats
from morembs.body.floating.spin import ReducedSpin, whirl_modes
from morembs.body.floating.spinning import Spin
from morembs.body.floating.static_state import held_columns
from morembs.linalg.complex_modes import ComplexModes, complex_modes
from morembs.linalg.statics import single_dof_rows
from morembs.problem import Damping, Problem
from morembs.reducers.base import ReducedModel


def spinning_modes(
    problem: Problem, spin: Spin, speed: float, count: int, *, start: Floats | None = None
) -> ComplexModes:
    """The lowest complex modes of the full model at ``speed`` rad/s, vectors (Nc, count) in coupled dofs.

    >>> from morembs import Rotation, assemble_spin, spinning_modes
    >>> with Problem(model, interfaces) as undamped:
    ...     spin = assemble_spin(undamped, Rotation(axis=(1, 0, 0), held=("LEFT",)))
    ...     spinning_modes(undamped, spin, 100.0, 4).eigenvalues.real.tolist()
    [0.0, 0.0, 0.0, 0.0]

    Args:
        problem: the full model.
        spin: of ``assemble_spin``.
        speed: in rad/s.
        count: number of modes.
        start: columns (Nc, k) that the search starts from.

    Raises:
        InputError: held interfaces of average coupling, or a body that nothing holds.
    """
    C = 2 * speed * spin.C if speed else None
    K = sp.csr_array(problem.K + speed**2 * (spin.Kg - spin.S))
    return _held_modes(problem, spin.rotation.held, K, C, count, start)


def still_modes(problem: Problem, held: Sequence[str], count: int) -> ComplexModes:
    """The lowest complex modes of the full model with its damping, interfaces ``held`` at rest."""
    for name in held:
        if name not in problem.coupling.columns:
            raise InputError(
                f"[modes]: held names the interface {name!r}; {nearest(name, problem.coupling.columns)}",
                kind="unknown",
                keyword="modes",
            )
    return _held_modes(problem, held, problem.K, None, count, None)


def _held_modes(
    problem: Problem, held: Sequence[str], K: sp.csr_array, G: sp.csr_array | None, count: int, start: Floats | None
) -> ComplexModes:
    rows = single_dof_rows(held_columns(problem, held)) if held else np.empty(0, dtype=np.int64)
    if rows is None:
        raise InputError("complex modes need held interfaces of rigid or direct coupling; one of those held is neither")
    if problem.rigid.shape[1] and not len(rows):
        raise InputError(
            f"complex modes need a body that is held; this one has {problem.rigid.shape[1]} rigid-body motions: name "
            'the interfaces that hold it with held = ["NAME"], in a job in the table [modes]',
            kind="model",
            keyword="held",
        )
    free = np.ones(problem.K.shape[0], dtype=bool)
    free[rows] = False
    rest, damping = np.flatnonzero(free), problem.damping
    refuse_damping(damping, problem.rigid.shape[1])
    D = problem.D
    if damping.is_rayleigh:
        proportional = damping.alpha * problem.M + damping.beta * problem.K
        D = proportional if D is None else D + proportional
    if problem.G is not None:
        G = problem.G if G is None else G + problem.G
    K, M = (sp.csr_array(A[rest][:, rest]) for A in (K, problem.M))
    G, D, N = (None if A is None else sp.csr_array(A[rest][:, rest]) for A in (G, D, problem.N))
    modes = complex_modes(
        K, M, G=G, D=D, N=N, count=count, solver=problem.solver, start=None if start is None else start[rest]
    )
    vectors = np.zeros((len(free), count), dtype=complex)
    vectors[rest] = modes.vectors
    return replace(modes, vectors=vectors)


def refuse_damping(damping: Damping, rigid: int) -> None:
    """Refuse damping that no sparse matrix of the full model with ``rigid`` rigid-body motions holds.

    Raises:
        InputError: in these cases.
    """
    if damping.is_modal or damping.structural:
        raise InputError(
            "complex modes take rayleigh damping or a damping matrix of the model; modal and structural damping are "
            "known for real modes or in the frequency domain only"
        )
    if damping.alpha and rigid:
        raise InputError(
            f"rayleigh alpha = {damping.alpha:g} damps the elastic motion of a free body only, and modes of a held one "
            "have rigid motion too; take beta alone, or give the model a damping matrix",
            kind="unsupported",
        )


def modes_over_speed(problem: Problem, spin: Spin, speeds: Sequence[float], count: int) -> dict[float, ComplexModes]:
    """``spinning_modes`` at each of the ``speeds`` in rad/s, ascending, each begun with those before."""
    full: dict[float, ComplexModes] = {}
    near: Floats | None = None
    for speed in sorted({float(speed) for speed in speeds}):
        progress.update(f"complex modes at {speed:g} rad/s")
        full[speed] = spinning_modes(problem, spin, speed, count, start=near)
        near = _parts([full[speed]])
    return full


def with_spin(
    problem: Problem, reduced: ReducedModel, spin: Spin, full: Mapping[float, ComplexModes]
) -> tuple[ReducedModel, ReducedSpin]:
    """``reduced`` with the real and imaginary parts of ``full`` complex modes at the lowest, the middle and the highest
    of their speeds in rad/s, and its spin. The recipe compares its modes at all these speeds with the full ones.

    Raises:
        InputError: a reduction with matrices that are not symmetric.
    """
    if not reduced.symmetric or not reduced.is_projection:
        raise InputError(
            "[spin] needs a one-sided reduction, whose matrices are symmetric; take another method",
            kind="unsupported",
            keyword="spin",
        )
    speeds, space = sorted(full), problem.space
    chosen = sorted({speeds[0], speeds[len(speeds) // 2], speeds[-1]})
    larger = _enrich_basis(problem, reduced, _parts([full[speed] for speed in chosen]))
    held = held_columns(problem, spin.rotation.held) if spin.rotation.held else sp.csc_array((problem.K.shape[0], 0))
    C = space.dot(larger.V, np.asarray(spin.C @ larger.V))
    small = ReducedSpin(
        C=0.5 * (C - C.T),
        S=space.project(larger.V, spin.S),
        Kg=space.project(larger.V, spin.Kg),
        held=np.asarray(held.T @ larger.V),
        elongation=spin.elongation,
        axis=np.asarray(spin.rotation.axis, dtype=float) / np.linalg.norm(spin.rotation.axis),
        point=np.asarray(spin.rotation.point, dtype=float),
        speeds=np.array(speeds),
    )
    compared, complete = {}, {}
    for speed, modes in full.items():
        count = len(modes.eigenvalues)
        own = whirl_modes(larger.M, larger.K, larger.D, small, speed, count).eigenvalues
        compared[f"{speed:g}"] = float(np.abs(own / modes.eigenvalues - 1).max())
        complete[f"{speed:g}"] = modes.verified_below or modes.no_count
    notes = {"spin_modes_from": chosen, "spin_mode_deviation": compared, "spin_complete_below": complete}
    return replace(larger, recipe={**larger.recipe, **notes}), small


def _parts(modes: Sequence[ComplexModes]) -> Floats:
    return np.hstack([part for each in modes for part in (each.vectors.real, each.vectors.imag)])


def _enrich_basis(problem: Problem, reduced: ReducedModel, X: Floats) -> ReducedModel:
    """``reduced`` with what span(X) (Nc, j) adds to its basis."""
    space, V, n = problem.space, reduced.V, reduced.order
    Q = space.multiply(V, np.linalg.inv(np.linalg.cholesky(reduced.M)).T)
    added = space.complement(Q, X)
    whole = space.hstack(V, added)
    M, K = space.project(whole, problem.M), space.project(whole, problem.K)
    # What the method knows exactly stays as it is.
    M[:n, :n], K[:n, :n] = reduced.M, reduced.K
    rigid = np.linalg.lstsq(whole.T @ (problem.M @ whole), whole.T @ (problem.M @ problem.rigid), rcond=None)[0]
    D = problem.damping.matrix(M, K, rigid)
    if problem.D is not None:
        D = D + space.project(whole, problem.D)
    C = np.hstack([reduced.C, np.asarray(problem.B.T @ added)])
    kinds = (*reduced.mode_kind, *("elastic",) * added.shape[1])
    return replace(reduced, V=whole, M=M, K=K, D=D, B=C.T, C=C, mode_kind=kinds)
