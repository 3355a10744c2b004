"""Does a file hold what its tables say? Kinds and shapes of datasets, before anything is made of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.storage.table import KINDS, Row, Table

# Letter of a table -> its size, and the dataset that gave it.
Sizes = dict[str, tuple[int, str]]


class TableCheck:
    """Compares an open HDF5 ``file`` with tables; ``path``, ``what`` the file is and the ``cure`` are for messages."""

    def __init__(self, path: Path, file: Any, what: str, cure: str = "write it again") -> None:
        self.path, self.file, self.what, self.cure = path, file, what, cure

    def refuse(self, name: str, what: str, wanted: str) -> InputError:
        """What to raise for a dataset."""
        return InputError(f"{self.path}: /{name} {what}; expected {wanted}; the file is damaged, {self.cure}")

    def table(self, at: str, table: Table, sizes: Sizes) -> None:
        """All rows of a table below ``at``; ``sizes`` are those of the letters so far, which groups within share.

        Raises:
            InputError: a dataset is missing, or is not what it should be; its name is in the message.
        """
        missing = []
        for row in table:
            place = at + row.place
            item = None if row.many else self.file.get(place)
            if row.many:
                for name, inner in row.items(self.file[at] if at else self.file).items():
                    self._row(place + name, inner, row, sizes)
            elif isinstance(row.kind, Table) or isinstance(item, h5py.Dataset):
                if item is not None or not row.when:
                    self._row(place, item, row, sizes)
            elif not row.when:
                missing.append(place)
            elif item is not None:
                raise self.refuse(place, "is a group", "a dataset")
        if missing:
            names = ", ".join(f"/{place}" for place in missing)
            raise InputError(f"{self.path} is an incomplete {self.what}; missing: {names}; {self.cure}")

    def _row(self, name: str, item: Any, row: Row, sizes: Sizes) -> None:
        """One group, or one dataset: its kind, its shape, and what it holds."""
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
            f"{path}: /{name} holds {values[at]}{where}; expected finite numbers; the file is damaged, write it again"
        )
