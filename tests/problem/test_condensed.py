"""Free-free frequencies told from the fixed-interface modes, against LAPACK on the free body."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.linalg.sparse.mumps import EmbeddedMumps, Mumps
from morembs.problem import Problem
from morembs.reducers.craig_bampton import CraigBampton
from tests.support.meshes import beam, ends

DISK = next((kind for kind in (Mumps, EmbeddedMumps) if not kind.unavailable()), None)


@dataclass(frozen=True, kw_only=True)
class Counted(DISK or Mumps):
    """MUMPS that lists its Sturm counts."""

    counts_made: list[str] = field(default_factory=list, compare=False, repr=False)

    def _inertia(self, A, what):
        self.counts_made.append(what)
        return super()._inertia(A, what)


def free_hz(problem):
    """Elastic frequencies of the free coupled model by LAPACK."""
    values = sl.eigh(problem.K.toarray(), problem.M.toarray(), eigvals_only=True)[problem.rigid.shape[1] :]
    return np.sqrt(values) / (2 * np.pi)


@pytest.mark.parametrize("coupling", ["rigid", "average", "direct"])
def test_limits_enclose_the_frequencies_of_the_free_body(coupling):
    model = beam((12, 3, 2))
    with Problem(model, ends(model, coupling)) as problem:
        exact = free_hz(problem)
        fixed = problem.fixed_modes(count=12)
        low, high = problem.frequency_limits(10)
        assert (low <= exact[:10] * (1 + 1e-10)).all() and (exact[:10] <= high * (1 + 1e-10)).all()
        # As sharp as the fourth power of the ratio to the first mode that is not known.
        assert (high / low - 1 < (exact[:10] / np.sqrt(fixed.verified_below) * 2 * np.pi) ** 4).all()
        assert high[0] / low[0] - 1 < 1e-5


def test_counts_are_those_of_the_free_body_or_none():
    model = beam((12, 3, 2))
    with Problem(model, ends(model, "rigid")) as problem:
        exact = free_hz(problem)
        last = problem.fixed_modes(count=8).frequencies_hz[-1]
        condensed = problem.condensed()
        certain = 0
        for hz in 0.5 * (exact[:-1] + exact[1:])[:20]:
            counted = condensed.count_below((2 * np.pi * hz) ** 2)
            assert counted in (None, int((exact < hz).sum()))
            certain += counted is not None and hz < last
        assert certain >= int((exact < 0.8 * last).sum()) - 1
        assert condensed.count_below((4 * np.pi * last) ** 2) is None


def test_without_fixed_modes_nothing_is_told():
    model = beam()
    with Problem(model, ends(model)) as problem:
        assert problem.frequency_limits(3) is None and problem.known_frequencies_hz() is None
    with Problem(model, ends(model)) as problem:
        problem.fixed_modes(count=2)
        low, high = problem.frequency_limits(40)
        # Far above the known modes there is no limit.
        assert low[-1] == 0 and high[-1] == np.inf and np.isfinite(high[0])


def test_upper_limits_are_much_closer_than_the_frequencies_of_the_body():
    model = beam((12, 3, 2))
    with Problem(model, ends(model, "rigid")) as problem:
        body, exact = CraigBampton(modes=12).reduce(problem), free_hz(problem)[:8]
        high = problem.frequency_limits(8)[1]
        assert (high - exact < 0.1 * (np.sqrt(body.modes()[0][6:14]) / (2 * np.pi) - exact)).all()


@pytest.mark.skipif(DISK is None, reason="needs MUMPS")
def test_modes_of_the_free_body_need_no_count_of_their_own_after_those_of_the_fixed_one():
    """On disk a count is another factorisation."""
    model = beam((30, 4, 4))
    below = (2 * np.pi * 4000.0) ** 2
    with Problem(model, ends(model, "rigid"), solver=DISK(out_of_core=True)) as problem:
        alone = problem.elastic_modes(below=below).eigenvalues
    solver = Counted(out_of_core=True)
    with Problem(model, ends(model, "rigid"), solver=solver) as problem:
        problem.fixed_modes(count=10)
        assert len(solver.counts_made) == 1
        assert problem.elastic_modes(below=below).eigenvalues == pytest.approx(alone, rel=1e-9)
        assert len(solver.counts_made) == 1
        # Beyond the fixed-interface modes nothing is known.
        problem.elastic_modes(below=(2 * np.pi * 7000.0) ** 2)
        assert len(solver.counts_made) == 2
