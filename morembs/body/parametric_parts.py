"""What a body file keeps of parameters, as its rows and as the reduced model of all values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.floating.parametric import FrameTerms, frame_terms
from morembs.parametric.law import Law
from morembs.parametric.model import ParametricModel
from morembs.parametric.parameter import Box
from morembs.problem.damping import Damping
from morembs.storage.table_check import refuse_not_finite

if TYPE_CHECKING:
    from morembs.problem import Problem
    from morembs.reducers.base import ReducedModel

# Fields of the damping of a body.
DAMPING = ("alpha", "beta", "modal", "modal_table", "structural")


@dataclass(frozen=True, kw_only=True, eq=False)
class ParametricParts:
    """What a body file keeps of parameters: the reduced ``model`` of all values, ``frame`` terms, and ``displacement``
    (N, 3) of the kept nodes per unit of each morph, by name."""

    model: ParametricModel
    frame: FrameTerms | None
    displacement: Mapping[str, Floats]

    def rows(self) -> dict[str, Any]:
        """Fields by the rows of the file."""
        model, box = self.model, self.model.box

        def points(law: Law) -> dict[str, Floats]:
            return {name: at for name, at in zip(box.names, law.points, strict=True) if len(at)}

        given = {key: value for key, value in asdict(model.damping).items() if key in DAMPING}
        return {
            "names": box.names,
            "kinds": box.kinds,
            "units": box.units,
            "low": box.low,
            "high": box.high,
            "nominal": box.nominal,
            "points_K": points(model.law_K),
            "points_M": points(model.law_M),
            "K": model.K,
            "M": model.M,
            "rigid": model.rigid,
            "scale": model.scale,
            "damping": given,
            "frame": self.frame,
            "displacement": self.displacement,
            "bound": model.bound,
            "box_bound": model.box_bound,
            "floor": model.floor,
            "proof": {"lemmas": [asdict(lemma) for lemma in model.proof]} if model.proof else None,
            "law_K": model.law_K.factors,
            "law_M": model.law_M.factors,
        }

    @classmethod
    def of_rows(
        cls,
        *,
        names: tuple[str, ...],
        kinds: tuple[str, ...],
        low: Floats,
        high: Floats,
        nominal: Floats,
        law_K: Any,
        law_M: Any,
        points_K: Mapping[str, Floats],
        points_M: Mapping[str, Floats],
        damping: dict[str, Any],
        displacement: Mapping[str, Floats],
        box_bound: float,
        frame: dict[str, Any] | None = None,
        bound: dict[str, Any] | None = None,
        **matrices: Any,
    ) -> ParametricParts:
        """Of the fields that a file has."""
        box = Box(names=names, kinds=kinds, low=low, high=high, nominal=nominal)
        laws = [
            Law(factors=factors, points=tuple(points.get(name, np.zeros(0)) for name in names))
            for factors, points in ((law_K, points_K), (law_M, points_M))
        ]
        model = ParametricModel(
            box=box,
            law_K=laws[0],
            law_M=laws[1],
            damping=Damping(**damping),
            box_bound=box_bound,
            B=np.zeros((0, 0)),
            bound=None if bound is None else _bound(laws, bound),
            **matrices,
        )
        for name in ("K", "M"):
            refuse_not_finite("the body file", f"parametric/{name}", getattr(model, name))
        return cls(model=model, frame=None if frame is None else FrameTerms(**frame), displacement=displacement)


def _bound(laws: list[Law], values: dict[str, Any]) -> Any:
    from morembs.parametric.bound import ParametricBound
    from morembs.parametric.proof import BoxCells

    return ParametricBound(law_K=laws[0], law_M=laws[1], cells=BoxCells(**values.pop("cells")), **values)


def parametric_parts(
    problem: Problem, reduced: ReducedModel, kept: NDArray[np.int64], model: ParametricModel
) -> ParametricParts:
    """What the file keeps of the ``model`` of all values, whose body of nominal ones is ``reduced``; ``kept`` are
    labels of nodes."""
    from morembs.parametric.terms import AffineProblem

    if not isinstance(problem, AffineProblem):
        raise InputError("a problem without parameters was given; expected an AffineProblem")
    labels = problem.model.nodes.ids
    order = np.argsort(labels, kind="stable")
    rows = np.searchsorted(labels, kept, sorter=order)
    morph = problem.varied.morph
    displacement = {
        problem.box.names[number]: d[order[rows]] for number, d in zip(morph.which, morph.displacements, strict=True)
    }
    frame = frame_terms(problem, reduced.V) if problem.rigid.shape[1] else None
    return ParametricParts(model=model, frame=frame, displacement=displacement)
