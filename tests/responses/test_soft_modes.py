"""The reference of a body whose halves hang together so softly that its modes keep some of the rigid motion."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.certificates import drawn, judged
from morembs.reducers import Modal
from morembs.responses.certified import certified_reference


def test_rigid_motion_in_soft_modes_is_no_mode_of_its_own() -> None:
    case = drawn(np.random.default_rng([9001, 732]), 732)
    with case.problem as problem:
        reference = certified_reference(problem, [0.0, case.high])
        exact = problem.elastic_modes(count=10).eigenvalues
        assert reference.values[:10] == pytest.approx(exact, rel=1e-5) and exact[0] < 1e-5 * exact[-1]
        verdict = judged(problem, Modal(modes=12).reduce(problem), (0.0, case.high), "modal")
        assert verdict.kind == "proven" and verdict.above == 0
