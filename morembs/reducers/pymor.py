"""Models to pyMOR and back, so that its reductors can be used, and their results certified."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.optional import optional
from morembs.base.types import Floats
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.reducers.tolerances import TOL


@checked
def to_pymor(model: Problem | ReducedModel) -> Any:
    """``model`` as a ``pymor.models.iosys.SecondOrderModel``: M u'' + E u' + K u = B f, y = Cp u.

    Of a ``Problem`` the sparse matrices in coupled dofs with B and its transpose, of a ``ReducedModel`` the dense ones.
    E is the damping matrix, with that of Rayleigh damping.

    Args:
        model: sparse or reduced.

    Raises:
        InputError: pyMOR is not installed, or damping that has no matrix (modal, or structural).

    >>> to_pymor(held).order
    42
    """
    iosys = optional("pymor.models.iosys", "to_pymor")
    if isinstance(model, ReducedModel):
        if model.structural:
            raise InputError("structural damping has no matrix, which pyMOR needs; give Rayleigh damping or none")
        matrices = [model.M, model.D, model.K, model.B, model.C]
    else:
        damping = model.damping
        if damping.is_modal or damping.structural:
            raise InputError(
                "modal and structural damping have no matrix, which pyMOR needs; give Rayleigh damping or none"
            )
        E = damping.alpha * model.M + damping.beta * model.K
        B = sp.csr_array(model.B)
        # Inputs and outputs are dense in pyMOR: their operators hold rows that are ready.
        E = E if model.system.velocity_matrix is None else E + model.system.velocity_matrix
        K = model.K if model.N is None else model.K + model.N
        matrices = [model.M, E, K, B.toarray(), B.T.toarray()]
    return iosys.SecondOrderModel.from_matrices(*matrices)


def from_pymor(
    model: Any, *, name: str = "pymor", V: Floats | None = None, W: Floats | None = None, rigid_count: int = 0
) -> ReducedModel:
    """A reduced model from a pyMOR ``SecondOrderModel``, most often one that a reductor made of ``to_pymor(problem)``.

    Args:
        V: (Nc, n) basis of the displacements in coupled dofs, such as ``reductor.V.to_numpy()``, by which a body
            expands its motion; None where only the matrices are needed, as in ``certify``.
        W: (Nc, n) basis that the equations were tested with, where it is another. Without it, matrices that are
            symmetric but for round-off count as a Galerkin projection.
        rigid_count: rigid-body modes that the coordinates span; those of a model that is not symmetric come first.

    Raises:
        InputError: pyMOR is not installed, outputs of velocities or a feedthrough, matrices that do not fit V.

    >>> rom = to_pymor(reduced)                                      # or the result of a reductor of pyMOR
    >>> from_pymor(rom, V=reduced.V, rigid_count=6).order
    18
    """
    optional("pymor.models.iosys", "from_pymor")
    *given, Cv, D = model.to_matrices()
    M, E, K, B, Cp = (_dense(A) for A in given)
    if any(A is not None and np.any(_dense(A)) for A in (Cv, D)):
        raise InputError("the pyMOR model has outputs of velocities or a feedthrough; give one whose y is Cp u alone")
    n = len(K)
    if V is not None and np.shape(V)[1:] != (n,):
        raise InputError(f"V has the shape {np.shape(V)}; expected (any, {n}), one column for each coordinate")
    galerkin = W is None and all(_alike(*pair) for pair in ((Cp, B.T), (M, M.T), (E, E.T), (K, K.T)))
    if galerkin:
        M, E, K, Cp = (M + M.T) / 2, (E + E.T) / 2, (K + K.T) / 2, B.T
    none = np.zeros((0, n))
    return ReducedModel(
        name=name,
        M=M,
        K=K,
        D=E,
        B=B,
        C=Cp,
        V=none if V is None else np.asarray(V, dtype=float),
        W=None if galerkin else none if W is None else np.asarray(W, dtype=float),
        mode_kind=("foreign",) * n,
        rigid_count=rigid_count,
        recipe={"method": "pymor"},
    )


def _alike(A: Floats, B: Floats) -> bool:
    return A.shape == B.shape and bool(np.abs(A - B).max(initial=0.0) <= TOL.asymmetry * np.abs(A).max(initial=0.0))


def _dense(A: Any) -> Floats:
    return np.asarray(A.toarray() if sp.issparse(A) else A, dtype=float)
