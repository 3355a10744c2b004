"""Loads that responses are followed for, at the interfaces and of the inertia of a frame, and what each counts."""

from __future__ import annotations

import numpy as np

from morembs.base.types import Floats
from morembs.problem import Problem
from morembs.responses.tolerances import TOL


def unit_loads(problem: Problem, inertia: bool = False) -> Floats:
    """Unit interface loads (Nc, p) and the inertia loads behind them, if wanted."""
    B = problem.B.toarray()
    return problem.space.hstack(B, inertia_loads(problem)) if inertia else B


def elastic_part(problem: Problem, F: Floats) -> Floats:
    """``F`` (Nc, p), overwritten, without what the inertia of rigid motion balances."""
    Z = problem.rigid
    F -= problem.M @ (Z @ (Z.T @ F))
    return F


def static_response(problem: Problem) -> Floats:
    """G_e B (Nc, m): elastic displacements under unit interface loads, solved for once. Not to be changed."""
    return problem.compute_once("static response", problem.static_response)


def inertia_loads(problem: Problem) -> Floats:
    """Loads (Nc, j) of a moving frame on the elastic part, M a for the accelerations a that deform the body.

    Accelerated translation and rotation deform a body that is held somewhere (they are balanced by its rigid
    motion where it is free), centrifugal terms e_a x (e_b x x) deform any body (methods of Schwertassek and
    Wallrapp 1999). Columns that do not deform it are left out.
    """
    model, coupling = problem.model, problem.coupling
    x, along = model.nodes.xyz[model.dofs.node] - coupling.pole, model.dofs.component
    own = np.where(along < 3, x[np.arange(len(x)), np.minimum(along, 2)], 0.0)
    fields = [(along == a) * x[:, a] - own for a in range(3)]
    fields += [(along == a) * x[:, b] + (along == b) * x[:, a] for a, b in ((0, 1), (1, 2), (2, 0))]
    loads = np.hstack([problem.M @ coupling.R, coupling.T.T @ (model.M @ np.column_stack(fields))])
    norms = np.linalg.norm(loads, axis=0)
    elastic = elastic_part(problem, loads)
    return np.asarray(elastic[:, np.linalg.norm(elastic, axis=0) > TOL.rigid_load * norms])


def load_scale(units: Floats, F: Floats, G: Floats) -> Floats:
    """Factors (p,) by which loads ``F`` (n, p) of different units count alike; ``G`` (n, p) are their displacements.

    Interface loads, which come first, take ``units`` (m,), those of ``Problem.motion_scale``: moments count as forces
    at the radius of gyration. Each inertia load behind them then gets the static energy of an average interface load.
    Energy, because it depends neither on units nor on the mesh: the norm of a load that is spread over all nodes falls
    with their number. The average, because loads of both kinds then share a basis by their numbers; as stiff directions
    have next to no energy, it is the soft ones that set it.
    """
    m, scale = len(units), np.ones(F.shape[1])
    scale[:m] = units
    energy = np.einsum("ij,ij->j", F, G) * scale**2
    scale[m:] = np.sqrt((energy[:m].mean() if m else 1.0) / energy[m:])
    return scale
