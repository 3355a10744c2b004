"""Shape functions, quadrature and faces of every element type."""

import math

import numpy as np
import pytest

from morembs.fem.elements import FACES, TYPES

ALL = [*TYPES.values(), *FACES.values()]


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.name)
def test_functions_are_one_at_their_node_and_zero_at_the_others(kind):
    N, _ = kind.shape(kind.reference)
    assert np.abs(N - np.eye(kind.n_nodes)).max() < 1e-13


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.name)
def test_gradients_are_derivatives(kind):
    dim = kind.reference.shape[1]
    points = 0.1 + 0.25 * np.random.default_rng(0).random((6, dim))
    _, dN = kind.shape(points)
    h = 1e-6
    for axis in range(dim):
        step = h * np.eye(dim)[axis]
        difference = (kind.shape(points + step)[0] - kind.shape(points - step)[0]) / (2 * h)
        assert np.abs(difference - dN[:, :, axis]).max() < 1e-8


def exact_integral(domain, a, b, c):
    """Integral of x^a y^b z^c over the unit simplex, cube, or triangle times the unit interval."""
    if domain == "t":
        return math.factorial(a) * math.factorial(b) * math.factorial(c) / math.factorial(a + b + c + 3)
    if domain == "h":
        return 1 / ((a + 1) * (b + 1) * (c + 1))
    return math.factorial(a) * math.factorial(b) / math.factorial(a + b + 2) / (c + 1)


@pytest.mark.parametrize("kind", TYPES.values(), ids=TYPES)
def test_rules_integrate_their_degree(kind):
    """Monomials over the reference domain against their exact integrals."""
    for order in {kind.stiffness_order, kind.mass_order}:
        rule = kind.rule(order)
        assert rule.weights.min() > 0
        if isinstance(order, tuple):
            # Of a wedge: so many in the triangle, and so many along the axis.
            powers = [(a, order[0] - a, c) for a in range(order[0] + 1) for c in range(order[1] + 1)]
        else:
            powers = [(a, b, order - a - b) for a in range(order + 1) for b in range(order + 1 - a)]
        for power in powers:
            value = rule.weights @ np.prod(rule.points**power, axis=1)
            assert value == pytest.approx(exact_integral(kind.name[0], *power), rel=1e-11)
    volume = {"t": 1 / 6, "h": 1.0, "w": 0.5}[kind.name[0]]
    assert kind.rule(kind.stiffness_order).weights.sum() == pytest.approx(volume, rel=1e-13)


@pytest.mark.parametrize("kind", TYPES.values(), ids=TYPES)
def test_face_normals_point_outwards_and_close_the_element(kind):
    """Sum of oriented face areas is zero and their flux of x is three times the volume."""
    total, flux = np.zeros(3), 0.0
    for name, nodes in kind.face_nodes:
        face = FACES[name]
        rule = face.rule(face.mass_order)
        x = kind.reference[nodes]
        tangents = np.einsum("ka,qkr->qra", x, rule.dN)
        dA = np.cross(tangents[:, 0], tangents[:, 1]) * rule.weights[:, None]
        total += dA.sum(axis=0)
        flux += float(np.einsum("qa,qa->", rule.N @ x, dA))
    assert np.abs(total).max() < 1e-13
    assert flux == pytest.approx(3 * {"t": 1 / 6, "h": 1.0, "w": 0.5}[kind.name[0]], rel=1e-12)
