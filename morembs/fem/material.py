"""Linear elastic materials in SI units. Voigt order xx, yy, zz, yz, zx, xy with engineering shear strains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from morembs.base.arguments import check_value, checked
from morembs.base.errors import InputError
from morembs.base.limits import PoissonRatio, Positive
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.fem.tolerances import TOL
from morembs.storage.table import dataset

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1))


@checked
@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Material:
    """``stiffness`` (6, 6) in Pa and ``density`` in kg/m3 of the element set ``set``.

    >>> steel
    Material: set all; stiffness 6×6 numbers; density 7850
    """

    made_by: ClassVar[str] = "isotropic(set=..., young=..., poisson=..., density=...)"

    set: str = dataset("words", "materials", name="sets", doc="sets of elements")
    stiffness: Floats = dataset("real", "materials 6 6", "Voigt order xx, yy, zz, yz, zx, xy, engineering shears", "Pa")
    density: float = dataset("real", "materials", units="kg/m3", doc="density")

    def __post_init__(self) -> None:
        check_value(f"material of set {self.set!r}: density in kg/m3", self.density, Positive)
        if np.shape(self.stiffness) != (6, 6) or not np.isfinite(self.stiffness).all():
            raise InputError(
                f"material of set {self.set!r}: a stiffness of the shape {np.shape(self.stiffness)} was given; "
                "expected (6, 6) finite numbers",
                keyword="stiffness",
            )
        if np.linalg.eigvalsh(self.stiffness)[0] <= 0:
            raise InputError(
                f"material of set {self.set!r}: the elastic constants give no positive strain energy; check that "
                "the moduli are positive and Poisson's ratios within their limits",
                kind="model",
            )


@checked
def isotropic(*, set: str, young: float, poisson: float, density: float) -> Material:
    """Isotropic material from Young's modulus (Pa), Poisson's ratio and density (kg/m3).

    Args:
        set: name of a set of elements, or "all".
        young: Young's modulus in Pa.
        poisson: Poisson's ratio.
        density: in kg/m3.

    Raises:
        InputError: modulus or density not positive, or Poisson's ratio outside (-1, 0.5).

    >>> isotropic(set="all", young=70e9, poisson=0.33, density=2700.0).density
    2700.0
    """
    check_value(f"material of set {set!r}: young in Pa", young, Positive)
    check_value(f"material of set {set!r}: poisson", poisson, PoissonRatio)
    lam = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    mu = young / (2 * (1 + poisson))
    C = np.diag([2 * mu] * 3 + [mu] * 3)
    C[:3, :3] += lam
    return Material(set=set, stiffness=C, density=density)


@checked
def orthotropic(
    *,
    set: str,
    young: tuple[float, float, float],
    poisson: tuple[float, float, float],
    shear: tuple[float, float, float],
    density: float,
    axes: Floats | None = None,
) -> Material:
    """Orthotropic material from engineering constants.

    Args:
        young: E1, E2, E3 in Pa.
        poisson: nu12, nu13, nu23 (nu12 is the contraction along 2 under tension along 1).
        shear: G12, G13, G23 in Pa.
        axes: (3, 3) rows are the material directions 1, 2, 3 in the model's frame; None for its own axes.

    Raises:
        InputError: constants that give no positive strain energy, or axes that are not orthonormal.

    >>> ply = orthotropic(set="all", young=(140e9, 10e9, 10e9), poisson=(0.3, 0.3, 0.4), shear=(5e9, 5e9, 3.5e9),
    ...                   density=1600.0)
    >>> bool(ply.stiffness[0, 0] > ply.stiffness[1, 1])
    True
    """
    E1, E2, E3 = young
    nu12, nu13, nu23 = poisson
    G12, G13, G23 = shear
    for name, moduli in (("young", young), ("shear", shear)):
        check_value(f"material of set {set!r}: {name} in Pa", moduli, tuple[Positive, Positive, Positive])
    S = np.zeros((6, 6))
    S[:3, :3] = [[1 / E1, -nu12 / E1, -nu13 / E1], [-nu12 / E1, 1 / E2, -nu23 / E2], [-nu13 / E1, -nu23 / E2, 1 / E3]]
    S[3, 3], S[4, 4], S[5, 5] = 1 / G23, 1 / G13, 1 / G12
    if np.linalg.eigvalsh(S)[0] <= 0:
        raise InputError(
            f"material of set {set!r}: poisson = {poisson} (nu12, nu13, nu23) with young = {young} Pa gives no "
            "positive strain energy; expected |nu_ij| < sqrt(E_i / E_j)",
            kind="missing",
            keyword="poisson",
        )
    C: Floats = np.asarray(np.linalg.inv(S), dtype=np.float64)
    if axes is not None:
        Q = np.asarray(axes, dtype=float)
        if Q.shape != (3, 3) or not np.allclose(Q @ Q.T, np.eye(3), atol=TOL.axes_error):
            raise InputError(f"material of set {set!r}: axes must be three orthonormal rows; got {Q.tolist()}")
        C = _rotate(C, Q)
    return Material(set=set, stiffness=C, density=density)


def _rotate(C: Floats, Q: Floats) -> Floats:
    """C given along the rows of Q, in the model's frame (tensor rotation through the fourth-order form)."""
    tensor = np.zeros((3, 3, 3, 3))
    for p, (i, j) in enumerate(VOIGT):
        for q, (k, m) in enumerate(VOIGT):
            tensor[i, j, k, m] = tensor[j, i, k, m] = tensor[i, j, m, k] = tensor[j, i, m, k] = C[p, q]
    turned = np.einsum("abcd,ai,bj,ck,dl->ijkl", tensor, Q, Q, Q, Q)
    return np.array([[turned[i, j, k, m] for k, m in VOIGT] for i, j in VOIGT])
