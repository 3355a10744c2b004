"""Fields of a planar component in few functions, so that the cost online does not depend on its number of nodes.

All shapes of a reduced member, turned and moved, are sums of a few functions over the nodes: x and y of the positions
share ``U``, rotations have ``Ur``. Their amplitudes y take the place of the nodes, with the mass matrix U' M U.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.component import NonlinearComponent
from morembs.linalg.columns import fix_signs
from morembs.storage.table import dataset


@dataclass(frozen=True, kw_only=True, eq=False)
class Fields:
    """``U`` (n, r) and ``Ur`` (nr, rr) of mean square one; amplitudes are p = 2 r + rr numbers: x, y, rotations.

    ``translations`` (n, 2) and ``turning`` (nr,) are coordinates of the component, ``one`` (r,) and ``turn`` (rr,)
    amplitudes of a unit translation and rotation, ``M`` (p, p) the mass matrix.
    """

    U: Floats = dataset("real", "n r", "functions over the nodes, of the x and of the y of positions")
    Ur: Floats = dataset("real", "nr rr", "functions over the nodes, of rotations")
    translations: Ints = dataset("whole", "n 2", "per node: coordinates of the component that are its x and y")
    turning: Ints = dataset("whole", "nr", "per node: coordinate of the component that is its rotation")
    one: Floats = dataset("real", "r", "amplitudes of U for a unit translation")
    turn: Floats = dataset("real", "rr", "amplitudes of Ur for a unit turn")
    M: Floats = dataset("real", "p p", "mass matrix of the amplitudes: x, y, rotations", "kg, kg m2")

    @property
    def size(self) -> int:
        """p."""
        return int(2 * self.U.shape[1] + self.Ur.shape[1])

    @property
    def places(self) -> Ints:
        """(r, 2) numbers of the amplitudes of x and of y."""
        r = self.U.shape[1]
        return np.asarray(np.arange(r)[:, None] + np.array([0, r]), dtype=np.int64)

    def condense(self, x: Floats) -> Floats:
        """Amplitudes (p, ...) of fields x (N, ...)."""
        parts = [self.U.T @ x[self.translations[:, k]] / len(self.U) for k in (0, 1)]
        return np.concatenate((*parts, self.Ur.T @ x[self.turning] / max(1, len(self.Ur))))

    def expand(self, y: Floats) -> Floats:
        """Fields (N, ...) of amplitudes y (p, ...)."""
        x = np.zeros((self.translations.size + len(self.turning), *y.shape[1:]))
        for k in (0, 1):
            x[self.translations[:, k]] = self.U @ y[self.places[:, k]]
        x[self.turning] = self.Ur @ y[2 * self.U.shape[1] :]
        return x


def fields(component: NonlinearComponent, shapes: Floats) -> Fields:
    """Functions that span ``shapes`` (N, k), all unit translations and the unit rotation.

    Raises:
        InputError: a mass matrix that changes when the component is turned.
    """
    at = component.translations
    turning = np.setdiff1d(np.arange(component.size), at.ravel())
    M = component.M
    Mx, My = (M[at[:, k]][:, at[:, k]] for k in (0, 1))
    mixed = [M[at[:, 0]][:, at[:, 1]], M[at.ravel()][:, turning]]
    if max(abs(block).max() for block in (Mx - My, *mixed) if block.nnz) > TOL.mass_mismatch * abs(M).max():
        raise InputError(
            "the mass matrix couples x, y and rotations, or differs along x and y; expected one that stays the same "
            "when the component is turned. Take lumped or consistent masses of beams",
            kind="unsupported",
            keyword="mass",
        )
    U, m = _diagonal(orthogonal_functions(np.hstack((shapes[at[:, 0]], shapes[at[:, 1]]))), Mx)
    Ur, mr = _diagonal(orthogonal_functions(shapes[turning]), M[turning][:, turning])
    return Fields(
        U=U,
        Ur=Ur,
        translations=at,
        turning=turning,
        one=U.mean(axis=0),
        turn=Ur.sum(axis=0) / max(1, len(turning)),
        M=np.diag(np.concatenate((m, m, mr))),
    )


def orthogonal_functions(columns: Floats, kept: float = TOL.kept_singular_value) -> Floats:
    """Orthogonal functions of mean square one that span the columns (n, k) and the constant, which is the first."""
    if not len(columns):
        return np.zeros((0, 0))
    first = np.ones((len(columns), 1))
    rest = columns - columns.mean(axis=0)
    size = np.abs(columns).max(axis=0)
    left, values, _ = np.linalg.svd(rest[:, size > 0] / size[size > 0], full_matrices=False)
    # Vectors of small singular values are orthogonal to the first no better than round-off over these values.
    Q, _ = np.linalg.qr(np.hstack((first, left[:, values > kept * max(values.max(initial=0.0), 1.0)])))
    return fix_signs(Q * np.sqrt(len(columns)))


def _diagonal(U: Floats, M: sp.spmatrix) -> tuple[Floats, Floats]:
    """The same functions turned among themselves, so that the mass matrix is diagonal, and its diagonal."""
    if not U.size:
        return U, np.zeros(0)
    m, turned = np.linalg.eigh(U.T @ (M @ U))
    return fix_signs(U @ turned), np.maximum(m, 0.0)
