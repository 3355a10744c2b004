"""The comparison of benchmarks/interpolation.py is fair: same matrices, same transfer function, true errors."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sl

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import interpolation
from models import make

from morembs import assemble, isotropic
from morembs.fem import ElementBlock, FEModel, Mesh, Nodes

TOP_HZ = 40_000.0


def steel(shape: str, dofs: int) -> FEModel:
    """A model as the children of the benchmark make it."""
    xyz, cells = make(shape, dofs)
    block = ElementBlock(type="tet10", nodes=cells, ids=np.arange(len(cells)))
    mesh = Mesh(nodes=Nodes(ids=np.arange(len(xyz)), xyz=xyz), blocks=(block,))
    return assemble(mesh, [isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)])


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Options of a small cube, with the file of its responses."""
    settings: dict[str, Any] = {
        "shape": "cube",
        "dofs": 1029,
        "top_hz": TOP_HZ,
        "ratio": 0.01,
        "points": 4,
        "moments": 1,
        "tolerance": 1e-10,
        "shifts_hz": [0.34 * TOP_HZ, 0.6 * TOP_HZ],
        "block": True,
        "limit_seconds": 600.0,
        "file": str(tmp_path_factory.mktemp("exact") / "exact.npz"),
    }
    interpolation.direct(settings, steel)
    return settings


def test_direct_responses_are_those_of_the_modes(spec: dict[str, Any]) -> None:
    """Response points against all modes of the dense pencil."""
    K, M = (interpolation.stored(spec, key).toarray() for key in "KM")
    values, vectors = sl.eigh(K, M)
    alpha, beta = interpolation.rayleigh(spec)
    with np.load(spec["file"]) as file:
        modal = vectors[:, 6:].T @ file["F"]
        assert np.abs(vectors[:, :6].T @ file["F"]).max() < 1e-9 * np.abs(modal).max()
    w = interpolation.band(spec)[:, None]
    gain = 1.0 / (values[6:] + 1j * w * (alpha + beta * values[6:]) - w**2)
    assert interpolation.error(np.einsum("ki,wk,kj->wij", modal, gain, modal), spec) < 1e-9
    assert interpolation.reference(spec, steel)["response_error"] < 1e-8


@pytest.mark.parametrize("measured", ["ours", "pymor"])
def test_reductions_reach_the_response_that_they_interpolate(spec: dict[str, Any], measured: str) -> None:
    """Errors vanish where a compared frequency is an expansion point, and do not where none is."""
    if measured == "pymor":
        pytest.importorskip("pymor")
    reduce: Callable[..., dict[str, Any]] = (
        interpolation.pymor if measured == "pymor" else lambda spec: interpolation.ours(spec, steel)
    )
    at = (interpolation.band(spec) / (2 * np.pi)).tolist()
    # pyMOR matches the damped response at its points; two blocks of ours match the undamped one to first order.
    matched = reduce({**spec, "shifts_hz": at, "moments": 2})
    assert matched["factorisations"] == len(at)
    assert matched["response_error"] < 1e-6
    assert reduce({**spec, "shifts_hz": at[-1:]})["response_error"] > 1e-3


def test_pymors_ways_differ_in_factorisations_only(spec: dict[str, Any]) -> None:
    pytest.importorskip("pymor")
    block, tangential = (interpolation.pymor({**spec, "block": way}) for way in (True, False))
    assert (block["factorisations"], tangential["factorisations"]) == (2, 48)
    assert block["order"] == tangential["order"] == 48
    assert tangential["response_error"] == pytest.approx(block["response_error"], rel=1e-3)
