"""Refusals of stiffness matrices: mechanisms, the geometry of another model, supports and modes hidden by round-off."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError, MorembsError, SingularMatrixError, SolverError
from morembs.base.types import Floats
from morembs.fem import FEModel
from morembs.fem.fe_model import has_places
from morembs.fem.interface import Coupling
from morembs.fem.mass import mass_properties
from morembs.fem.rigid_residual import share_of_other_geometry
from morembs.linalg.congruence import scaled_row_sums
from morembs.linalg.eigen import Modes
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.statics import Statics
from morembs.problem.system import System
from morembs.problem.tolerances import TOL

SOFTER = (
    "make stiff links and penalty springs softer (a thousand times the stiffness of the parts that they join is rigid "
    "enough) or replace them by rigid couplings, or leave a soft support to the simulation"
)


def refuse_lost_supports(statics: Statics, M: sp.csr_array) -> None:
    """Refuse a factor that does not give back the rigid motions that K holds from their own forces.

    Raises:
        SolverError: in these cases.
    """
    motions = statics.held_motions
    if not motions.shape[1]:
        return
    change = statics.apply(statics.multiply_supported(motions)) - motions
    # The motions are M-orthonormal.
    lost = float(np.sqrt(np.linalg.norm(change.T @ (M @ change), 2)))
    if not lost <= TOL.lost_digits:
        raise SolverError(
            f"the body is held so softly that its static motion on the supports comes out wrong by {lost:.1e} "
            f"(needed {TOL.lost_digits:.0e}): round-off of the stiff parts hides its digits; {SOFTER}"
        )


def refuse_lost_modes(modes: Modes, roundoff: Floats, what: str) -> None:
    """Refuse ``modes`` of whose eigenvalues ``roundoff`` (k,) in (rad/s)2 leaves less than three digits.

    Raises:
        SolverError: in these cases.
    """
    error = TOL.usual_roundoff * roundoff
    lost = np.flatnonzero(error > TOL.lost_digits * modes.eigenvalues)
    if len(lost):
        k = int(lost[np.argmax(error[lost] / np.maximum(modes.eigenvalues[lost], np.finfo(float).tiny))])
        raise SolverError(
            f"round-off in the stiffness matrix hides {len(lost)} of the {what}: that at "
            f"{modes.frequencies_hz[k]:.6g} Hz has a stiffness of {modes.eigenvalues[k]:.3g} (rad/s)2, known to "
            f"{error[k]:.1e} only (needed {TOL.lost_digits:.0e} of it); {SOFTER}"
        )


def refuse_other_geometry(model: FEModel, coupling: Coupling, system: System, held_motions: Floats) -> None:
    """Refuse coordinates or dofs that are not those of K: they strain it, and it has other motions without energy.

    ``held_motions`` (Nc, h) are the rigid motions that K holds.

    Raises:
        InputError: in these cases.
    """
    if not held_motions.shape[1] or model.dependent is not None or not has_places(model):
        return
    share = share_of_other_geometry(model.K, model.nodes, model.dofs)
    if not share:
        return
    # Frames of interfaces may hold what they do not fit.
    lower = sp.csr_array(model.K - _shift_above_roundoff(coupling, system, model.K, held_motions[:, :0]) * model.M)
    try:
        count = _solver(system).negative_eigenvalues(lower, "K - sigma M")
    except SingularMatrixError:
        return
    if count > system.rigid.shape[1]:
        raise InputError(
            f"the stiffness matrix K does not fit the geometry: rigid motion strains it at {share:.0%} of the dofs "
            f"and {count} other motions have no energy; check that coordinates and dof map belong to these "
            "matrices, in this order; morembs.body.diagnostics.examine_model(model) says more",
            kind="model",
            keyword="K",
        )


def why_singular(coupling: Coupling, system: System) -> str:
    """Message for a stiffness with more zero-energy motions than the rigid ones."""
    free = system.rigid.shape[1]
    sigma = _shift_above_roundoff(coupling, system, system.K, system.rigid)
    try:
        solver = _solver(system)
        negative = solver.negative_eigenvalues(system.stiffness.shift(-sigma), "K + sigma M")
        count = solver.negative_eigenvalues(system.stiffness.shift(sigma), "K - sigma M")
    except MorembsError:
        return (
            "the stiffness matrix is singular beyond its rigid-body modes: a mechanism, or a body so slender or so "
            "far from its interface points that double precision does not resolve it; check the mesh and the units"
        )
    if negative:
        return (
            f"the stiffness matrix has {negative} negative eigenvalues: the body buckles or diverges under its "
            "load, speed or flow; lower that below the critical one (complex modes of the full model are computed "
            "above it too)"
        )
    if count <= free:
        return "the stiffness matrix is singular to working precision; check the units and the material"
    return (
        f"the model has a mechanism: {count} rigid-body modes were found where {free} are expected; look for parts "
        "that touch in a node or an edge only, nodes that should be merged, or coordinates that are not those of the "
        "matrices"
    )


def _solver(system: System) -> LinearSolver:
    return system.stiffness.solver.with_memory(system.space.budget.bytes_left())


def _shift_above_roundoff(coupling: Coupling, system: System, K: sp.csr_array, Z: Floats) -> float:
    """A shift far above the round-off of ``K`` in motions ``Z``, so far below every elastic mode of a sound part.

    Without any such motion: the round-off in a translation of all rows.
    """
    weights = scaled_row_sums(K)
    if Z.shape[1]:
        lost = float(np.einsum("i,ij,ij->j", weights, Z, Z).max())
    else:
        mass = mass_properties(system.M, coupling.R, coupling.pole)[0]
        lost = float(weights.sum() / (mass if mass > 0 else system.M.diagonal().max(initial=0.0) or 1.0))
    return TOL.mechanism_shift * float(np.finfo(float).eps) * lost
