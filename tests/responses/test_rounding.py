"""Limits of round-off against couplings and rows that are off by as much as is allowed."""

import numpy as np
import pytest

from morembs.responses.layout import BlockIndex
from morembs.responses.rounding import EPS, RoundoffBound, absorb_couplings, bound_entry_errors


def size_of(layout, X):
    return layout.norms(X[..., layout.i, layout.j] * layout.weight)


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_couplings_of_modes_move_no_block_beyond_its_limit(seed, symmetric):
    """The worst signs too: all couplings at their largest, with the phases of the modes."""
    rng = np.random.default_rng(seed)
    k, m = 12, 5
    a = rng.standard_normal(k) + 1j * 10 ** rng.uniform(-3, 0, k)
    c, off = rng.standard_normal((k, m)), 10 ** rng.uniform(-6, -3)
    b = c if symmetric else rng.standard_normal((k, m))
    layout = BlockIndex(m, [slice(0, 2), slice(2, 5)], symmetric)
    s = off * rng.uniform(0.1, 1, k)
    t = s if symmetric else off * rng.uniform(0.1, 1, k)
    lost = RoundoffBound.of(layout, c, b, s, t, 1e-4 * np.abs(c), 1e-4 * np.abs(b)).at(1 / np.abs(a))
    H = c.T @ (b / a[:, None])
    worst = np.exp(1j * np.angle(a))
    signs = [
        rng.choice([-1.0, 1.0], (k, k)),
        np.outer(np.sqrt(worst), np.sqrt(worst)),
        np.outer(np.sign(c[:, 0] * a.real), np.sign(b[:, 0] * a.real)),
    ]
    for sign in signs:
        sign = np.tril(sign) + np.tril(sign, -1).T if symmetric else sign
        moved = (1 + 1e-4 * sign[:, :1]) * c
        other = moved.T @ np.linalg.solve(np.diag(a) + sign * np.outer(s, t), (1 + 1e-4 * sign[:, :1]) * b)
        assert (size_of(layout, other - H) <= lost.size()).all()
    # What a mode alone may move by is not enough for the worst of them.
    alone = ((np.abs(c) ** 2).sum(axis=1) * s * t / np.abs(a) ** 2).sum()
    assert alone < lost.coupled[0]


def test_beyond_a_resonance_that_round_off_may_reach_there_is_no_limit():
    layout = BlockIndex(1, [slice(0, 1)], True)
    rounding = RoundoffBound.of(layout, np.ones((1, 1)), np.ones((1, 1)), np.array([0.1]), np.array([0.1]))
    below, above = (rounding.at(np.array([omega])).size() for omega in (99.0, 100.0))
    assert np.isfinite(below).all() and np.isinf(above).all()


def test_products_and_what_an_eigensolver_leaves():
    rng = np.random.default_rng(3)
    A = rng.standard_normal((8, 8)) * np.outer(*2 * [10 ** rng.uniform(-3, 3, 8)])
    L, X = rng.standard_normal((2, 8, 5))
    s, t = bound_entry_errors(A, L, X)
    assert ((8 + 4) * EPS * np.abs(L).T @ np.abs(A) @ np.abs(X) <= np.outer(s, t)).all()
    R = 10 ** rng.uniform(-18, -8, (5, 5))
    u, v = absorb_couplings(s, t, R)
    assert (R + np.outer(s, t) <= (1 + 1e-12) * np.outer(u, v)).all()
