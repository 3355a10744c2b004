"""Rigid and average elements of a model, and the dofs that depend on others through them (multi-point constraints)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morembs.model.arrays import frozen

if TYPE_CHECKING:
    import scipy.sparse as sp

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidElement:
    """Nodes that follow ``master`` as a rigid body (RBE2, kinematic coupling, *RIGID BODY).

    ``master`` a row of the nodes, ``slaves`` (k,) rows, ``components`` those of the slaves that follow (0..5).
    """

    name: str
    master: int
    slaves: Ints
    components: tuple[int, ...] = (0, 1, 2, 3, 4, 5)

    def __post_init__(self) -> None:
        object.__setattr__(self, "slaves", frozen(np.asarray(self.slaves, dtype=np.int64)))


@dataclass(frozen=True, kw_only=True, eq=False)
class AverageElement:
    """A ``reference`` node that follows the mean motion of ``nodes`` (k,) with ``weights`` (k,) (RBE3, distributing
    coupling); ``components`` are those of the reference that follow."""

    name: str
    reference: int
    nodes: Ints
    weights: Floats
    components: tuple[int, ...] = (0, 1, 2, 3, 4, 5)

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", frozen(np.asarray(self.nodes, dtype=np.int64)))
        object.__setattr__(self, "weights", frozen(np.asarray(self.weights, dtype=np.float64)))


@dataclass(frozen=True, kw_only=True, eq=False)
class DependentDofs:
    """u = S u_free: dofs that depend on others.

    ``S`` (N, N) rows of the identity for independent dofs, and for dependent ones their coefficients; columns of
    dependent dofs are empty. ``owner`` (N,) index in ``names`` of the element that a dof depends on, -1 for
    independent dofs.
    """

    S: sp.csr_array
    owner: Ints
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "owner", frozen(np.asarray(self.owner, dtype=np.int64)))
