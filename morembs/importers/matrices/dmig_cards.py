"""DMIG entries of bulk data: headers, and entries with the column that they lie in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.matrices.text import integers
from morembs.importers.nastran.cards import Cards
from morembs.importers.nastran.tables import Table


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """A header (its fields from the name on) or entries (k,) of one matrix, with the column of each."""

    name: str
    header: list[str] | None
    column_grid: Ints
    column_component: Ints
    grid: Ints
    component: Ints
    a: Floats
    b: Floats


def columns_of(cards: Cards) -> Iterator[Column]:
    """The DMIG entries among cards: name, grid and component of the column, a blank; then four fields for each entry.

    Raises:
        InputError: a field is no number, or no label.
    """
    fours, owner = cards.fours(b"DMIG")
    if not len(owner):
        return
    begins = np.diff(owner, prepend=-1) > 0
    card = np.cumsum(begins) - 1
    titles = Table("DMIG", fours.fields[begins], cards.file)
    words = titles.rows()
    names = [row[0].upper() if row else "" for row in words]
    is_header = np.array([row[1:2] == ["0"] for row in words])
    labels = np.zeros((len(words), 2))
    labels[~is_header] = Table("DMIG", titles.fields[~is_header], cards.file).reals(1, 3)
    entry = ~begins & ~is_header[card]
    values, of_entry = Table("DMIG", fours.fields[entry], cards.file).reals(0, 4), card[entry]
    # Runs of one name between headers.
    changed = [left != right for left, right in zip(names[1:], names[:-1], strict=True)]
    turns = np.flatnonzero(is_header | np.array([True, *changed]))
    turns = np.unique(np.concatenate([turns, turns[is_header[turns]] + 1, [len(words)]]))
    for begin, end in zip(turns[:-1].tolist(), turns[1:].tolist(), strict=True):
        part = slice(*np.searchsorted(of_entry, [begin, end]).tolist())
        at = integers(labels[of_entry[part]], "a grid or component of a column", cards.file)
        header = None
        if is_header[begin]:
            header = Table("DMIG", fours.fields[card == begin].reshape(1, -1, fours.fields.shape[2]), "").rows()[0]
        yield _entries(names[begin], header, at, values[part], cards.file)


def _entries(title: str, header: list[str] | None, at: Ints, values: Floats, file: str) -> Column:
    if len(values) and not values[:, 0].all():
        # An entry without a grid: the blank rest of a line.
        used = values.any(axis=1)
        at, values = at[used], values[used]
    labels = integers(values[:, :2], "a grid or component", file)
    both = np.concatenate([labels, at])
    if len(both) and (both[:, 0].min() < 1 or both[:, 1].min() < 0 or both[:, 1].max() > 6):
        raise InputError(
            f"{file}: the DMIG {title} names a grid below 1 or a component beyond 0 to 6; it is damaged",
            kind="file",
            keyword="DMIG",
        )
    return Column(
        name=title,
        header=header,
        column_grid=at[:, 0],
        column_component=at[:, 1],
        grid=labels[:, 0],
        component=labels[:, 1],
        a=values[:, 2],
        b=values[:, 3],
    )
