"""Kinds of keys that several tables of a system file have."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from morembs.base.arguments import fits, words
from morembs.base.errors import InputError
from morembs.base.key_tables import Table
from morembs.base.limits import length, text

NAME = r"^[^/:\s.\x00-\x1f][^/:\x00-\x1f]*$"
PartName = Annotated[str, text("a name without colons and slashes", NAME, longest=100)]
OptionalName = Annotated[str, text("a name without colons and slashes", rf"{NAME}|^$", longest=100)]
MarkerName = Annotated[str, text('a marker "BODY:NAME" such as "rod:big_end", "ground" or "ground:NAME"')]
Between = Annotated[list[MarkerName], length('two markers such as ["ground", "rod:big_end"]', 2)]
ORIGIN = [0.0, 0.0, 0.0]


def refuse_names(key: str, names: Iterable[str]) -> None:
    """Refuse names of markers that the file of the result cannot have.

    Raises:
        InputError: in these cases.
    """
    for name in names:
        if not fits(name, PartName):
            raise InputError(
                f"{key}: the name {name!r} was given; expected {words(PartName)}, without a leading dot", keyword=key
            )


def refuse_foreign(table: Table, kind: str, keys: dict[str, set[str]]) -> None:
    """Refuse keys that belong to another kind of a table; ``keys`` are the keys of one kind alone, by its name.

    Raises:
        InputError: in these cases.
    """
    own = keys.get(kind, set())
    for key in sorted({key for several in keys.values() for key in several} & table.given - own):
        raise InputError(
            f'{key} was given beside kind = "{kind}", which does not have it; leave it out',
            kind="conflict",
            keyword=key,
        )
