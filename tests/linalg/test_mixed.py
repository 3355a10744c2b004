"""A factor in single precision with the accuracy of a double one, and the double one where that fails."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from morembs.base.errors import SingularMatrixError, SolverError
from morembs.fem.assembly import assemble
from morembs.fem.material import isotropic
from morembs.linalg.sparse.mixed import Mixed
from morembs.linalg.sparse.mumps import Mumps
from morembs.linalg.sparse.session import SessionAnalysis
from morembs.linalg.sparse.solver import SYMMETRIC_STRUCTURES, Analysis, Factorization
from morembs.linalg.sparse.symmetric import Lower
from morembs.problem import Problem
from tests.support.matrices import backward_error, brick, damped, random, shifted, slender_beam
from tests.support.meshes import box
from tests.support.refusals import refusal

MATRICES = {"spd": brick(8), "symmetric": shifted(brick(8), 13.7), "complex-symmetric": damped(brick(8), 1.3)}
WARNING = "the single factor does not precondition well enough; a double one is made"


@pytest.fixture(autouse=True)
def _needs_single_precision() -> None:
    reason = Mumps.lacks("single", "spd") or Mumps.lacks("single", "complex-symmetric")
    if reason:
        pytest.skip(reason)


def _loads(structure: str, columns: int) -> np.ndarray:
    B = random(1536, columns)
    return np.asarray(B - 2j * random(1536, columns, seed=8)) if structure == "complex-symmetric" else B


@pytest.mark.parametrize("structure", SYMMETRIC_STRUCTURES)
def test_solutions_are_those_of_double_precision(structure: str, caplog: pytest.LogCaptureFixture) -> None:
    """More columns than one block of the iteration holds; every column is as good as the worst may be."""
    A, B = MATRICES[structure], _loads(structure, 70)
    with Mixed().factorize(A, structure) as factor, Mumps().factorize(A, structure) as exact:
        X = factor.solve(B)
        assert backward_error(A, X, B) < 1e-12
        Y = exact.solve(B)
        assert np.abs(X - Y).max() < 1e-11 * np.abs(Y).max()
        assert (factor.stats.backend, factor.stats.precision) == ("mumps-mixed", "single")
        assert factor.stats.memory_bytes <= 0.6 * exact.stats.memory_bytes
        assert factor.analysis.forecast.precision == "single"
        assert factor.analysis.forecast.memory <= 0.75 * exact.analysis.forecast.memory
        # The right-hand side of an eigenmode that is nearly zero is the hardest.
        x = np.linalg.eigh(A.toarray())[1][:, :1] if structure == "spd" else B[:, :1]
        assert backward_error(A, factor.solve(A @ x), A @ x) < 1e-12
    assert "double one" not in caplog.text


def test_columns_of_very_different_size_are_each_solved_to_their_own(caplog: pytest.LogCaptureFixture) -> None:
    B = random(1536, 6) * 10.0 ** np.array([-25, -9, 0, 3, 15, 25])
    B[:, 2] = 0.0
    with Mixed().factorize(brick(8), "spd") as factor:
        X = factor.solve(B)
        assert factor.stats.precision == "single"
    assert not X[:, 2].any() and backward_error(brick(8), X, B) < 1e-12


def test_a_tiny_right_hand_side_is_solved() -> None:
    b = 1e-50 * random(1536)
    with Mixed().factorize(brick(8), "spd") as factor:
        assert backward_error(brick(8), factor.solve(b), b) < 1e-12


def test_a_slender_body_gets_a_double_factor(caplog: pytest.LogCaptureFixture) -> None:
    A = slender_beam(1000)
    b = random(2000)
    with Mixed().analyse(A, "spd") as analysis:
        factor = analysis.factorize(A)
        assert caplog.messages.count(WARNING) == 1
        assert (factor.stats.backend, factor.stats.precision) == ("mumps", "double")
        assert analysis.forecast.precision == "double"
        with Mumps().factorize(A, "spd") as exact:
            np.testing.assert_allclose(factor.solve(b), exact.solve(b), rtol=1e-9)
        assert factor.negative_pivots() == 0
        # The next matrix of the pattern does not try again, and the warning comes once per factor.
        again = analysis.factorize(2.0 * A)
        assert again.stats.precision == "double" and factor.closed
        assert backward_error(2.0 * A, again.solve(b), b) < 1e-14


def test_a_solution_that_stagnates_later_gets_a_double_factor_too(caplog: pytest.LogCaptureFixture) -> None:
    A, B = MATRICES["symmetric"], random(1536, 130)
    weak: list[bool] = []

    class Weak(Factorization):
        """A rough factor that no longer preconditions once ``weak`` holds something."""

        def __init__(self, factor: Factorization) -> None:
            super().__init__(factor.stats, factor.dtype)
            self.factor = factor

        def _solve(self, R: np.ndarray) -> np.ndarray:
            return R if weak else self.factor.solve(R)

        def _negative_pivots(self) -> int | None:
            return None

        def _release(self) -> None:
            self.factor.close()

    class WeakAnalysis(SessionAnalysis):
        def factorize_unchecked(self, A: Lower) -> Factorization:
            factor = super().factorize_unchecked(A)
            return Weak(factor) if factor.stats.precision == "single" else factor

    class Weakening(Mumps):
        def _analyse(self, A: Lower, structure: str) -> Analysis:
            analysis = super()._analyse(A, structure)
            analysis.__class__ = WeakAnalysis
            return analysis

    with Mixed(direct=Weakening).factorize(A) as factor:
        assert factor.stats.precision == "single"
        weak.append(True)
        X = factor.solve(B)
        assert backward_error(A, X, B) < 1e-13
        assert factor.stats.precision == "double" and caplog.messages.count(WARNING) == 1
        assert factor.negative_pivots() == np.count_nonzero(np.linalg.eigvalsh(A.toarray()) < 0)


def test_a_singular_matrix_is_refused_and_everything_is_freed(tmp_path: Path) -> None:
    singular = shifted(brick(6), np.linalg.eigvalsh(brick(6).toarray())[0])
    with pytest.raises(SingularMatrixError):
        Mixed(out_of_core=True, scratch=tmp_path).factorize(singular)
    assert not list(tmp_path.iterdir())


def test_on_disk(tmp_path: Path) -> None:
    A, B = brick(8), random(1536, 70)
    with Mixed(out_of_core=True, scratch=tmp_path).factorize(A, "spd") as factor:
        assert factor.stats.out_of_core and factor.stats.memory_bytes == 0 and len(list(tmp_path.iterdir())) == 1
        assert backward_error(A, factor.solve(B), B) < 1e-12
    assert not list(tmp_path.iterdir())


def test_a_rough_factor_counts_nothing() -> None:
    with Mixed().factorize(brick(4)) as factor, refusal("result", "solver", by=SolverError):
        factor.negative_pivots()


def test_what_makes_no_rough_factor_is_refused() -> None:
    with refusal("missing", "precision", "mumps"):
        Mixed(precision="double")
    solver = Mixed(precision="double", low_rank=1e-6, memory=7)
    assert solver.describe() == "low-rank 1e-06 double"
    rough: Any = solver.rough()
    assert (rough.low_rank, rough.precision, rough.memory, solver.exact().low_rank) == (1e-6, "double", 7, 0.0)


def test_a_slender_beam_of_solids_is_no_mechanism() -> None:
    """Single precision sees negative pivots in a sound slender body; the double factor must decide."""
    steel = isotropic(set="all", young=2e11, poisson=0.3, density=7800.0)
    model = assemble(box("tet10", (40, 1, 1), (1.0, 0.01, 0.01)), [steel])
    with Problem(model, solver=Mixed()) as mixed, Problem(model, solver=Mumps()) as exact:
        frequencies, expected = (p.elastic_modes(count=4).frequencies_hz for p in (mixed, exact))
    np.testing.assert_allclose(frequencies, expected, rtol=1e-5)
