"""Krylov bases against moments and transfer functions of dense solutions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import SolverError
from morembs.certificate.response import full_response, reduced_response
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers.krylov import Krylov
from morembs.responses.loads import inertia_loads
from tests.support.meshes import box, ends, steel, where
from tests.support.refusals import refusal
from tests.support.solvers import CountingSolver


def bar(n=(6, 1, 1)):
    return steel(box("hex20", n, (0.5, 0.05, 0.03)))


def with_dampers(model, ground=False):
    """The model with damping out of proportion: of a material without lateral strain; ``ground`` adds dashpots."""
    D = 3e-6 * steel(box("hex20", (6, 1, 1), (0.5, 0.05, 0.03)), poisson=0.0).K
    if ground:
        rows = 3 * where(model, 0, 0.25)
        D = D + sp.csr_array((np.full(len(rows), 2e4), (rows, rows)), shape=D.shape)
    return replace(model, D=sp.csr_array(D))


def elastic_loads(problem, columns=slice(None)):
    B = problem.B.toarray()[:, columns] * problem.motion_scale[columns]
    return B - problem.M @ problem.rigid @ (problem.rigid.T @ B)


def moments(K, M, B, C, sigma, count):
    """C [-(K + sigma M)^-1 M]^j (K + sigma M)^-1 B for j < count."""
    A = sl.lu_factor(K + sigma * M)
    x, out = sl.lu_solve(A, B), []
    for _ in range(count):
        out.append(C @ x)
        x = -sl.lu_solve(A, M @ x)
    return out


def differences(first, second):
    return np.array([np.linalg.norm(a - b) / np.linalg.norm(a) for a, b in zip(first, second, strict=True)])


@pytest.mark.parametrize("hz,real", [([900.0], []), ([], [4000.0])])
def test_moments_match_once_for_any_output_and_twice_for_the_loads_own(hz, real):
    J = 2
    model = bar()
    with Problem(model, ends(model)) as problem:
        r = Krylov(shifts_hz=hz, real_shifts=real, moments=J).reduce(problem)
        K, M, B = problem.K.toarray(), problem.M.toarray(), elastic_loads(problem)
        sigma = -((2 * np.pi * hz[0]) ** 2) if hz else real[0] ** 2
        C = np.random.default_rng(1).standard_normal((5, len(K)))
        C -= (C @ problem.rigid) @ (M @ problem.rigid).T
        V = r.V[:, 6:]
        for out, matched in ((C, J), (B.T, 2 * J)):
            full = moments(K, M, B, out, sigma, 2 * J + 1)
            reduced_moments = moments(V.T @ K @ V, V.T @ M @ V, V.T @ B, out @ V, sigma, 2 * J + 1)
            error = differences(full, reduced_moments)
            assert error[:matched].max() < 1e-10
            assert error[matched] > 30 * error[:matched].max() and error[matched] > 1e-10
        assert r.order == 6 + J * 12 and np.abs(r.V.T @ M @ r.V - np.eye(r.order)).max() < 1e-13 * r.order


def test_zero_shift_matches_elastic_moments_of_the_free_body():
    """Against the sum over elastic modes, and the flexibility of the bordered system (two ways to it)."""
    model = bar()
    with Problem(model, ends(model)) as problem:
        r = Krylov(moments=2).reduce(problem)
        K, M, Z, B = problem.K.toarray(), problem.M.toarray(), problem.rigid, elastic_loads(problem)
        U = problem.free_free.flexibility(B)
    # Forces and lengths of the border are of the size of the stiffness.
    c = np.abs(K).max() / np.abs(M @ Z).max()
    border = np.block([[K, c * M @ Z], [c * (M @ Z).T, np.zeros((6, 6))]])
    other = np.linalg.solve(border, np.vstack([B, np.zeros((6, B.shape[1]))]))[: len(K)]
    assert np.abs(U - other).max() < 1e-9 * np.abs(other).max()
    values, X = sl.eigh(K, M)
    g = X[:, 6:].T @ B
    V = r.V[:, 6:]
    small, Y = sl.eigh(V.T @ K @ V)
    h = Y.T @ (V.T @ B)
    full, reduced = ([(f / v[:, None] ** (j + 1)).T @ f for j in range(5)] for v, f in ((values[6:], g), (small, h)))
    error = differences(full, reduced)
    assert error[:4].max() < 1e-9
    assert error[4] > 30 * error[:4].max()


def test_damped_transfer_function_is_interpolated_at_the_damped_place():
    damping = Damping(alpha=40.0, beta=3e-6)
    hz = 1500.0
    w2 = (2 * np.pi * hz) ** 2
    model = bar()
    with Problem(model, ends(model), damping=damping) as problem:
        r = Krylov(shifts_hz=[hz]).reduce(problem)
        K, M, B = problem.K.toarray(), problem.M.toarray(), elastic_loads(problem)
    V = r.V[:, 6:]
    D = damping.alpha * M + damping.beta * K
    s = np.roots([1.0, damping.alpha + damping.beta * w2, w2])
    assert s[0].real < 0 < abs(s[0].imag)
    for x in (*s, 2j * np.pi * hz):
        full = B.T @ np.linalg.solve(x * x * M + x * D + K, B)
        reduced_H = B.T @ V @ np.linalg.solve(V.T @ (x * x * M + x * D + K) @ V, V.T @ B)
        error = np.linalg.norm(full - reduced_H) / np.linalg.norm(full)
        assert error > 1e-8 if x == 2j * np.pi * hz else error < 1e-10


@pytest.mark.parametrize("s0", [0.0, 2000.0])
def test_moments_with_general_damping_about_real_points(s0):
    """Taylor coefficients of the elastic part: 2J of them with J blocks."""
    model = with_dampers(bar())
    with Problem(model, ends(model)) as problem:
        reducer = Krylov(moments=2) if s0 == 0 else Krylov(shifts_hz=[], real_shifts=[s0], moments=2)
        r = reducer.reduce(problem)
        B, N = elastic_loads(problem), sl.null_space((problem.M @ problem.rigid).T)
        full = [N.T @ A @ N for A in (problem.M, problem.D, problem.K)]
        matrices = [A[6:, 6:] for A in (r.M, r.D, r.K)]
    assert r.order == 6 + 24
    error = differences(taylor(*full, N.T @ B, s0, 5), taylor(*matrices, r.V[:, 6:].T @ B, s0, 5))
    assert error[:4].max() < 1e-9
    assert error[4] > 30 * error[:4].max()


def taylor(M, D, K, F, s0, count):
    A, E = s0**2 * M + s0 * D + K, 2 * s0 * M + D
    factor = sl.lu_factor(A)
    x = [sl.lu_solve(factor, F)]
    for _ in range(count - 1):
        x.append(-sl.lu_solve(factor, E @ x[-1] + (M @ x[-2] if len(x) > 1 else 0.0)))
    return [F.T @ y for y in x]


@pytest.mark.parametrize("ground", [False, True])
def test_general_damping_is_interpolated_at_a_frequency_and_its_conjugate(ground):
    """Real basis of twice the columns; dashpots to the ground drag the rigid motion along."""
    model = with_dampers(bar(), ground)
    hz = 1500.0
    with Problem(model, ends(model)) as problem:
        r = Krylov(shifts_hz=[hz]).reduce(problem)
        M, D, K, B = (A.toarray() for A in (problem.M, problem.D, problem.K, problem.B))
        B = B * problem.motion_scale
        assert r.order == 6 + 24 and r.V.dtype == float
        for s in (2j * np.pi * hz, -2j * np.pi * hz):
            full = B.T @ np.linalg.solve(s * s * M + s * D + K, B)
            b = r.B * problem.motion_scale
            reduced_H = b.T @ np.linalg.solve(s * s * r.M + s * r.D + r.K, b)
            assert np.linalg.norm(full - reduced_H) < 1e-9 * np.linalg.norm(full)
        if ground:
            with refusal("unsupported", "shifts_hz"):
                Krylov().reduce(problem)


def test_dependent_loads_are_deflated_and_said():
    model = bar()
    doubled = [*ends(model), make_interface(model, name="again", nodes=where(model, 0, 0.5), coupling="average")]
    with Problem(model, doubled) as problem:
        r = Krylov(shifts_hz=[900.0], moments=2).reduce(problem)
        plain = r.recipe["deflated"]
    assert r.order == 6 + 24
    assert plain == ["shift 900 Hz, block 1: 6 columns of the inputs"]


def test_tangential_interpolates_the_chosen_combinations():
    """Four combinations of twelve loads: H b is met for them at the only shift, for other loads it is not."""
    model = bar()
    hz = 1500.0
    with Problem(model, ends(model)) as problem:
        r = Krylov(shifts_hz=[hz], tangential=4).reduce(problem)
        K, M, B = problem.K.toarray(), problem.M.toarray(), elastic_loads(problem)
    s2 = -((2 * np.pi * hz) ** 2)
    V = r.V[:, 6:]
    full = np.linalg.solve(K + s2 * M, B)
    missed = full - V @ np.linalg.solve(V.T @ (K + s2 * M) @ V, V.T @ B)
    size = np.linalg.svd(missed, compute_uv=False) / np.linalg.norm(full, 2)
    assert r.order == 6 + 4 and (size < 1e-10).sum() == 4 and size[7] > 1e-9


def test_tangential_shifts_pay_at_equal_order():
    """Four directions at each of six shifts beat all twelve loads at two."""
    model = bar((8, 1, 1))
    omega = 2 * np.pi * np.linspace(50.0, 4000.0, 80)
    with Problem(model, ends(model), damping=Damping(alpha=5.0, beta=2e-6)) as problem:
        H = full_response(problem, omega)

        def error(reducer):
            r = reducer.reduce(problem)
            assert r.order == 30
            return worst(problem, reduced_response(r, omega), H)

        many = error(Krylov(shifts_hz=[0.0, 800.0, 1600.0, 2400.0, 3200.0, 4000.0], tangential=4))
        cut = error(Krylov(shifts_hz=[0.0, 1500.0, 4000.0], order=24))
        assert max(many, cut) < 0.1 * error(Krylov(shifts_hz=[0.0, 2400.0]))


def worst(problem, reduced, H):
    """Largest relative error in the Frobenius norm, forces and moments scaled."""
    S = np.outer(problem.motion_scale, problem.motion_scale)
    return (np.linalg.norm(S * (reduced - H), axis=(1, 2)) / np.linalg.norm(S * H, axis=(1, 2))).max()


def test_two_sided_matches_the_moments_of_both_chains():
    """One block each: two moments from inputs to outputs; one side alone matches one."""
    model = bar((8, 1, 1))
    hz = 900.0
    with Problem(model, ends(model, tip=0.5, near=0.4375)) as problem:
        both = Krylov(shifts_hz=[hz], two_sided=True, inputs=["tip"], outputs=["near"]).reduce(problem)
        one_sided = Krylov(shifts_hz=[hz], inputs=["tip"]).reduce(problem)
        K, M = problem.K.toarray(), problem.M.toarray()
        B, C = (elastic_loads(problem, problem.coupling.columns[name]) for name in ("tip", "near"))
    assert both.order == one_sided.order == 12 and not both.symmetric
    s2 = -((2 * np.pi * hz) ** 2)
    full = moments(K, M, B, C.T, s2, 3)
    for r, matched in ((both, 2), (one_sided, 1)):
        V = r.V[:, 6:]
        W = V if r.W is None else r.W[:, 6:]
        error = differences(full, moments(W.T @ K @ V, W.T @ M @ V, W.T @ B, C.T @ V, s2, 3))
        assert error[:matched].max() < 1e-10 and error[matched] > 1e-8


def test_two_sided_refuses_what_is_one_sided_or_unstable():
    for names in ({}, {"inputs": ["left"], "outputs": ["left"]}):
        with refusal("conflict", "outputs"):
            Krylov(two_sided=True, **names)
    with refusal("conflict", "outputs", "two_sided"):
        Krylov(outputs=["left"])
    model = steel(box("hex8", (12, 2, 2), (0.5, 0.05, 0.03)))
    with Problem(model, ends(model)) as problem:
        with refusal("conflict", "outputs"):
            Krylov(two_sided=True, inputs=["left", "right"]).reduce(problem)
        asked = {"moments": 2, "shifts_hz": [0.0, 3000.0]}
        with refusal("result", "order", "two_sided", by=SolverError):
            Krylov(two_sided=True, inputs=["left"], outputs=["right"], **asked).reduce(problem)
        # What the message names: stable, and at least as many moments from one end to the other.
        both = Krylov(**asked).reduce(problem)
        V, K, M = both.V[:, 6:], problem.K.toarray(), problem.M.toarray()
        B, C = (elastic_loads(problem, problem.coupling.columns[name]) for name in ("left", "right"))
        assert both.symmetric and both.order == 6 + 48 and np.linalg.eigvalsh(V.T @ K @ V)[0] > 0
        for hz in asked["shifts_hz"][1:]:
            s2 = -((2 * np.pi * hz) ** 2)
            full, reduced = moments(K, M, B, C.T, s2, 4), moments(V.T @ K @ V, V.T @ M @ V, V.T @ B, C.T @ V, s2, 4)
            assert differences(full, reduced).max() < 1e-6


@pytest.mark.parametrize("beside", [0.0, 3e-8])
def test_a_shift_on_an_eigenfrequency_moves_and_says_so(beside):
    """Exactly on it the matrix is singular; a little beside it one mode drowns all others."""
    model = bar()
    with Problem(model, ends(model)) as problem:
        values = sl.eigh(problem.K.toarray(), problem.M.toarray(), eigvals_only=True)
        hz = float(np.sqrt(values[8]) / (2 * np.pi)) * (1 + beside)
        r = Krylov(shifts_hz=[hz]).reduce(problem)
        again = Krylov(shifts_hz=[hz], moments=2).reduce(problem)
        moved = r.recipe["moved_shifts"]
        assert len(moved) == 1 and f"moved to {1.005 * hz:.8g} Hz" in moved[0]
        assert again.recipe["moved_shifts"] == moved
        K, M, B = problem.K.toarray(), problem.M.toarray(), elastic_loads(problem)
        V, s2 = r.V[:, 6:], -((2 * np.pi * 1.005 * hz) ** 2)
        full = np.linalg.solve(K + s2 * M, B)
        assert np.linalg.norm(full - V @ (V.T @ M @ full)) < 1e-9 * np.linalg.norm(full)
        # Rigid-body motion is at 0 Hz: no step of a percent leads away from it.
        with refusal("result", "shifts_hz", by=SolverError):
            Krylov(shifts_hz=[1e-6]).reduce(problem)


def test_one_factorisation_for_each_shift_and_one_analysis_for_all():
    model, solver = bar(), CountingSolver()

    def counted():
        return len(solver.factorisations), solver.analyses.total()

    with Problem(model, ends(model), solver=solver) as problem:
        assert problem.statics.factor is not None
        before = np.array(counted())
        shifts = [0.0, *np.linspace(300.0, 3000.0, 9).tolist()]
        first = Krylov(shifts_hz=shifts, real_shifts=[3000.0], order=20).reduce(problem)
        assert tuple(counted() - before) == (10, 1)
        again = Krylov(shifts_hz=shifts[:4], moments=1).reduce(problem)
        assert tuple(counted() - before) == (10, 1)
        longer = Krylov(shifts_hz=[300.0], moments=3).reduce(problem)
        assert tuple(counted() - before) == (11, 1)
    with Problem(model, ends(model), solver=CountingSolver()) as problem:
        fresh = Krylov(shifts_hz=[300.0], moments=3).reduce(problem)
        short = Krylov(shifts_hz=shifts[:4], moments=1).reduce(problem)
    assert first.order == 26
    assert np.diag(fresh.K)[6:] == pytest.approx(np.diag(longer.K)[6:], rel=1e-7)
    assert np.diag(short.K)[6:] == pytest.approx(np.diag(again.K)[6:], rel=1e-7)


def test_inertia_loads_join_the_basis():
    """Centrifugal loads deform the body as the full model does, statically."""
    model = bar()
    with Problem(model, ends(model)) as problem:
        F = inertia_loads(problem)
        u = problem.free_free.flexibility(F)
        for wanted, reducer in ((True, Krylov(inertia_loads=True)), (False, Krylov())):
            r = reducer.reduce(problem)
            rest = u - r.V @ (r.V.T @ (problem.M @ u))
            assert (np.linalg.norm(rest) < 1e-8 * np.linalg.norm(u)) == wanted


def test_tangential_directions_share_between_interface_and_inertia_loads():
    """Five of 18 loads a shift: no load is far off, as it would be were inertia loads to count by their norm."""
    model = steel(box("hex8", (10, 2, 1), (0.5, 0.05, 0.03)), density=7800.0)
    with Problem(model, ends(model)) as problem:
        reducer = Krylov(shifts_hz=[0.0, 1300.0, 2600.0], tangential=5, moments=2, inertia_loads=True)
        V, K, M = reducer.reduce(problem).V[:, 6:], problem.K.toarray(), problem.M.toarray()
        F = np.hstack([elastic_loads(problem), inertia_loads(problem)])
        for hz in (50.0, 800.0, 1700.0, 2500.0):
            f = 1 + 0.01j, -((2 * np.pi * hz) ** 2)
            u = np.linalg.solve(f[0] * K + f[1] * M, F)
            u -= problem.rigid @ (problem.rigid.T @ (M @ u))
            U = V @ np.linalg.solve(V.T @ (f[0] * K + f[1] * M) @ V, V.T @ F)
            assert (np.linalg.norm(U - u, axis=0) < 1e-2 * np.linalg.norm(u, axis=0)).all()


def test_options_that_make_no_sense_are_refused():
    for options, words in (
        ({"shifts_hz": []}, ("missing", "shifts_hz")),
        ({"shifts_hz": [-1.0]}, ("value", "shifts_hz", "[-1.0]")),
        ({"real_shifts": [0.0]}, ("value", "real_shifts", "[0.0]")),
        ({"moments": 0}, ("value", "moments", "0")),
        ({"moments": [1, 2]}, ("value", "moments", "shifts_hz", "real_shifts")),
        ({"order": 0}, ("value", "order", "0")),
        ({"shifts_hz": [5.0, 5.0]}, ("conflict", "shifts_hz")),
        ({"tangential": 0}, ("value", "tangential", "0")),
        ({"shifts_hz": [np.nan]}, ("value", "shifts_hz", "[nan]")),
    ):
        with refusal(*words):
            Krylov(**options)
    model = bar()
    with Problem(model, ends(model)) as problem:
        for reducer, words in (
            (Krylov(moments=50), ("value", "moments", "600", "234", "tangential")),
            (Krylov(order=13, moments=[1]), ("value", "order", "13", "12")),
            (Krylov(inputs=["lft"]), ("unsupported", "", "'lft'", "'left'")),
        ):
            with refusal(*words):
                reducer.reduce(problem)
        larger = Krylov(order=13).reduce(problem)
        assert larger.order - larger.rigid_count == 13 and larger.recipe["moments"] == 3
        with refusal("result", "", "1e-300", "0.0", "shifts_hz", by=SolverError):
            Krylov(shifts_hz=[], real_shifts=[1e-300]).reduce(problem)
    with Problem(bar()) as problem, refusal("unsupported", "", '"krylov"', "[[interface]]"):
        Krylov().reduce(problem)


def test_free_beam_of_the_literature_to_the_published_accuracy():
    """24 x 2 x 2 elements of 0.5 x 0.05 x 0.03 m, one block at 0 Hz and one at 2000 Hz: about 2.5e-4 to 2600 Hz."""
    model = steel(box("hex8", (24, 2, 2), (0.5, 0.05, 0.03)))
    omega = 2 * np.pi * np.linspace(50.0, 2600.0, 120)
    with Problem(model, ends(model), damping=Damping(alpha=5.0, beta=2e-6)) as problem:
        r = Krylov(shifts_hz=[0.0, 2000.0]).reduce(problem)
        error = worst(problem, reduced_response(r, omega), full_response(problem, omega))
    assert r.order == 6 + 24
    assert 2.5e-4 / 3 < error < 3 * 2.5e-4
