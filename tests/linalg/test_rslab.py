"""What RSLAB promises beside the contract of all solvers, where it is installed."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from morembs.base.errors import SingularMatrixError
from morembs.linalg.sparse.rslab import Rslab, rslab_library
from morembs.linalg.sparse.select import FAST, LEAN
from morembs.linalg.sparse.threads import limit_threads
from tests.support.matrices import brick, random, shifted
from tests.support.refusals import refusal


@pytest.fixture
def solver() -> Rslab:
    if reason := Rslab.unavailable():
        pytest.skip(reason)
    return Rslab()


def test_it_says_how_to_get_it_and_is_never_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rslab", None)
    reason = rslab_library.__wrapped__()
    assert isinstance(reason, str) and reason.endswith("get it with: pip install 'morembs[rslab]'")
    assert Rslab.name not in {*FAST, *LEAN}


def test_bits_do_not_depend_on_the_number_of_threads(solver: Rslab) -> None:
    A, B = shifted(brick(14), 3.0), random(8232, 5)
    solutions = []
    for threads in (1, 2):
        with limit_threads(threads), solver.factorize(A) as factor:
            solutions.append(factor.solve(B))
    np.testing.assert_array_equal(*solutions)


def test_a_matrix_that_is_not_definite_is_refused_as_such(solver: Rslab) -> None:
    with solver.analyse(brick(3), "spd") as analysis:
        with refusal("model", by=SingularMatrixError):
            analysis.factorize(shifted(brick(3), 13.7))
        assert analysis.factorize(brick(3)).negative_pivots() == 0
