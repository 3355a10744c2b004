"""Python values as arrays of the few types that every HDF5 reader knows."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """A dataclass as a mapping, anything else as it is."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    return value


def storable(value: object) -> Any:
    """An array of a type that every reader knows: i8, f8 (or f4), u1 or fixed-length text; else JSON."""
    if isinstance(value, str | Path | date):
        return text(str(value)).reshape(())
    if isinstance(value, list | tuple) and value and all(isinstance(v, str) for v in value):
        return text(*value)
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.asarray(None)
    if array.dtype == np.uint8 or array.dtype.kind == "S":
        return array
    for kinds, wanted in (("b", np.uint8), ("iu", np.int64), ("f", np.float64)):
        if array.dtype.kind in kinds:
            return array.astype(wanted, copy=False)
    return np.bytes_(json_text(value))


def text(*lines: str) -> Any:
    """Fixed-length text (k,): UTF-8 under the type of ASCII, as Octave stops reading at any other type."""
    return np.array([line.encode("utf-8", "surrogateescape") or b" " for line in lines], dtype=None if lines else "S1")


def json_text(value: object) -> str:
    """JSON in ASCII with sorted keys."""

    def simple(inner: Any) -> object:
        if isinstance(inner, np.ndarray | np.generic):
            return inner.tolist()
        return dict(inner) if isinstance(inner, Mapping) else str(inner)

    return json.dumps(value, sort_keys=True, default=simple)
