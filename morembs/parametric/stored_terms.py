"""Terms of a model with parameters in its model file, and the model that they are at a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Floats
from morembs.fem import FEModel, Nodes
from morembs.fem.assembly import mass_matrix
from morembs.fem.model_terms import ModelTerms
from morembs.parametric.law import Law
from morembs.parametric.parameter import Box
from morembs.parametric.varied import VariedModel


def terms_of(varied: VariedModel) -> ModelTerms:
    """The terms of ``varied`` for its model file. Peak memory: that of all terms.

    >>> write_model("part.model.h5", varied.model(varied.box.nominal), terms=terms_of(varied)).name
    'part.model.h5'
    """
    box, law_K, law_M = varied.box, varied.law_K, varied.mass.law
    K = [varied.stiffness_sum(theta) for theta in np.eye(len(law_K.factors))]
    M = [mass_matrix(varied.graph, varied.mass.combine(theta)) for theta in np.eye(len(varied.mass))]
    for A in (*K, *M):
        A.eliminate_zeros()
    return ModelTerms(
        names=box.names,
        kinds=box.kinds,
        low=box.low,
        high=box.high,
        nominal=box.nominal,
        law_K=law_K.factors,
        law_M=law_M.factors,
        points_K=_points(box, law_K),
        points_M=_points(box, law_M),
        K=tuple(K),
        M=tuple(M),
        displacement={
            box.names[number]: d for number, d in zip(varied.morph.which, varied.morph.displacements, strict=True)
        },
    )


def _points(box: Box, law: Law) -> dict[str, Floats]:
    return {name: points for name, points in zip(box.names, law.points, strict=True) if len(points)}


def box_of(terms: ModelTerms) -> Box:
    """The ranges of the parameters of ``terms``."""
    return Box(names=terms.names, kinds=terms.kinds, low=terms.low, high=terms.high, nominal=terms.nominal)


def displacement_at(terms: ModelTerms, p: Floats) -> Floats | None:
    """(N, 3) by how much the nodes move from nominal values to ``p`` (P,); None where nothing moves them."""
    moved = [
        (p[number] - terms.nominal[number]) * terms.displacement[name]
        for number, name in enumerate(terms.names)
        if name in terms.displacement
    ]
    return np.sum(moved, axis=0) if moved else None


def model_at(model: FEModel, terms: ModelTerms, p: Floats) -> FEModel:
    """The model at ``p`` (P,) as the sum of its ``terms``; ``model`` is that of nominal values.

    Raises:
        InputError: a value outside its range.

    >>> model_at(model, terms, terms.nominal).size == model.size
    True
    """
    p = box_of(terms).checked(p)
    K, M = (
        _sum(parts, Law(factors=factors, points=_points_by_number(terms, points))(p))
        for parts, factors, points in ((terms.K, terms.law_K, terms.points_K), (terms.M, terms.law_M, terms.points_M))
    )
    away = displacement_at(terms, p)
    nodes = model.nodes
    if away is not None:
        nodes = Nodes(ids=nodes.ids, xyz=nodes.xyz + away, sets=nodes.sets)
    return replace(model, K=K, M=M, nodes=nodes, mesh=None, materials=())


def _points_by_number(terms: ModelTerms, points: Mapping[str, Floats]) -> tuple[Floats, ...]:
    return tuple(np.asarray(points.get(name, np.zeros(0))) for name in terms.names)


def _sum(parts: tuple[sp.csr_array, ...], theta: Floats) -> sp.csr_array:
    total = parts[0] * theta[0]
    for factor, part in zip(theta[1:], parts[1:], strict=True):
        total = total + factor * part
    return sp.csr_array(total)
