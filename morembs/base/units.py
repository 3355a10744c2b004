"""Units of the input; everything inside morembs is SI (m, kg, s, N, Pa), and frequencies are stated in Hz."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats

Rate = TypeVar("Rate", float, Floats)
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
MASS = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237, "slug": 14.593902937206364, "slinch": 175.12683524647636}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}


@dataclass(frozen=True, kw_only=True)
class Units:
    """Factors to SI of length, mass and time, and the names they were declared by."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0
    name: str = "m-kg-s"

    @property
    def density(self) -> float:
        """kg/m3 of one unit of density."""
        return self.mass / self.length**3

    @property
    def stress(self) -> float:
        """Pa of one unit of stress or elastic modulus."""
        return self.mass / (self.length * self.time**2)

    @property
    def stiffness(self) -> float:
        """N/m of one unit of translational stiffness."""
        return self.mass / self.time**2


def parse_units(given: str | Mapping[str, str]) -> Units:
    """Units from ``"mm-t-s"`` or ``{"length": "mm", "mass": "t", "time": "s"}``.

    Args:
        given: name of a system, or units of length, mass and time.

    Raises:
        InputError: a unit or a key that is not known, or one that is missing.

    >>> parse_units("mm-t-s").length
    0.001
    """
    if isinstance(given, str):
        parts = given.split("-")
        if len(parts) != 3:
            expected = '"length-mass-time" such as "mm-t-s" or, for SI, "m-kg-s"'
            raise InputError(f'units = "{given}" was given; expected {expected}', keyword="units")
        given = dict(zip(("length", "mass", "time"), parts, strict=True))
    tables = {"length": LENGTH, "mass": MASS, "time": TIME}
    for key in given:
        if key not in tables:
            raise InputError(
                f"units has the key {key!r}; expected length, mass and time ({nearest(key, tables)})", kind="unknown"
            )
    factors = {}
    for key, table in tables.items():
        if key not in given:
            raise InputError(f"units gives no {key}; expected all of length, mass and time", kind="missing")
        unit = given[key]
        if unit not in table:
            raise InputError(f"units gives {key} = {unit!r}; {nearest(unit, table)}", kind="unknown")
        factors[key] = table[unit]
    return Units(**factors, name="-".join(given[key] for key in tables))


def in_hz(omega: Rate) -> Rate:
    """Frequencies in Hz of ``omega`` in rad/s, of any shape."""
    return omega / (2 * np.pi)


def angular_band(band_hz: Sequence[float]) -> tuple[float, float]:
    """Ends of a band in rad/s, from those in Hz."""
    low, high = band_hz
    return 2 * np.pi * low, 2 * np.pi * high


def eigenvalue_in_hz(value: Any) -> Any:
    """Frequencies in Hz of eigenvalues in (rad/s)2, of any shape; zero of those below zero, which are round-off."""
    return in_hz(np.sqrt(np.maximum(value, 0.0)))
