"""Lemke's method against enumeration of all complementary bases, degenerate problems, rays."""

from itertools import product

import numpy as np
import pytest

from morembs.dynamics.multibody.contact.lemke import RayError, lemke
from tests.support.refusals import refusal


def enumerated(M, q):
    """All solutions at complementary bases."""
    solutions, m = [], len(q)
    for choice in product((False, True), repeat=m):
        basic = np.array(choice)
        z = np.zeros(m)
        inner = M[np.ix_(basic, basic)]
        if basic.any():
            if np.linalg.cond(inner) > 1e10:
                continue
            z[basic] = np.linalg.solve(inner, -q[basic])
        w = M @ z + q
        if min(z.min(), w.min()) > -1e-9:
            solutions.append(z)
    return solutions


def check(M, q, solution, tolerance=1e-10):
    w = M @ solution.z + q
    assert min(w.min(), solution.z.min()) > -tolerance
    assert abs(w @ solution.z) < tolerance * max(1.0, np.abs(q).max())
    assert solution.residual < tolerance


@pytest.mark.parametrize("seed", range(40))
def test_p_matrices_have_the_one_solution_of_enumeration(seed):
    rng = np.random.default_rng(seed)
    m = int(rng.integers(1, 8))
    half = rng.standard_normal((m, m))
    skewed = rng.standard_normal((m, m))
    M = half @ half.T + 0.1 * np.eye(m) + (skewed - skewed.T)
    # Units of very different size in one problem.
    units = 10.0 ** rng.integers(-4, 5, m)
    q = rng.standard_normal(m)
    (exact,) = enumerated(M, q)
    solution = lemke(units[:, None] * M * units, units * q)
    assert solution.z * units == pytest.approx(exact, abs=1e-8 * (1 + np.abs(exact).max()))


@pytest.mark.parametrize("seed", range(40))
def test_semidefinite_matrices_are_solved_or_end_on_a_ray_as_enumeration_says(seed):
    rng = np.random.default_rng(100 + seed)
    m = int(rng.integers(3, 8))
    half = rng.standard_normal((m, int(rng.integers(1, m))))
    M, q = half @ half.T, rng.standard_normal(m)
    solutions = enumerated(M, q)
    if not solutions:
        with pytest.raises(RayError) as caught:
            lemke(M, q)
        # The ray is a certificate: M z = 0, z >= 0, q'z < 0.
        z = caught.value.direction
        assert z.min() >= 0 and z.max() > 0
        assert np.abs(M @ z).max() < 1e-8 * z.max() and q @ z < 0
        return
    solution = lemke(M, q)
    check(M, q, solution)
    # w is the same in all solutions of a semidefinite problem.
    assert solution.w == pytest.approx(M @ solutions[0] + q, abs=1e-8)


def test_the_sample_of_semidefinite_problems_has_both_ends():
    ends = set()
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        m = int(rng.integers(3, 8))
        half = rng.standard_normal((m, int(rng.integers(1, m))))
        ends.add(bool(enumerated(half @ half.T, rng.standard_normal(m))))
    assert ends == {True, False}


def test_a_degenerate_problem_in_which_plain_ratio_tests_tie():
    # Many equal contacts that carry one weight, and rows with q = 0.
    W = np.ones((6, 1))
    q = np.array([-1.0, -1.0, -1.0, -1.0, 0.0, 0.0])
    solution = lemke(W @ W.T, q)
    check(W @ W.T, q, solution)
    assert solution.z.sum() == pytest.approx(1.0)
    # Murty's example of exponential pivots is degenerate with q = -1 in all rows.
    m = 8
    M = np.tril(2 * np.ones((m, m)), -1) + np.eye(m)
    check(M, -np.ones(m), lemke(M, -np.ones(m)))


def test_ties_are_broken_by_the_lexicographic_rule():
    """Plain ratio tests cycle here: all rows tie (Kostreva 1979)."""
    M = np.array([[1.0, 2, 0], [0, 1, 2], [2, 0, 1]])
    assert lemke(M, -np.ones(3)).z == pytest.approx(np.ones(3) / 3)


def friction(mu, weight, push, mass=2.0):
    """A block on a plane with a pyramid of two facets: normal force, two friction forces, slip."""
    N = np.zeros((4, 4))
    D = np.array([1.0, -1.0])
    N[0, 0] = 1 / mass
    N[1:3, 1:3] = np.outer(D, D) / mass
    N[1:3, 3] = 1.0
    N[3] = [mu, -1.0, -1.0, 0.0]
    return N, np.array([-weight / mass, push / mass, -push / mass, 0.0])


@pytest.mark.parametrize("push", [-9.0, -4.9, 0.0, 4.9, 9.0])
def test_coulomb_friction_sticks_or_slips(push):
    z = lemke(*friction(0.5, 10.0, push)).z
    assert z[0] == pytest.approx(10.0)
    held = np.clip(-push, -5.0, 5.0)
    assert z[1] - z[2] == pytest.approx(held, abs=1e-12)
    assert z[3] == pytest.approx(max(abs(push) - 5.0, 0.0) / 2.0, abs=1e-12)


def test_nothing_to_do_and_empty_problems():
    assert lemke(np.eye(2), [1.0, 0.0]).z == pytest.approx([0.0, 0.0])
    assert lemke(np.zeros((0, 0)), np.zeros(0)).z.size == 0


def test_bad_input():
    with refusal("value", "A"):
        lemke(np.eye(3), [1.0, 2.0])
    with refusal("value", "A"):
        lemke([[np.nan]], [1.0])
    with refusal("result", by=RayError):
        lemke([[0.0]], [-1.0])
