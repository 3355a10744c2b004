"""What an object shows of itself in a session: one or two lines of text, a small table in a notebook.

The text that Python makes for a dataclass holds all of its arrays, hundreds of lines.
"""

from __future__ import annotations

import html
import math
import textwrap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from morembs.base.tolerances import TOL

Class = TypeVar("Class", bound=type)


def summarised(kind: Class) -> Class:
    """Decorator: show what the method ``_facts`` of the class tells, name -> value; by default all fields.

    In a notebook the HTML that ``_picture`` gives stands below, where the class has it.
    """
    for name, shown in (("__repr__", _text), ("_repr_html_", _table)):
        setattr(kind, name, shown)
    return kind


def hertz(frequencies: NDArray[np.float64]) -> str:
    """``120.5, 377.1, 412 ... Hz``."""
    shown = ", ".join(f"{f:,.4g}" for f in frequencies[: TOL.shown_values])
    return f"{shown}{' ...' * (len(frequencies) > TOL.shown_values)} Hz" if shown else "none"


def kinds_words(kinds: Collection[str]) -> str:
    """``12 constraint + 30 fixed-interface``."""
    names = list(kinds)
    return " + ".join(f"{names.count(kind)} {kind}" for kind in dict.fromkeys(names))


def upwards(value: float) -> str:
    """A limit in words, never less than ``value``."""
    if not np.isfinite(value):
        return "unbounded"
    shown = f"{value:.1e}"
    if float(shown) < value:
        digits, power = shown.split("e")
        # One more in the last digit that is shown.
        shown = f"{float(digits) + 0.1:.1f}e{power}"
    return shown


def error_words(measure: str, upper: float, sampled: NDArray[np.float64], band_hz: Sequence[float], kind: str) -> str:
    """``at most 1.3e-04 (envelope, 10 to 2,000 Hz, proven)``; the largest at samples where there is no limit."""
    low, high = (f"{float(f):,.6g}" for f in band_hz)
    if kind == "sampled":
        return f"{float(np.max(sampled, initial=0.0)):.1e} at samples from {low} to {high} Hz"
    return f"at most {upwards(upper)} ({measure}, {low} to {high} Hz, {kind})"


def _facts(instance: Any) -> Mapping[str, object]:
    if hasattr(instance, "_facts"):
        return dict(instance._facts())
    named = fields(instance) if is_dataclass(instance) else ()
    return {each.name: getattr(instance, each.name) for each in named if each.repr}


def _words(value: Any) -> str:
    """A value in a few words: the shape of an array, how many a collection holds."""
    if isinstance(value, np.ndarray) and value.size <= TOL.shown_values and value.dtype.kind in "if":
        return str([float(f"{v:.4g}") for v in value.ravel()])
    if hasattr(value, "shape") and not isinstance(value, np.generic):
        return f"{'×'.join(map(str, value.shape))} numbers"
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.6g}"
    if isinstance(value, str):
        # The end of a path says more than its beginning.
        return value if len(value) <= TOL.text_characters else f"...{value[-TOL.text_characters :]}"
    max_values = TOL.shown_values
    if isinstance(value, Collection) and (len(value) > max_values or not all(isinstance(v, str | int) for v in value)):
        return f"{len(value)} of them"
    if isinstance(value, Collection):
        return ", ".join(map(str, value)) or "none"
    return str(value) if isinstance(value, int | float | np.generic) else type(value).__name__


def _format_facts(instance: Any) -> dict[str, str]:
    """The facts in words, without missing ones."""
    return {name: _words(value) for name, value in _facts(instance).items() if value is not None and not _empty(value)}


def _empty(value: object) -> bool:
    return isinstance(value, Collection) and not hasattr(value, "shape") and not len(value)


def _text(instance: Any) -> str:
    facts = "; ".join(f"{name} {words}" for name, words in _format_facts(instance).items())
    whole = " ".join(f"{type(instance).__name__}: {facts}".split())
    lines = textwrap.wrap(
        whole, TOL.text_columns, max_lines=2, subsequent_indent="    ", placeholder=" ...", break_on_hyphens=False
    )
    return "\n".join(lines)


def _table(instance: Any) -> str:
    rows = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th><td style='text-align:left'>{html.escape(words)}</td>"
        "</tr>"
        for name, words in _format_facts(instance).items()
    )
    picture = instance._picture() if hasattr(instance, "_picture") else ""
    return f"<table><caption>{html.escape(type(instance).__name__)}</caption>{rows}</table>{picture}"
