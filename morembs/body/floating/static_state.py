"""The static state of a body under inertia loads and wrenches: what its stress, and so its stiffening, follows from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Floats
from morembs.body.floating.link_stiffness import Links
from morembs.body.floating.tolerances import TOL
from morembs.linalg.statics import ConstrainedStatics
from morembs.parametric.tolerances import TOL as PARAMETRIC
from morembs.problem import Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticState:
    """``u`` (Nc,) m in coupled dofs, rigid motion of a free body of no meaning; ``load`` (Nc,) without reactions.

    ``wrench`` (6 k,) on the frames of all k interfaces, reactions of held ones included; ``turning`` (3, 3) in Nm per
    interface is what turns the coupling (see ``link_stiffness``), none without elements.
    """

    u: Floats
    load: Floats
    wrench: Floats
    turning: Mapping[str, Floats]


def held_columns(problem: Problem, held: Sequence[str]) -> sp.csc_array:
    """All motions (Nc, c) of interfaces with a frame, and the exposed ones of others."""
    coupling = problem.coupling
    return sp.csc_array(
        sp.hstack(
            [
                coupling.frames[:, coupling.frame_columns[name]]
                if name in coupling.frame_columns
                else coupling.B[:, coupling.columns[name]]
                for name in held
            ]
        )
    )


def static_state(problem: Problem, acceleration: Floats, wrench: Floats, held: Sequence[str], what: str) -> StaticState:
    """Static solution under ``wrench`` (6 k,) and the loads -M a of an ``acceleration`` (N,) in m/s2.

    Interfaces ``held`` carry what is not in equilibrium, without any the inertia of the body does. ``what`` names the
    held interfaces in messages.

    Raises:
        InputError: interfaces that do not hold the body.
    """
    model, coupling = problem.model, problem.coupling
    T, wrench = coupling.T, wrench.copy()
    load = coupling.frames @ wrench - T.T @ (model.M @ acceleration)
    inertial = acceleration
    if held:
        u, reaction = ConstrainedStatics(problem.statics, held_columns(problem, held), what).solve(load[:, None])
        at = 0
        for name in held:
            columns = coupling.frame_columns.get(name)
            count = 6 if columns is not None else len(range(*coupling.columns[name].indices(coupling.B.shape[1])))
            if columns is not None:
                wrench[columns] -= reaction[at : at + count, 0]
            at += count
    else:
        u = problem.free_free.flexibility(load[:, None])
        inertial = acceleration + T @ (problem.rigid @ (problem.rigid.T @ load))
    turning: dict[str, Floats] = {}
    if model.mesh is not None:
        links = Links(problem)
        moved = links.turning(np.asarray(T @ u), (links.M @ inertial)[:, None], wrench[:, None])
        turning = {name: A[0] for name, A in moved.items()}
    return StaticState(u=u[:, 0], load=load, wrench=wrench, turning=turning)


def coupling_stiffness(problem: Problem, turning: Mapping[str, Floats]) -> tuple[sp.csr_array, str]:
    """L (N, N) = sum theta' A theta over the interfaces, and what is missing in it, in words."""
    model, left_out = problem.model, []
    L = sp.csr_array((model.size, model.size))
    largest = max((float(np.abs(A).max()) for A in turning.values()), default=0.0)
    for interface in problem.interfaces:
        A = turning.get(interface.name)
        if A is None or np.abs(A).max() <= TOL.negligible_term * largest:
            continue
        theta, dofs = interface.kind.rotation(model, interface)
        if len(dofs) > 3 * PARAMETRIC.max_patch_nodes:
            left_out.append(interface.name)
            continue
        block = theta.T @ A @ theta
        at = (np.repeat(dofs, len(dofs)), np.tile(dofs, len(dofs)))
        L = L + sp.csr_array(sp.coo_array((block.ravel(), at), shape=L.shape))
    words = (
        ""
        if not left_out
        else (
            f"the turning of the frames of {', '.join(left_out)}: average interfaces of more than "
            f"{PARAMETRIC.max_patch_nodes} nodes"
        )
    )
    return sp.csr_array(L), words
