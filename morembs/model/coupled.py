"""A finite-element model with the rigid and average elements of the file that it came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.imported import AverageElement, RigidElement
from morembs.model.fe_model import FEModel, frozen

if TYPE_CHECKING:
    from morembs.interface import Interface

Ints = NDArray[np.int64]
# Matrices that came as text differ from their transposes by round-off.
SYMMETRIC = 1e-8


@dataclass(frozen=True, kw_only=True, eq=False)
class Followers:
    """u = S u^: dofs that follow others.

    ``S`` (N, N) rows of the identity for dofs that are free, and for followers what free dofs give them; columns of
    followers are empty. ``owner`` (N,) index in ``names`` of the element that a dof follows, -1 for free dofs.
    """

    S: sp.csr_array
    owner: Ints
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "owner", frozen(np.asarray(self.owner, dtype=np.int64)))


@dataclass(frozen=True, kw_only=True, eq=False)
class CoupledModel(FEModel):
    """An ``FEModel`` whose matrices cover all dofs, followers included; these go when it is coupled.

    ``rigid`` and ``average`` are the elements that make ``followers``; masters and references are nodes with dofs of
    their own. ``couplings`` offers each of them by name as an interface. ``notes`` say what the import found.
    """

    rigid: tuple[RigidElement, ...] = ()
    average: tuple[AverageElement, ...] = ()
    followers: Followers | None = None
    couplings: Mapping[str, Interface] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "couplings", MappingProxyType(dict(self.couplings)))


def refuse_complex(model: FEModel) -> None:
    """Refuse complex matrices, as reductions take real ones.

    Raises:
        InputError: as said.
    """
    for name in ("K", "M", "D"):
        A = getattr(model, name)
        if A is not None and A.dtype.kind == "c":
            raise InputError(
                f"{name} of {model.source or 'the model'} is complex, and reductions take real matrices; import "
                "its real part, and give structural damping as [damping] structural"
            )


def refuse_unsymmetric(model: FEModel) -> None:
    """Refuse K and M that are not symmetric, as reductions take symmetric ones.

    A z and A' z are compared for one fixed random z: vectors only, and no symmetric matrix is refused.

    Raises:
        InputError: as said.
    """
    for name in ("K", "M"):
        A = getattr(model, name)
        z = np.random.default_rng(60).standard_normal(A.shape[0])
        largest = max(abs(float(A.data.max(initial=0.0))), abs(float(A.data.min(initial=0.0))))
        found = float(np.abs(A @ z - A.T @ z).max(initial=0.0))
        if found > SYMMETRIC * largest:
            raise InputError(
                f"{name} of {model.source or 'the model'} is not symmetric (by {found / largest:.1e} of its largest "
                "entry), and reductions take symmetric matrices; leave out circulatory terms, friction and contact"
            )
