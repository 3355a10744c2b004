"""Limits of values, written with their types: ``order: PositiveCount``. Checks, messages, tables of docs read them."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, get_args

from morembs.base.tolerances import TOL

_NUMBERS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}


@dataclass(frozen=True, eq=False)
class Domain:
    """``words`` for the values that pass a test, the test, and its form in a JSON schema."""

    words: str
    passes: Callable[[Any], bool] = lambda _: True
    schema: Mapping[str, object] = field(default_factory=dict)
    names: tuple[str, ...] = ()


def number(words: str, **ends: float) -> Domain:
    """A finite number within ``ge``, ``gt`` (low ends), ``le`` and ``lt`` (high ends), as far as they are given."""
    low, above = ends.get("ge", -sys.float_info.max), ends.get("gt", -float("inf"))
    high, below = ends.get("le", sys.float_info.max), ends.get("lt", float("inf"))
    return Domain(
        words,
        lambda value: bool(low <= value <= high and above < value < below),
        {_NUMBERS[end]: value for end, value in ends.items()},
    )


def text(words: str, pattern: str = ".", longest: int | None = None) -> Domain:
    """A text in which ``pattern`` is found, no longer than ``longest``; by default any but the empty one."""
    max_length = {} if longest is None else {"maxLength": longest}
    # "$" of JSON is the end of a text, also where its last character ends a line.
    found = re.compile(re.sub(r"\$$", r"\\Z", pattern), re.DOTALL)
    return Domain(
        words,
        lambda value: found.search(value) is not None and len(value) <= (longest or len(value)),
        {"pattern": pattern, **max_length} if pattern != "." else {"minLength": 1, **max_length},
    )


def length(words: str, least: int, max_count: int | None = None) -> Domain:
    """A sequence of ``least`` values, or of ``least`` to ``max_count`` values (``sys.maxsize``: no upper limit)."""
    top = least if max_count is None else max_count
    schema = {"minItems": least} | ({} if top == sys.maxsize else {"maxItems": top})
    return Domain(words, lambda value: least <= len(value) <= top, schema)


def one_of(*names: str) -> Domain:
    """One of some texts."""
    return Domain(alternatives(names), lambda value: value in names, {"enum": list(names)}, names)


def choices(hint: Any) -> tuple[str, ...]:
    """The texts that a hint with ``one_of`` takes; none for other hints."""
    limits = [part for part in get_args(hint)[1:] if isinstance(part, Domain)]
    return next((limit.names for limit in limits if limit.names), ())


def alternatives(values: Sequence[object]) -> str:
    """``"a", "b" or "c"``."""
    quoted = [f'"{value}"' if isinstance(value, str) else str(value) for value in values]
    return " or ".join([", ".join(quoted[:-1]), quoted[-1]] if quoted[1:] else quoted)


def _is_direction(value: Sequence[float]) -> bool:
    return len(value) == 3 and any(value)


Finite = Annotated[float, number("a number")]
Positive = Annotated[float, number("a positive number", gt=0)]
NotNegative = Annotated[float, number("a number, zero or more", ge=0)]
# Parts and errors are relative: of a response, a stiffness, a mass.
RelativeError = Annotated[float, number("a relative error between 0 and 1, such as 1e-3", gt=0, lt=1)]
Part = Annotated[float, number("a part between 0 and 1", gt=0, lt=1)]
DampingRatio = Annotated[
    float, number("a part of critical damping from 0 to 1, such as 0.02 for 2 percent", ge=0, le=1)
]
DampingFloor = Annotated[float, number("a part of critical damping from 0 to below 1, such as 0.01", ge=0, lt=1)]
PoissonRatio = Annotated[float, number("a number between -1 and 0.5 (exclusive; for rubber take 0.49)", gt=-1, lt=0.5)]
Restitution = Annotated[float, number("a coefficient of restitution from 0 to 1", ge=0, le=1)]
SpectralRadius = Annotated[float, number("a spectral radius from 0 (the most damping) to 1 (none)", ge=0, le=1)]
# Numbers whose products are finite: loads and motions.
_AT_MOST = f"{TOL.largest_value:g} at most"
Bounded = Annotated[float, number(f"a finite number, {_AT_MOST}", ge=-TOL.largest_value, le=TOL.largest_value)]
Magnitude = Annotated[float, number(f"zero or a positive number, {_AT_MOST}", ge=0, le=TOL.largest_value)]
Vector = Annotated[Sequence[Bounded], length(f"3 finite numbers, {_AT_MOST}", 3)]
Wrench = Annotated[Sequence[Bounded], length(f"6 finite numbers, {_AT_MOST}", 6)]
Direction = Annotated[
    Sequence[Bounded], Domain(f"a direction: 3 finite numbers, {_AT_MOST}, not all zero", _is_direction)
]
Hertz = Annotated[float, number(f"a frequency in Hz from 0 to {TOL.largest_hz:g}", ge=0, lt=TOL.largest_hz)]
PositiveHertz = Annotated[
    float, number(f"a positive frequency in Hz below {TOL.largest_hz:g}", gt=0, lt=TOL.largest_hz)
]
Count = Annotated[int, number("an integer, zero or more", ge=0)]
PositiveCount = Annotated[int, number("an integer, 1 or more", ge=1)]
