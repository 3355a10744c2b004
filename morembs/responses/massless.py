"""Motions of interfaces that deform the body and move no mass: no reduced model with mass can follow them.

Forces on dofs without mass, such as moments about a beam with lumped masses, may deform nothing but such dofs. The
static displacement X y = G_e B y of such loads has stiffness, y'X'K X y > 0, and no inertia, y'X'M X y = 0. It is the
part of the response at infinite frequency, of which a body with mass has none.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.linalg.dense import symmetric
from morembs.linalg.null_space import groups_of, null_space
from morembs.problem import Problem
from morembs.responses.loads import static_response
from morembs.responses.tolerances import TOL

NAMES = ("x", "y", "z", "rotation x", "rotation y", "rotation z", "scalar")


def loaded_without_mass(problem: Problem) -> tuple[str, ...]:
    """Motions of interfaces whose loads act on motions of nodes without mass; nothing is factorised."""
    touched = np.flatnonzero(np.diff(sp.csr_array(problem.B).indptr))
    if not len(touched):
        return ()
    _, label = groups_of(problem.M)
    small = np.bincount(label) <= TOL.massless_group
    rows = np.flatnonzero(np.isin(label, np.unique(label[touched][small[label[touched]]])))
    Z = null_space(sp.csr_array(problem.M[rows][:, rows]), problem.solver)
    work = np.abs(problem.B[rows].T @ Z).max(axis=1, initial=0.0)
    return tuple(name for name, moved in zip(_names(problem), work > TOL.no_flexibility, strict=True) if moved)


def massless_motions(problem: Problem) -> tuple[str, ...]:
    """Each combination of loads that deforms the body and moves no mass, by the motions of interfaces that it moves.

    Peak memory: the static response (Nc, m), which stays with the problem, and its product with M.
    """
    return problem.compute_once(
        "motions without mass", lambda: _massless(problem) if loaded_without_mass(problem) else ()
    )


def _massless(problem: Problem) -> tuple[str, ...]:
    X, scale = static_response(problem), problem.motion_scale
    A = scale[:, None] * (problem.B.T @ X) * scale
    G = scale[:, None] * (X.T @ (problem.M @ X)) * scale
    d = np.sqrt(np.maximum(np.diag(A), 0.0))
    d = np.where(d > TOL.no_flexibility * d.max(initial=0.0), d, np.inf)
    values, U = sl.eigh(symmetric(A) / np.outer(d, d))
    elastic = values > TOL.no_flexibility
    W = U[:, elastic] / np.sqrt(values[elastic]) / d[:, None]
    share, Y = sl.eigh(W.T @ symmetric(G) @ W)
    # Each dof alone has at most as much mass per stiffness as the lowest mode.
    stiff = problem.K.diagonal()
    alone = np.divide(problem.M.diagonal(), stiff, out=np.zeros_like(stiff), where=stiff > 0)
    none = share <= TOL.no_mass * max(float(share.max(initial=0.0)), float(alone.max(initial=0.0)))
    names, moved = _names(problem), np.abs(_reduce_to_echelon(A @ W @ Y[:, none]))
    return tuple(
        " with ".join(name for name, size in zip(names, column, strict=True) if size >= TOL.named_motion * column.max())
        for column in moved.T
    )


def _reduce_to_echelon(X: Floats) -> Floats:
    """Columns (m, k) with the span of those of ``X``, in echelon form: each has an entry where no other has one.

    Which vectors an eigensolver gives of a multiple eigenvalue is chance; these do not depend on it.
    """
    _, R, pivots = sl.qr(X.T, mode="economic", pivoting=True)
    k = X.shape[1]
    order = np.argsort(pivots[:k])
    out = np.empty_like(X)
    out[pivots] = np.linalg.solve(R[:, :k], R).T[:, order]
    return out


def refuse_massless(problem: Problem) -> None:
    """Refuse responses to loads of which none moves any mass.

    Raises:
        InputError: in these cases.
    """
    motions = massless_motions(problem)
    if motions and len(motions) == problem.B.shape[1]:
        raise InputError(
            f"the model has no response but a static one: {massless_words(motions)}", kind="model", keyword="mass"
        )


def massless_words(motions: tuple[str, ...]) -> str:
    """What is said of bodies whose interfaces have such ``motions``."""
    return (
        f"{len(motions)} motions of the interfaces deform the body without moving any mass ({'; '.join(motions)}): the "
        "displacement that static loads give them cannot be part of a reduced model, in which mass resists every "
        "motion, and no limit of its error holds there; give their dofs mass (rotary inertia), or leave them out of "
        "the interface (components = [...])"
    )


def without_mass_perhaps(problem: Problem) -> tuple[str, ...]:
    """The warning that a reduction has ``massless_motions``, or may have: in large models they take a factorisation."""
    loaded = loaded_without_mass(problem)
    if not loaded:
        return ()
    if problem.K.shape[0] <= TOL.quickly_factorised:
        motions = massless_motions(problem)
        return (massless_words(motions),) if motions else ()
    return (
        f"interfaces load dofs without mass ({', '.join(loaded)}): what such loads deform without moving any mass, as "
        "torsion of a beam with lumped masses, cannot be part of a reduced model; shells seldom have such motions, and "
        "a reduction says whether there is one; give these dofs mass (rotary inertia), or leave them out of the "
        "interface (components = [...])",
    )


def _names(problem: Problem) -> tuple[str, ...]:
    names = [""] * problem.B.shape[1]
    for interface in problem.interfaces:
        columns = np.arange(len(names))[problem.coupling.columns[interface.name]]
        motions, _ = interface.kind.columns(interface)
        for column, motion in zip(columns.tolist(), motions.tolist(), strict=True):
            names[column] = f"{interface.name} {NAMES[motion]}"
    return tuple(names)
