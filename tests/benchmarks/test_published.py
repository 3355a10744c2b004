"""The measure of published models is right, and both programs are measured by it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from published_models import MODELS, System, errors, mass_spring_damper, measure, ours, triple_chain


def test_errors_are_those_of_quadrature() -> None:
    """Two of eight modes are left out, of two inputs: their sum is the error."""
    rng = np.random.default_rng(3)
    values, phi = np.arange(1.0, 9.0) ** 2, rng.standard_normal((8, 2))
    damping = 0.1 * np.arange(1.0, 9.0)
    full = System(*(sp.diags_array(d).tocsc() for d in (np.ones(8), damping, values)), phi, phi.T)
    reduced = System(np.eye(6), np.diag(damping[:6]), np.diag(values[:6]), phi[:6], phi[:6].T)
    w = np.tan(np.linspace(0, np.pi / 2, 400_001)[:-1])
    norms = []
    for modes in (slice(6, 8), slice(0, 8)):
        g = 1 / (values[modes] - w[:, None] ** 2 + 1j * w[:, None] * damping[modes])
        H = np.einsum("ki,wk,kj->wij", phi[modes], g, phi[modes])
        squares = (np.abs(H) ** 2).sum(axis=(1, 2))
        norms.append((np.sqrt(np.trapezoid(squares, w) / np.pi), np.linalg.norm(H, 2, axis=(1, 2)).max()))
    h2, hinf = np.divide(norms[0], norms[1])
    assert errors(full, reduced) == pytest.approx((h2, hinf), rel=1e-5)
    unstable = System(np.eye(6), -np.diag(damping[:6]), np.diag(values[:6]), phi[:6], phi[:6].T)
    assert errors(full, unstable) == (None, None)


def test_models_are_those_of_the_papers() -> None:
    chain, masses = triple_chain(3), mass_spring_damper(4)
    K = chain.K.toarray()
    # Every row but those at the walls is in balance; the coupled mass has a spring of its own to the ground.
    assert K.sum(axis=1).tolist() == [10.0, 0.0, 0.0, 20.0, 0.0, 0.0, 1.0, 0.0, 0.0, 50.0]
    assert np.diag(chain.M.toarray()).tolist() == [1.0] * 3 + [2.0] * 3 + [3.0] * 3 + [10.0]
    extra = np.diag(chain.D.toarray() - 0.002 * (chain.M + chain.K).toarray())
    assert np.allclose(extra, [5, 0, 5, 0, 0, 0, 5, 0, 0, 0], atol=1e-15)
    assert masses.K.toarray().sum(axis=1).tolist() == [0.0, 0.0, 0.0, 4.0]


def test_both_programs_match_the_same_points() -> None:
    spec = {"model": "mass-spring-damper chain", "method": "krylov", "order": 6, "data": ""}
    found = [measure({**spec, "who": who}) for who in ("morembs", "pyMOR")]
    if "error" in found[1]:
        pytest.skip(found[1]["error"])
    for key in ("dofs", "order"):
        assert found[0][key] == found[1][key]
    for key in ("h2_error", "hinf_error"):
        assert 0 < found[0][key] < 1 and found[0][key] == pytest.approx(found[1][key], rel=1e-6)


def test_data_that_are_not_there_are_asked_for(tmp_path: Path) -> None:
    spec = {"model": "sandwich beam", "method": "krylov", "order": 6, "who": "morembs", "data": str(tmp_path)}
    assert "sandwich_beam_168.mat" in measure(spec)["error"] and list(MODELS)[-1] == "sandwich beam"


def test_a_balanced_chain_is_near_its_model() -> None:
    system = mass_spring_damper(30)
    reduced = ours(system, "fv", 8, np.array([0.1, 1.0]))
    h2, hinf = errors(system, reduced)
    assert h2 < 0.05 and hinf < 0.01
    assert sl.eigvalsh(reduced.K, reduced.M)[0] > 0
