"""What a body file keeps of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.floating.parametric import FrameTerms, frame_terms
from morembs.parametric.model import MODEL, ParametricModel
from morembs.storage.table import dataset, table_of

if TYPE_CHECKING:
    from morembs.problem import Problem
    from morembs.reducers.base import ReducedModel


# Sizes: P parameters, Q and J terms of stiffness and mass, f = 1 + morphs of them affine in morphs, q coordinates of
# residuals, c cells of the box, k deflated columns.
@dataclass(frozen=True, kw_only=True, eq=False)
class ParametricParts:
    """What a body file keeps of parameters: the reduced ``model`` of all values, ``frame`` terms, and ``displacement``
    (N, 3) of the kept nodes per unit of each morph, by name."""

    model: ParametricModel = dataset(MODEL, inline=True)
    frame: FrameTerms | None = dataset(
        table_of(FrameTerms),
        default=None,
        doc="integrals over the terms of the mass, for floating frames",
        when="free bodies",
    )
    displacement: Mapping[str, Floats] = dataset(
        "real", "N 3", "displacement of the nodes per unit of a morph", "m", name="displacement/*"
    )


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
