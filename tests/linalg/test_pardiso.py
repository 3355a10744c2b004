"""What PARDISO has to do, where MKL is installed."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.errors import BudgetError, SingularMatrixError
from morembs.linalg.sparse import pardiso, pardiso_library
from morembs.linalg.sparse.mumps import Mumps
from morembs.linalg.sparse.pardiso import Pardiso
from morembs.linalg.sparse.symmetric import Lower
from tests.support.refusals import refusal

# Phases of PARDISO, as its manual counts them.
ANALYSE, FREE = 11, -1
COUPLING = np.array([[2.0, 0.3, 0.1], [0.3, 2.0, 0.2], [0.1, 0.2, 2.0]])


@pytest.fixture
def solver() -> Pardiso:
    if reason := Pardiso.unavailable():
        pytest.skip(reason)
    return Pardiso()


@dataclass(frozen=True)
class Call:
    """A call of MKL, ``name`` with 32-bit or with 64-bit integers, and what it has written."""

    name: str
    phase: int
    iparm: Any
    code: Any

    @property
    def matching(self) -> bool:
        return bool(self.iparm[10] and self.iparm[12])


def _watched(watch: Callable[[Call], None]) -> Pardiso:
    """The solver, which shows ``watch`` every call that MKL has done."""
    library: Any = Pardiso.library()

    def watched(name: str, integer: Any) -> Callable[..., None]:
        def call(*args: Any) -> None:
            getattr(library, name)(*args)
            phase, iparm, code = (ctypes.cast(args[place], ctypes.POINTER(integer)) for place in (4, 11, 15))
            watch(Call(name, int(phase.contents.value), iparm, code.contents))

        return call

    integers = {"pardiso": ctypes.c_int32, "pardiso_64": ctypes.c_int64}
    spied = SimpleNamespace(**{name: watched(name, integer) for name, integer in integers.items()})
    return type("Watched", (Pardiso,), {"library": staticmethod(lambda: spied)})()


def _chain(nodes: int, ends: float = 2.0) -> sp.csr_array:
    """Springs in a row, three coupled displacements at each node; free ends where ``ends`` is 1."""
    main = np.full(nodes, 2.0)
    main[[0, -1]] = ends
    L = sp.diags_array([-np.ones(nodes - 1), main, -np.ones(nodes - 1)], offsets=[-1, 0, 1])
    return sp.csr_array(sp.kron(L, COUPLING))


def _brick(nodes: int) -> sp.csr_array:
    """27-point stencil on a cube of ``nodes`` to the power 3, three displacements each; positive definite."""
    row = sp.diags_array([np.ones(nodes - 1), np.ones(nodes), np.ones(nodes - 1)], offsets=[-1, 0, 1])
    P = sp.csr_array(sp.kron(sp.kron(row, row), row)) - sp.eye_array(nodes**3)
    L = sp.diags_array(np.asarray(P.sum(axis=1)).ravel() + 0.01) - P
    return sp.csr_array(sp.kron(L, COUPLING))


def _shifted(A: sp.csr_array, shift: complex) -> sp.csr_array:
    return sp.csr_array(A - shift * sp.eye_array(A.shape[0]))


def _random(*shape: int) -> np.ndarray:
    return np.random.default_rng(3).standard_normal(shape)


def _backward_error(A: sp.csr_array, X: np.ndarray, B: np.ndarray) -> float:
    return float(np.linalg.norm(A @ X - B) / (abs(A).max() * np.linalg.norm(X) + np.linalg.norm(B)))


@pytest.mark.parametrize("structure", ["spd", "symmetric"])
def test_200_columns_of_a_positive_definite_matrix(solver: Pardiso, structure: str) -> None:
    A, B = _brick(6), _random(648, 200)
    with solver.factorize(A, structure) as factor:
        X = factor.solve(B)
        assert factor.negative_pivots() == 0
    np.testing.assert_allclose(X, np.linalg.solve(A.toarray(), B), rtol=0, atol=1e-11 * np.abs(X).max())


def test_complex_symmetric(solver: Pardiso) -> None:
    A, B = _shifted(_brick(5), 13.7 - 2.0j), _random(375, 130) + 1j * _random(375, 130)[::-1]
    with solver.factorize(A, "complex-symmetric") as factor:
        X = factor.solve(B)
    assert X.dtype == np.complex128
    assert _backward_error(A, X, B) < 1e-15


def test_one_analysis_serves_three_shifts(solver: Pardiso) -> None:
    A, B = _brick(6), _random(648, 5)
    values = np.linalg.eigvalsh(A.toarray())
    calls: list[Call] = []
    with _watched(calls.append).analyse(_shifted(A, 1.0)) as analysis:
        for shift in (0.5, 7.3, 21.9):
            factor = analysis.factorize(_shifted(A, shift))
            assert factor.negative_pivots() == np.count_nonzero(values < shift)
            X = factor.solve(B)
            assert _backward_error(_shifted(A, shift), X, B) < 1e-14
    assert [call.phase for call in calls].count(ANALYSE) == 1


@pytest.mark.parametrize("gap", [0, 1, 7, 40, 89, 90])
def test_inertia_in_several_gaps(solver: Pardiso, gap: int) -> None:
    A = sp.csr_array(_chain(30) + sp.diags_array(np.linspace(0.0, 1.0, 90)))
    values = np.linalg.eigvalsh(A.toarray())
    limits = np.concatenate([[values[0] - 1.0], values, [values[-1] + 1.0]])
    with solver.factorize(_shifted(A, 0.5 * (limits[gap] + limits[gap + 1]))) as factor:
        assert factor.negative_pivots() == gap


def test_zero_diagonal_needs_matching_and_keeps_the_inertia(solver: Pardiso) -> None:
    """Every displacement held by a multiplier; then a matrix of the same pattern that needs no such help."""
    ones = sp.eye_array(120)
    A = sp.csr_array(sp.block_array([[_chain(40), ones], [ones, None]]))
    A.setdiag(A.diagonal())
    easy = A.copy()
    easy.setdiag(A.diagonal() + 5.0)
    b = _random(240, 3)
    calls: list[Call] = []
    with _watched(calls.append).analyse(A) as analysis:
        for matrix, negative in ((A, 120), (easy, 0)):
            factor = analysis.factorize(matrix)
            assert calls[-1].matching == (matrix is A)
            assert _backward_error(matrix, factor.solve(b), b) < 1e-14
            assert factor.negative_pivots() == np.count_nonzero(np.linalg.eigvalsh(matrix.toarray()) < 0)
            assert factor.negative_pivots() == negative


def test_everything_is_freed(solver: Pardiso) -> None:
    A = sp.csr_array(sp.block_array([[_chain(40), sp.eye_array(120)], [sp.eye_array(120), None]]))
    calls: list[Call] = []
    with _watched(calls.append).analyse(A) as analysis:
        for _ in range(2):
            analysis.factorize(A)
            assert calls[-1].matching
    phases = [call.phase for call in calls]
    assert phases.count(ANALYSE) == phases.count(FREE) == 3


def test_solutions_beside_an_eigenvalue_are_refined(solver: Pardiso) -> None:
    A, b = _brick(5), _random(375, 130)
    values = np.linalg.eigvalsh(A.toarray())
    A = _shifted(A, values[np.argmin(abs(values - 13.7))] * (1 + 1e-9))
    with solver.factorize(A) as factor:
        assert _backward_error(A, factor.solve(b), b) < 1e-14


@pytest.mark.parametrize("structure", ["spd", "symmetric"])
@pytest.mark.parametrize("nodes", [7, 40, 200])
def test_free_chain_is_singular(solver: Pardiso, structure: str, nodes: int) -> None:
    with pytest.raises(SingularMatrixError):
        solver.factorize(_chain(nodes, ends=1.0), structure)


def test_analysis_outlives_a_singular_matrix_and_a_closed_factor(solver: Pardiso) -> None:
    A, b = _brick(5), _random(375)
    with solver.analyse(A, "spd") as analysis:
        with refusal("model", "", "positive", by=SingularMatrixError):
            analysis.factorize(_shifted(A, 13.7))
        analysis.factorize(A).close()
        assert np.abs(A @ analysis.factorize(A).solve(b) - b).max() < 1e-11


def test_budget_message_says_what_is_needed(solver: Pardiso) -> None:
    # Large enough for the buffers of each thread, some 20 MB, to be a part of it only.
    A = _brick(16)
    with refusal("memory", "", "0.0", "PARDISO", by=BudgetError) as caught:
        solver.with_memory(1000).factorize(A, "spd")
    with solver.with_memory(caught.value.needed).factorize(A, "spd") as factor:
        assert caught.value.needed < 3 * factor.stats.memory_bytes
        assert caught.value.needed >= factor.stats.memory_bytes >= 8 * factor.stats.factor_entries > 8 * A.nnz / 2


@pytest.mark.parametrize("sign", ["an error", "the memory"])
def test_64_bit_integers_where_32_are_too_few(solver: Pardiso, sign: str) -> None:
    A, b = _brick(6), _random(648)
    calls: list[Call] = []
    with _watched(calls.append).factorize(A, "spd") as factor:
        entries, x = factor.stats.factor_entries, factor.solve(b)
    assert {call.name for call in calls} == {"pardiso"}

    def overrun(call: Call) -> None:
        calls.append(call)
        if call.name == "pardiso" and call.phase == ANALYSE:
            if sign == "an error":
                call.code.value = -8
            else:
                # A factor of 2**30 KiB.
                call.iparm[16] = 2**30

    calls.clear()
    with _watched(overrun).factorize(A, "spd") as factor:
        assert {call.name for call in calls if call.phase not in (ANALYSE, FREE)} == {"pardiso_64"}
        assert factor.stats.factor_entries == entries
        np.testing.assert_allclose(factor.solve(b), x, rtol=0, atol=1e-12 * np.abs(x).max())


def test_given_order_is_used(solver: Pardiso, monkeypatch: pytest.MonkeyPatch) -> None:
    """An order read the wrong way round (place of a row for row of a place) fills the factor."""
    A = _brick(9)
    if (order := pardiso.metis_ordering(Lower.of(A))) is None:
        pytest.skip("no METIS library; get it with: sudo apt-get install libmetis5")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    with solver.analyse(A, "spd") as analysis:
        good = analysis.forecast.factor_entries
    monkeypatch.setattr(pardiso, "metis_ordering", lambda A: place)
    with solver.analyse(A, "spd") as analysis:
        assert good < 0.7 * analysis.forecast.factor_entries


def test_missing_library_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pardiso_library, "mkl_file", lambda: None)
    reason = pardiso_library.mkl_library.__wrapped__()
    assert "not found" in reason and "pip install 'morembs[pardiso]'" in reason
    without_library = type("Gone", (Pardiso,), {"library": staticmethod(lambda: reason)})
    with refusal("program", "solver"):
        without_library().factorize(_chain(5))
    monkeypatch.setattr(pardiso_library, "mkl_file", lambda: __file__)
    assert "cannot be used" in pardiso_library.mkl_library.__wrapped__()


def test_mumps_loaded_later_keeps_its_own_blas(solver: Pardiso) -> None:
    """MKL makes its symbols global; its complex functions return their values in another way than those of
    gfortran, so a library compiled for the one must not get the other."""
    if reason := Mumps.lacks("double", "complex-symmetric"):
        pytest.skip(reason)
    code = """if True:
        import numpy as np, scipy.sparse as sp
        from morembs.linalg.sparse.mumps import Mumps
        from morembs.linalg.sparse.pardiso import Pardiso
        A = sp.csr_array(sp.diags_array(np.linspace(1.0, 2.0, 90)))
        Pardiso().factorize(A, "spd").close()
        Mumps().factorize(A, "spd").close()
        Mumps().factorize(A + 1j * A, "complex-symmetric").close()
    """
    bindings = {**os.environ, "LD_DEBUG": "bindings"}
    run = subprocess.run([sys.executable, "-c", code], check=True, env=bindings, capture_output=True, text=True)
    taken = [line for line in run.stderr.splitlines() if re.search(r"file \S*mumps\S* .* to \S*mkl", line)]
    assert "mumps" in run.stderr and not taken, taken[:5]
