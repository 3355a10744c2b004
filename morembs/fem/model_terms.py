"""The terms of a model with parameters: K(p) = sum_q a_q(p) K_q and M(p) = sum_j b_j(p) M_j, as files have them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from morembs.base.types import Floats, Ints
from morembs.fem.stored import matrix_table
from morembs.storage.table import dataset

if TYPE_CHECKING:
    import scipy.sparse as sp

_LAW = "factors of the coefficient of each term of K: 0: 1; 1: p; 2: p^2; 3 + k: Lagrange polynomial of point k of p"


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelTerms:
    """Terms ``K`` and ``M``, each (N, N), with the factors of their coefficients ``law_K`` (Q, P) and ``law_M`` (J, P).

    P parameters have ``names``, ``kinds``, ranges from ``low`` to ``high`` and ``nominal`` values, at which the model
    file has its own K and M. ``points_K`` and ``points_M`` are the points of the Lagrange polynomials by the names of
    parameters. ``displacement`` (N, 3) moves the nodes, in m per unit of a morph, by its name.

    >>> terms = ModelTerms(
    ...     names=("E",), kinds=("young",), low=np.array([1.0]), high=np.array([3.0]), nominal=np.array([2.0]),
    ...     law_K=np.array([[1]]), law_M=np.array([[0]]), K=(K,), M=(M,),
    ... )
    """

    names: tuple[str, ...] = dataset("text", "P", "names of the parameters")
    kinds: tuple[str, ...] = dataset("text", "P", "what each changes, as in a body file with parameters")
    low: Floats = dataset("real", "P", "least values")
    high: Floats = dataset("real", "P", "largest values")
    nominal: Floats = dataset("real", "P", "values of /matrices")
    law_K: Ints = dataset("whole", "Q P", _LAW, name="law/K")
    law_M: Ints = dataset("whole", "J P", "the same of each term of M", name="law/M")
    points_K: Mapping[str, Floats] = dataset(
        "real",
        "any",
        "points of a parameter with Lagrange polynomials in K",
        name="law/points_K/*",
        default_factory=dict,
    )
    points_M: Mapping[str, Floats] = dataset(
        "real", "any", "the same in M", name="law/points_M/*", default_factory=dict
    )
    K: tuple[sp.csr_array, ...] = dataset(matrix_table(""), name="K_#", doc="term of the stiffness, as matrices/K")
    M: tuple[sp.csr_array, ...] = dataset(matrix_table(""), name="M_#", doc="term of the mass, as matrices/M")
    displacement: Mapping[str, Floats] = dataset(
        "real", "N 3", "displacement of the nodes per unit of a morph", "m", name="displacement/*", default_factory=dict
    )
