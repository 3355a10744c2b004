"""Static condensation that inertia corrects, against dense matrices by the definitions of the papers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.types import Floats
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import Guyan, ImprovedReducedSystem
from tests.support.frames import clamped_beam
from tests.support.meshes import box, ends, steel
from tests.support.refusals import refusal


def bar() -> FEModel:
    return steel(box("hex20", (5, 1, 1), (0.5, 0.05, 0.03)))


def by_definition(K: Floats, M: Floats, B: Floats, steps: int) -> Floats:
    """The basis (N, m): G_i is taken on an orthonormal basis of the motions that leave the interfaces at rest."""
    N = sl.null_space(B.T)
    held = N @ np.linalg.solve(N.T @ K @ N, N.T)
    unit = np.linalg.pinv(B.T)
    Psi = unit - held @ (K @ unit)
    V = Psi
    for _ in range(steps):
        V = Psi + held @ (M @ V) @ np.linalg.solve(V.T @ M @ V, V.T @ K @ V)
    return V


@pytest.mark.parametrize("steps", [1, 2, 4])
@pytest.mark.parametrize("coupling", ["rigid", "average", "direct"])
def test_the_basis_is_that_of_the_definition(coupling: str, steps: int) -> None:
    model = bar()
    with Problem(model, ends(model, coupling)) as problem:
        K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
        reduced = ImprovedReducedSystem(steps=steps).reduce(problem)
    V = by_definition(K, M, B, steps)
    np.testing.assert_allclose(reduced.V, V, atol=1e-7 * np.abs(V).max())
    np.testing.assert_allclose(reduced.M, V.T @ M @ V, atol=1e-7 * np.abs(reduced.M).max())
    np.testing.assert_allclose(reduced.K, V.T @ K @ V, atol=1e-7 * np.abs(reduced.K).max())
    assert reduced.recipe["steps"] == steps and reduced.order == B.shape[1]
    np.testing.assert_array_equal(reduced.C, np.eye(reduced.order))


def test_frequencies_converge_from_above_to_those_of_the_model() -> None:
    model = bar()
    with Problem(model, ends(model, "rigid")) as problem:
        full = sl.eigh(problem.K.toarray(), problem.M.toarray(), eigvals_only=True)[6:]
        bodies = [Guyan().reduce(problem), *(ImprovedReducedSystem(steps=k).reduce(problem) for k in (1, 2, 5, 15))]
    values = np.array([body.modes()[0][6:] for body in bodies])
    # The interfaces show four bending modes, one of torsion and one along the axis: each the lowest of its symmetry.
    found = full[np.argmin(np.abs(full - values[-1][:, None]), axis=1)]
    assert len(set(found.tolist())) == 6 and (found[:4] == full[:4]).all()
    errors = values / found - 1
    assert (errors > -1e-9).all() and (np.diff(errors, axis=0) <= 1e-9).all() and errors[-1].max() < 1e-7
    assert errors[0].min() > 0.1 and errors[1].max() < 5e-3 and errors[2].max() < 1e-3


@pytest.mark.parametrize(
    ("cells", "size", "error"), [((5, 1, 1), (0.5, 0.05, 0.03), 1e-9), ((6, 6, 1), (0.5, 0.5, 0.03), 2e-4)]
)
def test_steps_end_before_modes_that_interfaces_do_not_see_grow_from_round_off(cells, size, error) -> None:
    model = steel(box("hex20", cells, size))
    with Problem(model, ends(model, "rigid")) as problem:
        full = sl.eigh(problem.K.toarray(), problem.M.toarray(), eigvals_only=True)[6:]
        reduced = ImprovedReducedSystem(steps=100).reduce(problem)
        Psi = Guyan().reduce(problem).V
    values = reduced.modes()[0][6:]
    found = full[np.argmin(np.abs(full - values[:, None]), axis=1)]
    assert len(set(found.tolist())) == 6 and np.abs(values / found - 1).max() < error
    assert reduced.recipe["steps"] == 100 and 5 <= reduced.recipe["steps_made"] < 30
    # After 100 steps the others had taken over: 24 and 60 times as large as the motions of the interfaces.
    assert np.abs(reduced.V - Psi).max() < 0.5 * np.abs(Psi).max()


def test_two_masses_by_hand() -> None:
    """k = 3 N/m from the ground to 2 kg and on to 1 kg; the first is the interface: 0.8787 rad2/s2 exactly."""
    K, M = sp.csr_array([[6.0, -3.0], [-3.0, 3.0]]), sp.diags_array([2.0, 1.0], format="csr")
    nodes = Nodes(ids=np.array([1, 2]), xyz=np.array([[0.0, 0, 0], [1.0, 0, 0]]))
    model = FEModel(K=K, M=M, nodes=nodes, dofs=DofMap(node=np.array([0, 1]), component=np.array([0, 0])))
    first = make_interface(model, name="first", nodes=np.array([0]), coupling="direct")
    with Problem(model, [first]) as problem:
        reduced = ImprovedReducedSystem().reduce(problem)
    # Static condensation has V = (1, 1), M = 3 kg, K = 3 N/m; the inertia of the second mass, 1 kg times 1 /s2, then
    # strains the second spring by 1/3 m.
    np.testing.assert_allclose(reduced.V[:, 0], [1.0, 4 / 3], rtol=1e-14)
    np.testing.assert_allclose(reduced.M, [[2.0 + 16 / 9]], rtol=1e-14)
    np.testing.assert_allclose(reduced.K, [[3.0 + 3 / 9]], rtol=1e-14)
    assert 3 - np.sqrt(4.5) < reduced.modes()[0][0] < 0.8824 < 1.0


def test_interfaces_without_mass_and_steps_without_end_are_refused() -> None:
    beam = clamped_beam(6)
    # Rotations have no inertia.
    model = replace(beam, M=sp.diags_array(np.where(beam.dofs.component < 3, beam.M.diagonal(), 0.0), format="csr"))
    tip = make_interface(model, name="tip", nodes=np.array([5]), coupling="direct")
    with Problem(model, [tip]) as problem, refusal("model", "method", "irs"):
        ImprovedReducedSystem().reduce(problem)
    for steps in (0, 10**9):
        with refusal("value", "steps", "100", steps):
            ImprovedReducedSystem(steps=steps)
