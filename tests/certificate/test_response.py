"""Frequency responses against direct solves of the full model."""

import numpy as np
import pytest

from morembs.base.errors import InputError
from morembs.base.progress import listening
from morembs.certificate.response import full_response, reduced_response
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, Modal
from tests.support.meshes import box, steel, where

OMEGA = 2 * np.pi * np.linspace(20.0, 3000.0, 25)


@pytest.mark.parametrize("coupling", ["rigid", "average"])
def test_full_response_solves_the_damped_equations(coupling):
    model = steel(box("hex20", (8, 1, 1), (0.5, 0.05, 0.03)))
    interfaces = [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling=coupling) for n, x in (("l", 0.0), ("r", 0.5))
    ]
    damping = Damping(alpha=5.0, beta=2e-6)
    with Problem(model, interfaces, damping=damping) as problem:
        H = full_response(problem, OMEGA)
        K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
        elastic = B - M @ problem.rigid @ (problem.rigid.T @ B)
        for k in (0, 7, 13, 24):
            w = OMEGA[k]
            A = (1 + 1j * w * damping.beta) * K + (1j * w * damping.alpha - w**2) * M
            direct = B.T @ np.linalg.solve(A, elastic)
            d = 1 / np.sqrt(np.abs(np.diag(direct)))
            assert np.abs(d[:, None] * (H[k] - direct) * d).max() < 1e-7
        # The same matrices seen through a complete basis give the same response.
        everything = Modal(modes=K.shape[0] - 6).reduce(problem)
        mine = reduced_response(everything, OMEGA)
        assert np.abs(mine - H).max() < 1e-7 * np.abs(H).max()


def test_few_vectors_suffice_whatever_the_damping():
    """The error estimate is sharp enough to stop early, with stiffness damping too."""
    model = steel(box("hex20", (8, 1, 1), (0.5, 0.05, 0.03)))
    interfaces = [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling="rigid") for n, x in (("l", 0.0), ("r", 0.5))
    ]

    class Orders:
        def stage(self, name):
            pass

        def update(self, text):
            self.last = int(text.split("order ")[1].split(",")[0])

    # A modal ratio acts as the root of M^-1 K, which a space grown by M^-1 K resolves more slowly; one block goes to
    # seeing that nothing changes any more.
    dampings = ((Damping(alpha=5.0), 60), (Damping(alpha=5.0, beta=1e-5), 60), (Damping(modal=0.02), 96))
    for damping, most in dampings:
        orders = Orders()
        with Problem(model, interfaces, damping=damping) as problem, listening(orders):
            full_response(problem, OMEGA)
        assert 24 <= orders.last <= most, damping


def test_modal_damping_limits_the_resonance_to_its_quality():
    """At a lone resonance the response is 1/(2 zeta) times the modal flexibility."""
    model = steel(box("hex20", (8, 1, 1), (0.5, 0.05, 0.03)))
    interfaces = [make_interface(model, name="r", nodes=where(model, 0, 0.5), coupling="average")]
    with Problem(model, interfaces, damping=Damping(modal=0.002)) as problem:
        modes = problem.elastic_modes(count=6)
        first = modes.eigenvalues[0]
        peak = full_response(problem, np.sqrt(first)[None])[0]
        gain = problem.B.T @ modes.vectors[:, 0]
        j = int(np.argmax(np.abs(gain[:3])))
        assert peak[j, j].imag == pytest.approx(-(gain[j] ** 2) / (2 * 0.002 * first), rel=1e-3)
        reduced = CraigBampton(modes=20).reduce(problem)
        assert np.abs(reduced_response(reduced, 0.5 * np.sqrt(first)[None])[0][j, j]) == pytest.approx(
            np.abs(full_response(problem, 0.5 * np.sqrt(first)[None])[0][j, j]), rel=1e-3
        )


def test_response_needs_interfaces():
    with Problem(steel(box("hex8", (2, 1, 1), (0.5, 0.05, 0.03)))) as problem, pytest.raises(InputError):
        full_response(problem, OMEGA)
