"""Kinds of datasets: conversion of values to arrays in a file, and of arrays to values."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.base.budget import current_budget
from morembs.base.errors import InputError
from morembs.storage.storable import json_text, storable, text


def _whole(item: Any) -> Any:
    return item[()]


def _within_budget(item: Any) -> Any:
    """An array that lies in a scratch file where the budget wants it there."""
    values = current_budget().empty(item.shape, item.dtype)
    if item.size:
        item.read_direct(values)
    return values


@dataclass(frozen=True)
class Kind:
    """What a dataset holds: its type in files, its name in messages, the kinds of NumPy's types that are read, how a
    value becomes an array, how one that was read becomes a value, and how it is read."""

    stored: str
    words: str
    dtypes: str
    encode: Callable[[Any], Any]
    decode: Callable[[Any], Any]
    read: Callable[[Any], Any] = _whole


def _floats(value: Any) -> Any:
    return np.asarray(value, dtype=np.float64)


def _integers(value: Any) -> Any:
    return np.asarray(value, dtype=np.int64)


def _value(value: Any) -> Any:
    """An array, or one number of Python."""
    return value if np.ndim(value) else value.item()


def _lines(value: Any) -> Any:
    """A text, or a tuple of them."""
    return tuple(line.decode() for line in value.tolist()) if np.ndim(value) else value.decode()


def _words(value: Any) -> Any:
    """As ``_lines``, of programs that fill up with blanks, and of files whose names are no UTF-8."""
    lines = [bytes(line).decode("utf-8", "surrogateescape").rstrip(" ") for line in np.atleast_1d(value)]
    return tuple(lines) if np.ndim(value) else lines[0]


def _text(value: Any) -> Any:
    return text(*value) if isinstance(value, list | tuple) else storable(value)


def _sentences(value: Any) -> tuple[str, ...]:
    sentences = value.decode().strip()
    return (sentences,) if sentences else ()


KINDS = {
    # Finite numbers; any, also infinite ones and NaN; finite ones that are looked at when they are read.
    "real": Kind("f8", "real numbers", "iuf", _floats, lambda value: _value(_floats(value))),
    "any": Kind("f8", "real numbers", "iuf", _floats, _value),
    "later": Kind("f8", "real numbers", "f", _floats, _value),
    # Those of a large sparse matrix, and the places of them.
    "entries": Kind("f8", "real numbers", "f", _floats, _value, _within_budget),
    "index": Kind("i4 or i8", "integers", "iu", np.asarray, _value, _within_budget),
    "whole": Kind("i8", "integers", "iu", _integers, lambda value: _value(_integers(value))),
    # A few of them, as a tuple.
    "few": Kind("i8", "integers", "iu", _integers, lambda value: tuple(value.tolist())),
    "code": Kind("u1", "integers", "iu", lambda value: np.asarray(value, dtype=np.uint8), _value),
    "flag": Kind("u1", "integers", "iu", lambda value: value.astype(np.uint8), lambda value: value.astype(bool)),
    "text": Kind("text", "text", "SO", _text, _lines),
    "words": Kind("text", "text", "SO", _text, _words),
    "json": Kind("text", "text", "SO", lambda value: storable(json_text(value)), json.loads),
    # Sentences in one line of text.
    "notes": Kind("text", "text", "SO", lambda value: storable("; ".join(value) or " "), _sentences),
}


def refuse_not_finite(path: Path | str, name: str, values: NDArray[Any]) -> None:
    """Refuse numbers of the dataset ``name`` that are NaN or infinite.

    Raises:
        InputError: there are some; the place of the first one is in the message.
    """
    if values.ndim == 2:
        # A mask of a whole matrix would take much memory.
        bad = next((j for j in range(values.shape[1]) if not np.isfinite(values[:, j]).all()), None)
        if bad is not None:
            refuse_not_finite(path, f"{name}[:, {bad}]", values[:, bad])
        return
    finite = np.isfinite(values)
    if not finite.all():
        at = tuple(int(i) for i in np.unravel_index(int(np.argmin(finite)), values.shape)) if values.ndim else ()
        where = f" at {list(at)}" if at else ""
        raise InputError(
            f"{path}: /{name} holds {values[at]}{where}; expected finite numbers; the file is damaged, write it again",
            kind="file",
            keyword=Path(path).name,
        )
