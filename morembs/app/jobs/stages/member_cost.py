"""What the equilibria of a planar member take."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from morembs.app.jobs.tolerances import TOL

if TYPE_CHECKING:
    from morembs.dynamics.nonlinear import NonlinearSolid, PlanarBeam


@dataclass(frozen=True, kw_only=True)
class MemberCost:
    """What a forecast says of a component; ``equilibrium_seconds`` for each equilibrium of its tables."""

    what: str
    solver: str
    nodes: int
    elements: int
    dofs: int
    stiffness_nonzeros: int
    mass_nonzeros: int
    factor_entries: int
    factor_flops: float
    factor_bytes: int
    factor_seconds: float
    equilibrium_seconds: float
    extent: tuple[float, float, float]
    interface_nodes: dict[str, int]


def counts_of(component: PlanarBeam | NonlinearSolid) -> tuple[int, int, int]:
    """Nodes, elements and degrees of freedom."""
    mesh = component.model.mesh if hasattr(component, "model") else None
    if mesh is not None:
        return len(mesh.nodes), mesh.element_count, component.size
    return component.size // 3, component.size // 3 - 1, component.size


def cost_of(component: PlanarBeam | NonlinearSolid) -> MemberCost:
    """Sizes of the component, and times of its tangent and factor as measured now."""
    from morembs.dynamics.nonlinear import PlanarBeam

    nodes, elements, dofs = counts_of(component)
    K = component.tangent(component.reference)
    begin = time.perf_counter()
    component.tangent(component.reference)
    tangent_seconds = time.perf_counter() - begin
    counts = {"nodes": nodes, "elements": elements, "dofs": dofs, "stiffness_nonzeros": K.nnz}
    if isinstance(component, PlanarBeam):
        start, end = component.reference[:2], component.reference[-3:-1]
        return MemberCost(
            **counts,
            what="a chain of beam elements",
            solver="superlu",
            mass_nonzeros=component.M.nnz,
            # Node by node nothing fills in, and each row meets the six before it.
            factor_entries=K.nnz,
            factor_flops=float(36 * dofs),
            factor_bytes=12 * K.nnz,
            factor_seconds=0.0,
            equilibrium_seconds=TOL.tangents_per_equilibrium * tangent_seconds,
            extent=(float(np.hypot(*(end - start))), 0.0, 0.0),
            interface_nodes={"start": 1, "end": 1},
        )
    from morembs.dynamics.nonlinear.continuation import Tangents

    free = np.setdiff1d(np.arange(dofs), np.concatenate(list(component.frames.values())))
    with Tangents(free) as tangents:
        tangents.factor(K)
        # Once more, without the analysis.
        begin = time.perf_counter()
        tangents.factor(K)
        factor_seconds, plan = time.perf_counter() - begin, tangents.forecast
    extent = np.ptp(component.model.nodes.xyz, axis=0).tolist()
    return MemberCost(
        **counts,
        what="a solid in large displacements",
        solver=plan.backend,
        mass_nonzeros=component.model.M.nnz,
        factor_entries=plan.factor_entries,
        factor_flops=plan.flops,
        factor_bytes=plan.memory,
        factor_seconds=factor_seconds,
        equilibrium_seconds=TOL.factors_per_equilibrium * (tangent_seconds + factor_seconds),
        extent=(extent[0], extent[1], extent[2]),
        interface_nodes={name: len(each.nodes) for name, each in component.interfaces.items()},
    )
