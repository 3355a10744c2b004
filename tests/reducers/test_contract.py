"""What every method of ``REDUCERS`` keeps to. A new method is run once it is in the table; its variants are listed."""

import gc
import tracemalloc
import weakref
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from morembs.base.errors import SolverError
from morembs.fem.interface import make_interface
from morembs.parametric.parameter import Parameter
from morembs.parametric.terms import AffineProblem
from morembs.parametric.varied import varied_model
from morembs.problem import Damping, Problem
from morembs.reducers import REDUCERS, Modal, ProblemSummary
from morembs.reducers.base import MODE_KINDS, ReducedModel
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

BAND = [0.0, 3000.0]
LISTED: list[tuple[str, dict[str, Any]]] = [
    ("auto", {"band_hz": BAND, "tolerance": 1e-2}),
    ("modal", {"modes": 5}),
    ("modal", {"modes": 5, "interfaces": "fixed"}),
    ("guyan", {}),
    ("irs", {"steps": 3}),
    ("craig-bampton", {"modes": 5}),
    ("craig-bampton", {"modes": 14, "inertia_modes": True}),
    ("craig-bampton", {"modes": 3, "interface_modes": 4}),
    ("free-interface", {"modes": 5}),
    ("krylov", {"shifts_hz": [0.0, 2000.0]}),
    ("krylov", {"two_sided": True, "inputs": ["left"], "outputs": ["right"], "shifts_hz": [500.0]}),
    ("gramian", {"band_hz": BAND, "order": 8}),
    ("gramian", {"band_hz": BAND, "order": 8, "direct": True, "points": 5}),
    ("balanced-truncation", {"order": 8}),
    ("balanced-truncation", {"order": 8, "variant": "p"}),
    ("irka", {"order": 6, "band_hz": BAND, "max_steps": 3}),
    ("parametric", {"band_hz": BAND, "tolerance": 1e-2, "training": 4}),
    ("static-modes-switching", {"base_options": {"modes": 5}, "candidates": "box:0.1,0,0,0.4,0,0"}),
]
# Values of keys that many methods have, for methods that are not listed.
USUAL: dict[str, Any] = {"modes": 5, "order": 8, "band_hz": BAND}
OPTIONS = LISTED + [
    (name, {key.name: USUAL[key.name] for key in fields(REDUCERS[name]) if key.name in USUAL})
    for name in REDUCERS.own
    if name not in dict(LISTED)
]
RAYLEIGH = Damping(alpha=3.0, beta=2e-6)
ALL = pytest.mark.parametrize(("method", "options"), OPTIONS, ids=lambda value: value if isinstance(value, str) else "")


def problem_of(damping: Damping = RAYLEIGH, cells: int = 5, method: str = "") -> Problem:
    mesh = box("hex8", (cells, 1, 1), (0.5, 0.05, 0.03))
    model = steel(mesh)
    ends = [make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in (("left", 0.0), ("right", 0.5))]
    if method == "parametric":
        E = Parameter(name="E", kind="young", low=2.0e11, high=2.2e11, nominal=2.1e11)
        return AffineProblem(varied_model(mesh, model.materials, [E]), ends, damping=damping)
    return Problem(model, ends, damping=damping)


def close(actual: Any, W: Any, A: Any, V: Any) -> None:
    """``one`` is W' A V, to the round-off of its sums and of solving."""
    size = np.abs(W).T @ (abs(A) @ np.abs(V))
    assert actual.shape == size.shape
    worst = (np.abs(actual - W.T @ (A @ V)) / np.maximum(size, np.finfo(float).tiny)).max()
    assert worst < 1e-10, worst


def test_methods_are_known_by_their_names() -> None:
    assert {method for method, _ in OPTIONS} == set(REDUCERS.own)
    assert all(reducer.method == name for name, reducer in REDUCERS.items())


@ALL
def test_matrices_are_projections_and_the_same_bytes_in_every_run(method: str, options: dict[str, Any]) -> None:
    with problem_of(method=method) as problem:
        again = REDUCERS[method](**options).reduce(problem)
    with problem_of(method=method) as problem:
        reducer = REDUCERS[method](**options)
        assert reducer.why_not(ProblemSummary.of(problem)) == ""
        reduced = reducer.reduce(problem)
        V, W = reduced.V, reduced.V if reduced.W is None else reduced.W
        K, M = problem.K, problem.M
        assert reducer.two_sided == (reduced.W is not None) == (not reduced.symmetric)
        close(reduced.K, W, K, V)
        if reduced.is_projection:
            close(reduced.M, W, M, V)
            rigid = problem.rigid if reduced.rigid_count else problem.rigid[:, :0]
            Mr = M @ rigid
            close(reduced.D, W, RAYLEIGH.alpha * (M.toarray() - Mr @ Mr.T) + RAYLEIGH.beta * K.toarray(), V)
        for matrix, columns in ((reduced.C.T, V), (reduced.B, W)):
            np.testing.assert_allclose(matrix, columns.T @ problem.B.toarray(), atol=1e-9 * np.abs(columns).max())
        count = reduced.mode_kind.count("constraint")
        np.testing.assert_array_equal(reduced.C[:count, :count], np.eye(count))
        assert count in (0, problem.B.shape[1]) and set(reduced.mode_kind) <= set(MODE_KINDS)
        refuse_lost_rigid_motion(problem, reduced)
    for key in ("M", "K", "D", "B", "C", "V"):
        assert getattr(again, key).tobytes() == getattr(reduced, key).tobytes(), key


def refuse_lost_rigid_motion(problem: Problem, reduced: ReducedModel) -> None:
    """Coordinates reproduce the rigid motions of the body, at no energy and with its mass."""
    if not reduced.rigid_count:
        return
    Z, V = problem.rigid, reduced.V
    assert reduced.rigid_count == Z.shape[1] == 6
    q = np.linalg.lstsq(V, Z, rcond=None)[0]
    np.testing.assert_allclose(V @ q, Z, atol=1e-9 * np.abs(Z).max())
    if reduced.symmetric:
        np.testing.assert_allclose(q.T @ reduced.M @ q, np.eye(6), atol=1e-9)
        lowest = np.abs(reduced.modes()[0])
        assert lowest[5] < 1e-6 * lowest[6]


@pytest.mark.parametrize("method", ["krylov", "gramian"])
def test_a_closed_problem_keeps_no_solutions(method: str) -> None:
    options = next(options for name, options in OPTIONS if name == method)
    with problem_of(cells=400) as problem:
        _ = problem.free_free.flexibility(problem.B.toarray())
        tracemalloc.start()
        try:
            reduced = REDUCERS[method](**options).reduce(problem)
            size = reduced.V.nbytes
            del reduced
            gc.collect()
            held = tracemalloc.get_traced_memory()[0]
            problem.close()
            gc.collect()
            kept = tracemalloc.get_traced_memory()[0]
        finally:
            tracemalloc.stop()
    assert kept < 0.3 * size < held, (size, held, kept)


@pytest.mark.parametrize("method", ["krylov", "gramian", "craig-bampton"])
def test_a_released_problem_gives_its_factors_back_and_makes_them_anew(method: str) -> None:
    reducer = REDUCERS[method](**next(options for name, options in OPTIONS if name == method))
    with problem_of() as problem:
        bodies, factors = [], []
        for _ in range(2):
            bodies.append(reducer.reduce(problem))
            factors.append(problem.statics.factor)
            held = weakref.ref(problem.free_free.X)
            problem.release()
            assert factors[-1].closed and held() is None
        assert factors[0] is not factors[1]
    np.testing.assert_array_equal(bodies[0].V, bodies[1].V)


@dataclass(frozen=True, kw_only=True)
class TenTimes(Modal):
    method: ClassVar[str] = "ten-times"
    first: int = 0

    def _basis(self, problem: Problem) -> Any:
        basis = super()._basis(problem)
        scale = np.ones(len(basis.K))
        scale[self.first :] = 10.0
        return replace(basis, K=scale[:, None] * basis.K)


@pytest.mark.parametrize("first", [0, -1])
def test_a_wrong_stiffness_is_refused(first: int) -> None:
    with problem_of() as problem, refusal("result", "method", by=SolverError):
        TenTimes(modes=6, first=first).reduce(problem)
