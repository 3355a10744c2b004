"""Bodies that spin steadily: the matrices of a frame that turns with the body.

With the unit axis a, its skew matrix a~ and O = a~ at every node, small motions in the frame that turns with W follow
M u'' + (D + 2 W C) u' + (K + W^2 (Kg - S)) u = f with C = M O (Coriolis), S = O'M O (spin softening) and the geometric
stiffness Kg of the centrifugal stress (Geradin and Rixen 1997, ch. 2; Genta 2005, ch. 11). Without Kg a section that
tilts lacks the gyroscopic moment (Ip - It) W^2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.arguments import check_options
from morembs.base.errors import InputError, nearest
from morembs.base.limits import Direction, Vector
from morembs.base.types import Floats
from morembs.body.floating.static_state import coupling_stiffness, static_state
from morembs.body.floating.stiffening_terms import why_no_stiffening
from morembs.fem import FEModel
from morembs.fem.geometric_stiffness import StressedMesh
from morembs.linalg.congruence import congruence
from morembs.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Rotation:
    """Steady rotation about ``axis`` (3,) through ``point`` (3,) m, the interfaces ``held`` at rest in the frame that
    turns. ``stress`` False leaves the centrifugal stress out.

    Raises:
        InputError: numbers that make no axis.

    >>> Rotation(axis=(0, 0, 2)).axis
    (0, 0, 2)
    """

    axis: Direction
    point: Vector = (0.0, 0.0, 0.0)
    held: tuple[str, ...] = ()
    stress: bool = True

    def __post_init__(self) -> None:
        check_options(self, "spin: ")

    def check(self, model: FEModel, names: Sequence[str]) -> None:
        """Refuse a ``model`` without the motions that spin needs, and held interfaces that are not among ``names``.

        Raises:
            InputError: in these cases.
        """
        for name in self.held:
            if name not in names:
                raise InputError(f"spin: held names the interface {name!r}; {nearest(name, names)}", kind="unknown")
        reason = why_no_spin(model)
        if reason:
            raise InputError(f"spin: {reason}", kind="unsupported", keyword="spin")


@dataclass(frozen=True, kw_only=True, eq=False)
class Spin:
    """Matrices (Nc, Nc) in coupled dofs per rad/s (``C``) and per (rad/s)^2 (``S``, ``Kg``), for the ``rotation``.

    ``elongation`` (Nc,) is the static displacement per (rad/s)^2; ``warnings`` say what is left out.
    """

    C: sp.csr_array
    S: sp.csr_array
    Kg: sp.csr_array
    elongation: Floats
    rotation: Rotation
    warnings: tuple[str, ...] = ()


def why_no_spin(model: FEModel) -> str:
    """Why there are no matrices of a frame that turns; "" where there are."""
    if model.G is not None or model.N is not None:
        return "the model has a gyroscopic or circulatory matrix of its own, which is for one speed"
    table = model.dofs.table(len(model.nodes))[:, :3]
    some = (table >= 0).any(axis=1)
    if not some.any() or (table[some] < 0).any():
        return "spin needs x, y and z of every node; this model has nodes without some of them"
    other = np.flatnonzero(model.dofs.component > 2)
    if len(other) and model.M[other].nnz and np.abs(model.M[other].data).max() > 0:
        return "spin needs solid elements or masses that only move; this model has masses that turn"
    return ""


def assemble_spin(problem: Problem, rotation: Rotation) -> Spin:
    """Coriolis matrix, spin softening and centrifugal stiffness of the body of ``problem``.

    Peak memory: three matrices as large as M and one as large as K.

    Args:
        problem: the full model.
        rotation: axis, and held interfaces.

    Raises:
        InputError: a model without translations at its nodes, or held interfaces that do not hold the body.

    >>> from morembs import Rotation, assemble_spin
    >>> spin = assemble_spin(problem, Rotation(axis=(1, 0, 0), held=("LEFT",)))
    >>> bool(abs(spin.C + spin.C.T).max() == 0.0)
    True
    """
    model, T = problem.model, problem.coupling.T
    rotation.check(model, [interface.name for interface in problem.interfaces])
    a = np.asarray(rotation.axis, dtype=float) / np.linalg.norm(rotation.axis)
    turning = _turning(model, a)
    C = sp.csr_array(model.M @ turning)
    C = sp.csr_array(0.5 * (C - C.T))
    S = sp.csr_array(turning.T @ model.M @ turning)
    S = sp.csr_array(0.5 * (S + S.T))
    x = np.zeros(model.size)
    moves = model.dofs.component < 3
    at = model.dofs.node[moves], model.dofs.component[moves]
    x[moves] = (model.nodes.xyz - np.asarray(rotation.point, dtype=float))[at]
    progress.update("spin: static solution")
    none = np.zeros(problem.coupling.frames.shape[1])
    state = static_state(problem, turning @ (turning @ x), none, rotation.held, "the held interfaces of [spin]")
    Kg, warnings = _stress_stiffness(problem, rotation, np.asarray(T @ state.u), state.turning)
    square = T.shape[0] == T.shape[1]
    with problem.budget.in_use():
        C, S, Kg = (A if square else congruence(T, A, skew=skew) for A, skew in ((C, True), (S, False), (Kg, False)))
    return Spin(C=C, S=S, Kg=Kg, elongation=state.u, rotation=rotation, warnings=warnings)


def _turning(model: FEModel, a: Floats) -> sp.csr_array:
    """O (N, N): a x u at every node."""
    skew = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
    table = model.dofs.table(len(model.nodes))[:, :3]
    table = table[(table >= 0).all(axis=1)]
    row, col, value = [], [], []
    for i, j in zip(*np.nonzero(skew), strict=True):
        row.append(table[:, i])
        col.append(table[:, j])
        value.append(np.full(len(table), skew[i, j]))
    if not row:
        return sp.csr_array((model.size, model.size))
    data = np.concatenate(value), (np.concatenate(row), np.concatenate(col))
    return sp.csr_array(sp.coo_array(data, shape=(model.size, model.size)))


def _stress_stiffness(
    problem: Problem, rotation: Rotation, u: Floats, turning: Mapping[str, Floats]
) -> tuple[sp.csr_array, tuple[str, ...]]:
    """Kg (N, N) of the static displacements ``u`` (N,), and what there is to warn of."""
    model = problem.model
    nothing = sp.csr_array(model.K.shape)
    reason = "stress = false" if not rotation.stress else why_no_stiffening(model)
    if reason or model.mesh is None:
        return nothing, (
            f"the centrifugal stress is left out ({reason}): modes that bend or tilt come out wrong by as much as "
            "spin changes them",
        )
    progress.update("spin: geometric stiffness")
    with problem.budget.in_use():
        kg = StressedMesh.of(model.mesh, model.materials).stiffness(u[:, None])[0]
    L, left_out = coupling_stiffness(problem, turning)
    Kg = sp.csr_array(sp.kron(kg, sp.eye_array(3), format="csr") + L)
    return Kg, (f"the centrifugal stiffness lacks {left_out}",) if left_out else ()
