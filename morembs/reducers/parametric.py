"""One body for all values of parameters: a global basis whose error is bounded over their box and a band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from morembs.base.errors import InputError
from morembs.base.limits import DampingFloor, PositiveCount, RelativeError
from morembs.parametric.basis import BasisRequest, GreedySearch, ParametricBasis
from morembs.parametric.model import ParametricModel
from morembs.parametric.terms import AffineProblem
from morembs.problem import Problem
from morembs.reducers.base import Basis, ReducedModel, Reducer
from morembs.reducers.cost import box_seconds
from morembs.reducers.problem_summary import ProblemSummary
from morembs.responses.band import Band


@dataclass(frozen=True, kw_only=True)
class ParametricReducer(Reducer):
    """One basis for all values of the parameters of a problem, grown where the bound of its error is largest.

    Args:
        band_hz: [low, high], the band that is bounded.
        tolerance: error of the transfer matrix relative to its envelope, over the band at all values of training.
        training: number of Sobol points in the box; a box with few corners adds its corners.
        order_limit: maximum number of reduced coordinates.
        accept_bound: accept a basis even if its bound exceeds the tolerance.
        damping_floor: ratio of critical damping that is assumed for the tolerance, as in ``certify``.

    >>> ParametricReducer(band_hz=[0.0, 3000.0], tolerance=1e-3).method
    'parametric'
    """

    method: ClassVar[str] = "parametric"
    band_hz: Band
    tolerance: RelativeError = 1e-3
    training: PositiveCount = 256
    order_limit: PositiveCount = 200
    accept_bound: bool = False
    damping_floor: DampingFloor | None = None

    def seconds(self, facts: ProblemSummary, factor_entries: int = 0) -> float | None:
        return box_seconds(facts.size, facts.inputs, factor_entries, self.training, self.order_limit)

    @property
    def computes_modes(self) -> bool:
        return True

    @property
    def certified_band(self) -> Sequence[float]:
        return self.band_hz

    def search(self, problem: Problem) -> ParametricBasis:
        """The basis with its model and bound, computed once for ``problem``.

        Raises:
            InputError: a problem without parameters, or a tolerance that is not reached.
        """
        if not isinstance(problem, AffineProblem):
            raise InputError(
                f'method "{self.method}" was given a model without parameters; add one [[parameter]] or more, or take '
                'method = "auto"',
                kind="missing",
                keyword="method",
            )
        wanted = BasisRequest(
            band_hz=(float(self.band_hz[0]), float(self.band_hz[1])),
            tolerance=self.tolerance,
            training=self.training,
            order_limit=self.order_limit,
            floor=self.damping_floor,
            accept_bound=self.accept_bound,
        )
        return problem.compute_once((self.method, wanted), lambda: GreedySearch(problem, wanted).run())

    def variation(self, problem: Problem, reduced: ReducedModel) -> ParametricModel | None:
        basis = self.search(problem)
        return replace(basis.model, box_bound=basis.box_bound, floor=basis.floor)

    def _basis(self, problem: Problem) -> Basis:
        basis = self.search(problem)
        rigid, n = problem.rigid.shape[1], basis.V.shape[1]
        K = basis.model.matrices(basis.model.box.nominal)[0]
        notes = {
            "bound_kind": basis.kind,
            "box_bound": basis.box_bound,
            "box_bound_is": "a maximum over samples",
            "factorisations": basis.factorisations,
            "counts": basis.counts,
            "damping_floor": basis.floor,
        }
        return Basis(V=basis.V, kinds=basis.kinds, K=K, rigid=np.eye(n, rigid), notes=notes)
