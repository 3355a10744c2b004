"""Does a file hold what its tables say? Kinds, shapes and limits of datasets, before anything is made of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from morembs.base.errors import InputError
from morembs.storage.kinds import KINDS, refuse_not_finite
from morembs.storage.table import Row, Table

# Letter of a table -> its size, and the dataset that gave it.
Sizes = dict[str, tuple[int, str]]


class TableCheck:
    """Compares an open HDF5 ``file`` with tables; ``path``, ``what`` the file is and the ``cure`` are for messages."""

    def __init__(self, path: Path, file: Any, what: str, cure: str = "write it again") -> None:
        self.path, self.file, self.what, self.cure = path, file, what, cure

    def refuse(self, name: str, what: str, wanted: str) -> InputError:
        """What to raise for a dataset."""
        return InputError(
            f"{self.path}: /{name} {what}; expected {wanted}; the file is damaged, {self.cure}",
            kind="file",
            keyword=self.path.name,
        )

    def table(self, at: str, table: Table, sizes: Sizes) -> None:
        """All rows of a table below ``at``; ``sizes`` are those of the letters so far, which groups within share.

        Raises:
            InputError: a dataset is missing, or has another kind, shape or value; its name is in the message.
        """
        missing: list[str] = []
        self._kinds(at, table, sizes, missing)
        if missing:
            names = ", ".join(f"/{place}" for place in missing)
            raise InputError(
                f"{self.path} is an incomplete {self.what}; missing: {names}; {self.cure}",
                kind="file",
                keyword=self.path.name,
            )
        # Sizes that limit others may be given by any row.
        for row in table:
            self._limits(at, row, sizes)

    def _kinds(self, at: str, table: Table, sizes: Sizes, missing: list[str]) -> None:
        group = self.file.get(at, {}) if at else self.file
        for row in table:
            place = at + row.place
            item = None if row.many or row.inline else self.file.get(place)
            if row.many:
                for name, inner in row.items(group).items():
                    self._row(place + name, inner, row, sizes)
            elif row.inline and isinstance(row.kind, Table):
                if not row.optional or row.within(group):
                    self.table(at, row.kind, sizes)
            elif isinstance(row.kind, Table) or isinstance(item, h5py.Dataset):
                if item is not None or not row.optional:
                    self._row(place, item, row, sizes)
            elif not row.optional:
                missing.append(place)
            elif item is not None:
                raise self.refuse(place, "is a group", "a dataset")

    def _row(self, name: str, item: Any, row: Row, sizes: Sizes) -> None:
        """One group, or one dataset: its kind, its shape, and its values."""
        if isinstance(row.kind, Table):
            self.table(f"{name}/", row.kind, dict(sizes))
            return
        kind = KINDS[row.kind]
        if item.shape is None or item.dtype.kind not in kind.dtypes:
            held = "nothing" if item.shape is None else f"values of type {item.dtype}"
            raise self.refuse(name, f"holds {held}", kind.words)
        self._shape(name, item, row.shape.split(), sizes)
        if not item.dtype.hasobject and not item.id.get_create_plist().get_nfilters():
            held, announced = item.id.get_storage_size(), item.size * item.dtype.itemsize
            if held < announced:
                raise self.refuse(name, f"announces {announced} bytes, of which the file holds {held}", "all of them")
        if row.kind == "real":
            refuse_not_finite(self.path, name, item[()])
        if row.kind in ("text", "json", "notes"):
            self._text(name, item, "JSON" if row.kind == "json" else "text")
        if row.counts:
            sizes[row.counts] = int(item[()]), name

    def _shape(self, name: str, item: Any, wanted: Sequence[str], sizes: Sizes) -> None:
        bad, words, givers = len(item.shape) != len(wanted), [], []
        for given, text in zip(item.shape, wanted, strict=False):
            letter = text.lstrip("0123456789")
            factor = int(text.removesuffix(letter) or 1)
            if letter and letter != "any":
                size, giver = sizes.setdefault(letter, (given // factor, name))
                factor *= size
                if giver != name:
                    givers.append(f"/{giver}")
            words.append("any" if letter == "any" else str(factor))
            bad = bad or (letter != "any" and given != factor)
        if bad:
            words += wanted[len(words) :]
            by = f" by {' and '.join(dict.fromkeys(givers))}" if givers else ""
            raise self.refuse(name, f"has the shape {item.shape}", f"({', '.join(words)}){by}")

    def _text(self, name: str, item: Any, expected: str) -> None:
        try:
            lines = [line.decode() for line in np.ravel(item[()]).tolist()]
            if expected == "JSON" and not isinstance(json.loads(lines[0]), dict):
                raise ValueError("not a mapping")
        except (AttributeError, ValueError) as error:
            raise self.refuse(name, f"cannot be read ({error})", expected) from error

    def _limits(self, at: str, row: Row, sizes: Sizes) -> None:
        """What a row that is there may hold."""
        name = (at + row.place).rstrip("/")
        if row.inline or not (row.known or row.largest or row.positive) or name not in self.file:
            return
        item = self.file[name]
        if row.positive and not float(item[()]) > 0:
            raise self.refuse(name, f"is {float(item[()]):g}", "more than zero")
        if row.largest:
            self.at_most(name, *self._largest(row.largest, sizes))
        if row.known:
            (known, where), verb = self._read_expected(row.known, sizes), "has" if row.many else "is"
            for text in list(item) if row.many else KINDS["text"].decode(np.atleast_1d(item[()])):
                if text not in known:
                    raise self.refuse(name, f"{verb} {text!r}", f"one of {', '.join(known) or 'none'}{where}")

    def at_most(self, name: str, largest: int, why: str = "", where: Any = slice(None), least: int = 0) -> None:
        """Whole numbers from ``least`` to ``largest``, in the part that ``where`` picks.

        Raises:
            InputError: another one is among them.
        """
        values = np.ravel(self.file[name][()])[where]
        bad = [
            value for value in (values.min(initial=least), values.max(initial=least)) if not least <= value <= largest
        ]
        if bad and len(values):
            raise self.refuse(name, f"holds {bad[0]}", f"{least} to {largest}{why}")

    def _largest(self, largest: str, sizes: Sizes) -> tuple[int, str]:
        """The largest number, and why."""
        letter, _, places = largest.partition("-")
        size, giver = (int(letter), "") if letter.isdecimal() else sizes[letter]
        return (size - 1, f", places in /{giver}") if places else (size, "")

    def _read_expected(self, known: str | Sequence[str], sizes: Sizes) -> tuple[Sequence[str], str]:
        """Texts that are expected, and where they stand."""
        if not isinstance(known, str):
            return known, ""
        giver = sizes[known][1]
        return KINDS["text"].decode(self.file[giver][()]), f", of /{giver}"
