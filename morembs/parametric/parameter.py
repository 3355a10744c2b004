"""Parameters of a body: what varies, and between which values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats
from morembs.storage.table import dataset, derived

if TYPE_CHECKING:
    from morembs.problem.damping import Damping

# What may vary, and the unit of its values in SI.
PROPERTIES = {"young": "Pa", "density": "kg/m3", "morph": "", "spring": "", "preload": "", "alpha": "1/s", "beta": "s"}
DAMPING = ("alpha", "beta")
NAME = r"^[A-Za-z_][A-Za-z0-9_]*$"


@dataclass(frozen=True, kw_only=True)
class Spring:
    """Six ``stiffness`` values along and about the axes of the model, three in N/m and three in Nm, which hold the
    frame of an ``interface`` to the ground, or to the frame of another (``to``) that carries it along."""

    interface: str
    stiffness: tuple[float, ...]
    to: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Parameter:
    """One parameter, in SI units.

    ``kind`` is one of ``PROPERTIES``; ``low``, ``high`` its range and ``nominal`` a value in it; ``sets`` names of
    element sets for "young" and "density"; ``displacement`` (n, 3) of the nodes in m per unit of a "morph";
    ``spring`` at the value 1 of a "spring". A "preload" is a factor of loads.

    Raises:
        InputError: an unknown property, a name that cannot be used, or values that do not fit together.

    >>> Parameter(name="E", kind="young", low=1.5e11, high=2.7e11, nominal=2.1e11).unit
    'Pa'
    """

    name: str
    kind: str
    low: float
    high: float
    nominal: float
    sets: tuple[str, ...] = ("all",)
    displacement: Floats | None = None
    spring: Spring | None = None

    def __post_init__(self) -> None:
        if not re.match(NAME, self.name):
            raise InputError(
                f"parameter {self.name!r}: expected a name of letters, digits and _ that begins with a letter",
                keyword="name",
            )
        if self.kind not in PROPERTIES:
            raise InputError(
                f"parameter {self.name}: property = {self.kind!r} was given; {nearest(self.kind, PROPERTIES)}",
                kind="unknown",
                keyword="property",
            )
        if not (np.isfinite([self.low, self.high]).all() and self.low < self.high):
            raise self._refuse_range("[LOW, HIGH] with LOW < HIGH")
        if self.kind in ("young", "density", "spring") and not self.low > 0:
            raise self._refuse_range("positive values")
        if self.kind in (*DAMPING, "preload") and self.low < 0:
            raise self._refuse_range("values of zero or more")
        if not self.low <= self.nominal <= self.high:
            raise InputError(
                f"parameter {self.name}: nominal = {self.nominal:g} lies outside [{self.low:g}, {self.high:g}]; widen "
                "the range, or give another nominal value",
                keyword="nominal",
            )

        if (self.kind == "spring") != (self.spring is not None):
            raise InputError(
                f"parameter {self.name}: a spring needs its stiffness, and only that",
                kind="missing",
                keyword="stiffness",
            )
        if self.spring is not None:
            k = self.spring.stiffness
            if len(k) != 6 or not np.isfinite(k).all() or min(k) < 0 or not max(k) > 0:
                raise InputError(
                    f"parameter {self.name}: stiffness = {list(k)} was given; expected six numbers of zero or more, "
                    "some of them above",
                    keyword="stiffness",
                )

    def _refuse_range(self, expected: str) -> InputError:
        return InputError(
            f"parameter {self.name}: range = [{self.low:g}, {self.high:g}] was given; expected {expected}",
            keyword="range",
        )

    @property
    def unit(self) -> str:
        """Unit of its values."""
        return PROPERTIES[self.kind]


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """Named ranges of P parameters: ``kinds`` of ``PROPERTIES``, ``low``, ``high`` and ``nominal`` (P,)."""

    names: tuple[str, ...] = dataset("text", "P", "names of the parameters")
    kinds: tuple[str, ...] = dataset(
        "text",
        "P",
        "what each changes",
        doc="what each changes: `young`, `density`, `morph`, `spring`, `preload`, `alpha` or `beta`",
    )
    low: Floats = dataset("real", "P", "least values")
    high: Floats = dataset("real", "P", "largest values")
    nominal: Floats = dataset("real", "P", "values of /bodies/NAME itself")

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Box:
        """That of ``parameters``.

        Raises:
            InputError: two of one name.
        """
        names = tuple(parameter.name for parameter in parameters)
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two parameters are named {name!r}; give each its own name", kind="conflict")
        low, high, nominal = (
            np.array([getattr(parameter, key) for parameter in parameters], dtype=float)
            for key in ("low", "high", "nominal")
        )
        return cls(names=names, kinds=tuple(each.kind for each in parameters), low=low, high=high, nominal=nominal)

    @derived("text", "P", "units of the values", doc="SI units of the values")
    def units(self) -> tuple[str, ...]:
        """Units of the values."""
        return tuple(PROPERTIES[kind] for kind in self.kinds)

    @property
    def morphs(self) -> tuple[int, ...]:
        """Numbers of the parameters that are morphs."""
        return tuple(number for number, kind in enumerate(self.kinds) if kind == "morph")

    def affine(self, terms: Floats, p: Floats) -> Floats:
        """X0 + sum_i t_i X_i over the morphs i, at ``p`` (P,): of ``terms`` (..., 1 + morphs)."""
        return np.asarray(terms @ np.concatenate([[1.0], p[list(self.morphs)]]))

    def damping(self, nominal: Damping, p: Floats) -> Damping:
        """The damping at ``p`` (P,): that of ``nominal`` values, with the alpha and beta that are parameters."""
        values: dict[str, Any] = {kind: float(x) for kind, x in zip(self.kinds, p, strict=True) if kind in DAMPING}
        return replace(nominal, **values) if values else nominal

    def point(self, values: Mapping[str, float]) -> Floats:
        """Values (P,) of all parameters; omitted ones are nominal.

        Raises:
            InputError: an unknown name, or a value outside its range.
        """
        p = self.nominal.copy()
        for name, value in values.items():
            if name not in self.names:
                raise InputError(
                    f"parameter {name!r} was given; {nearest(name, self.names)}", kind="unknown", keyword=name
                )
            p[self.names.index(name)] = value
        return self.checked(p)

    def checked(self, p: Floats) -> Floats:
        """``p`` (..., P) as numbers inside the box.

        Raises:
            InputError: another number of values, or one outside its range.
        """
        p = np.asarray(p, dtype=float)
        if p.shape[-1:] != self.low.shape:
            raise InputError(
                f"values of the shape {p.shape} were given; expected one for each of {', '.join(self.names)}"
            )
        outside = ~((p >= self.low) & (p <= self.high))
        if outside.any():
            at = tuple(np.argwhere(outside)[0])
            j = int(at[-1])
            raise InputError(
                f"{self.names[j]} = {p[at]:.6g} lies outside [{self.low[j]:.6g}, {self.high[j]:.6g}]; the bound does "
                "not hold there (values are in SI units)",
                keyword=self.names[j],
            )
        return p
