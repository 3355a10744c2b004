"""Limits over a band against dense evaluations, of random transfer functions in modal coordinates."""

import numpy as np
import pytest

from morembs.responses.layout import BlockIndex
from morembs.responses.measures import MEASURES, ReferenceResponse, compare
from morembs.responses.rational import GRID, POINTS, PoleResidueForm, cell_points, on_grid
from morembs.responses.rounding import EPS, Response, RoundoffBound


def standard_and_body(seed, symmetric=True):
    """A standard of 30 modes and a body with 12 of them, a little off, and static corrections."""
    rng = np.random.default_rng(seed)
    k, keep, m = 30, 12, int(rng.choice([1, 2, 3, 6]))
    zeta, off = 10 ** rng.uniform(-6, -1.3), 10 ** rng.uniform(-9, -2)
    omega = np.sort(rng.uniform(300.0, 19000.0, k))
    if seed % 3 == 0:
        omega[5] = omega[4] * (1 + 1e-7)
    b = rng.standard_normal((k, m))
    layout = BlockIndex(m, [slice(0, m // 2), slice(m // 2, m)] if m > 1 else [slice(0, 1)], symmetric)

    def terms(omega, left, right):
        lam = omega**2
        terms = PoleResidueForm.second_order(lam, 2 * zeta * omega, layout.rows(left, right))
        lost = np.sqrt(4 * EPS) * omega
        return Response(terms=terms, rounding=RoundoffBound.of(layout, left, right, lost, lost))

    H = terms(omega, b, b)
    standard = ReferenceResponse(
        H=H.terms,
        modes=H.terms,
        residue_norms=layout.sizes(b),
        rounding=H.rounding,
        layout=layout,
        floor=EPS,
        edges=np.array([0.0, 1e9]),
        cell_uncertainty=np.zeros(1),
    )
    near = omega[:keep] * (1 + 0.5 * off * rng.uniform(0, 1, keep))
    own = b[:keep] * (1 + off * rng.standard_normal((keep, m)))
    rest = np.linalg.qr(b[keep:] / omega[keep:, None])[1]
    far = np.linspace(1.3, 2.0, len(rest)) * omega[keep]
    own, near = np.vstack([own, rest * far[:, None]]), np.concatenate([near, far])
    left = own if symmetric else own * (1 + off * rng.standard_normal(own.shape))
    body = terms(near, left, own)
    high = 0.98 * omega[keep - 1]
    w = [np.linspace(0.0, high, 20_000), *(x * (1 + zeta * np.linspace(-6, 6, 25)) for x in (*omega, *near))]
    w = np.unique(np.concatenate(w))
    return standard, body, high, w[(w >= 0) & (w <= high)]


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_no_value_of_the_band_lies_above_its_limit(seed, symmetric):
    standard, body, high, w = standard_and_body(seed, symmetric)
    limits, blocks, cells = compare(standard, body, 0.0, high)
    assert cells.edges[0, 0] == 0 and cells.edges[-1, 1] == high
    assert np.array_equal(cells.edges[1:, 0], cells.edges[:-1, 1])
    w = np.unique(np.append(w, [2 * np.pi * limit.at_hz for limit in limits.values()]))
    own = np.clip(np.searchsorted(cells.edges[:, 0], w, side="right") - 1, 0, len(cells.edges) - 1)
    E, H = standard.layout.norms(standard.H.at(w) - body.terms.at(w)), standard.layout.norms(standard.H.at(w))[:, 0]
    e = standard.modes.moduli(w)[0] @ standard.residue_norms
    for q, (name, true) in enumerate(
        {"envelope": E[:, 0] / e[:, 0], "peak": E[:, 0] / H.max(), "pointwise": E[:, 0] / H}.items()
    ):
        limit = limits[name]
        assert (true <= cells.upper[own, q] * (1 + 1e-9)).all() and true.max() <= limit.upper, name
        # The frequency of the largest value is one of those above.
        assert limit.lower <= true.max() * (1 + 1e-9), name
        if limit.lower > 1e-7:
            assert limit.upper <= 1.05 * limit.lower, name
    for number, (i, j) in enumerate(standard.layout.pairs):
        true = (E[:, number + 1] / e[:, number + 1]).max()
        assert true <= blocks[i, j] <= 1.08 * true + 1e-9


def test_the_measures_have_names():
    standard, body, high, _ = standard_and_body(1)
    assert tuple(compare(standard, body, 0.0, high)[0]) == MEASURES


def test_the_interpolant_keeps_its_remainder():
    """The difference of function and interpolant stays below the bound, however near the poles are."""
    standard, _, high, _ = standard_and_body(2)
    H = standard.H
    rng = np.random.default_rng(1)
    middle = rng.uniform(0.05, 0.95, 400) * high
    half = 10 ** rng.uniform(-3, -0.2, 400) * H.nearest(middle)
    low, up = middle - half, middle + half
    p = on_grid(H.at(cell_points(low, up, POINTS)))
    off = standard.layout.norms(p - H.at(cell_points(low, up, np.cos(GRID))))[..., 0].max(axis=1)
    size = standard.layout.norms(H.N)[:, :1]
    bound = H.remainder(middle, half, size)[:, 0]
    # Frequencies themselves have round-off, which counts beside a pole.
    noise = (1e-14 + 4 * EPS * middle / H.nearest(middle)) * (H.moduli(middle)[0] @ size)[:, 0]
    assert np.isfinite(bound).any() and (off <= bound + noise).all()
