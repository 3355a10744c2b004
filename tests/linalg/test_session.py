"""A new solver is one file and one line of a table: that of docs/howto/extending.md, and the same one as 0.1 had it."""

from __future__ import annotations

import importlib.util
import re
import sys
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.base.errors import BudgetError
from morembs.base.types import Values
from morembs.linalg.sparse import tolerances
from morembs.linalg.sparse.select import SOLVERS, select_solver
from morembs.linalg.sparse.solver import STRUCTURES, Analysis, Factorization, FactorStats, Forecast, LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL, SolverTolerances
from tests.linalg import test_solvers as contract
from tests.support.matrices import backward_error, brick, random
from tests.support.refusals import refusal

FIELD = re.compile(r"    \w+: ")
DOCUMENT = Path(__file__).parents[2] / "docs" / "howto" / "extending.md"


class FormerFactor(Factorization):
    def __init__(self, A: np.ndarray, stats: FactorStats) -> None:
        super().__init__(stats, A.dtype)
        self.A: Any = A
        self.lu: Any = sl.lu_factor(A)

    def _solve(self, B: Values) -> Values:
        return np.asfortranarray(sl.lu_solve(self.lu, B))

    def _negative_pivots(self) -> int | None:
        return int((sl.eigvalsh(self.A) < 0).sum())

    def _release(self) -> None:
        self.A = self.lu = None


class FormerAnalysis(Analysis):
    @property
    def forecast(self) -> Forecast:
        n = self.n
        return Forecast(
            backend="dense", size=n, factor_entries=n * n, flops=n**3 / 1.5, memory=16 * n * n, kept=16 * n * n
        )

    def factorize_unchecked(self, A: Lower) -> Factorization:
        start = time.perf_counter()
        return FormerFactor(A.full().toarray(), self._stats(start, 2 * self.n**2))

    def _release(self) -> None:
        pass


@dataclass(frozen=True, kw_only=True)
class Former(LinearSolver):
    """LU of the full matrix, by the classes that plug-ins of 0.1 are made of."""

    name: ClassVar[str] = "dense"
    structures: ClassVar[tuple[str, ...]] = ("spd", "symmetric")

    @classmethod
    def unavailable(cls) -> str:
        return ""

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        return FormerAnalysis(A, structure)


@pytest.fixture(scope="module")
def dense(tmp_path_factory: pytest.TempPathFactory) -> type[LinearSolver]:
    """The solver of the document."""
    file = tmp_path_factory.mktemp("package") / "documented_package.py"
    file.write_text(re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)[1])
    spec = importlib.util.spec_from_file_location("documented_package", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "documented_package", module)
        spec.loader.exec_module(module)
    return module.Dense


@pytest.fixture(params=[*(("session", structure) for structure in STRUCTURES), ("0.1", "spd"), ("0.1", "symmetric")])
def pair(request: pytest.FixtureRequest, dense: type[LinearSolver], monkeypatch: pytest.MonkeyPatch) -> contract.Pair:
    """The solver by its name in the table, with a structure."""
    form, structure = request.param
    monkeypatch.setitem(SOLVERS, "dense", dense if form == "session" else Former)
    return select_solver("dense"), structure


@pytest.mark.parametrize(
    "check",
    [
        contract.test_solution_is_that_of_numpy,
        contract.test_transposed_solutions_are_those_of_the_transpose,
        contract.test_sparse_right_hand_sides_give_what_dense_ones_give,
        contract.test_one_row_and_no_columns,
        contract.test_one_analysis_serves_three_matrices,
        contract.test_a_structure_that_is_not_that_of_the_values_is_refused,
    ],
)
def test_a_solver_of_another_package_keeps_the_contract(pair: contract.Pair, check: Any) -> None:
    check(pair)


@pytest.mark.parametrize(
    "check",
    [
        contract.test_a_factor_closes_the_analysis_that_was_made_for_it,
        contract.test_rows_without_stiffness_are_singular,
        contract.test_bad_values_are_refused_by_an_analysis_of_a_good_matrix,
        contract.test_complex_right_hand_sides_of_a_real_matrix_are_refused,
        contract.test_inertia_counts_the_eigenvalues_of_a_pencil_below_a_shift,
        contract.test_two_factors_live_side_by_side,
        contract.test_a_forgotten_factor_is_freed,
    ],
)
def test_it_gives_back_what_it_holds_and_refuses_what_it_should(dense: type[LinearSolver], check: Any) -> None:
    check(dense())


def test_the_base_keeps_the_budget_and_solves_in_blocks(dense: type[LinearSolver]) -> None:
    A, B = brick(4), random(192, 2 * TOL.block_columns + 5)
    with refusal("memory", "", "0.5", "0.6", "LAPACK", by=BudgetError) as caught:
        dense(memory=500_000).factorize(A, "spd")
    widths: list[int] = []

    class Noting(dense.session):
        def _solve(self, B: Values) -> Values:
            widths.append(B.shape[1])
            return super()._solve(B)

    noting = type("Noting", (dense,), {"session": Noting})
    with noting(memory=caught.value.needed).analyse(A, "spd") as analysis:
        factor = analysis.factorize(A)
        widths.clear()
        assert backward_error(A, factor.solve(B), B) < 1e-14
        assert factor.stats.factor_entries == 192**2 and factor.stats.memory_bytes == 16 * 192**2
        assert widths == [TOL.block_columns, TOL.block_columns, 5]
        assert factor.stats.columns == 2 + B.shape[1] and factor.stats.flops == analysis.forecast.flops


def test_every_tolerance_is_a_quantity_with_its_reason() -> None:
    """A comment stands above each field, or above the group of lines that it belongs to."""
    lines = Path(tolerances.__file__).read_text().splitlines()
    rows = {line.split(":")[0].strip(): number for number, line in enumerate(lines) if FIELD.match(line)}
    assert list(rows) == [each.name for each in fields(SolverTolerances)]
    for name, row in rows.items():
        reason = next(line for line in reversed(lines[:row]) if not FIELD.match(line))
        assert reason.startswith("    # "), name
    assert TOL.refined_error < TOL.backward_error < TOL.asymmetry
    assert TOL.iteration_roundoff < TOL.stalled_error < TOL.iteration_accuracy
