"""Labels of nodes and elements: which row each has, and ranges of them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Bools, Ints


class Labels:
    """Rows of the labels ``ids`` (n,), each of which is there once.

    Args:
        source: the name of the file, for messages.
        noun: what has the labels, such as "node".
        where: what stands behind a label in messages, such as " of the instance 'A'".
        rows: (n,) of the labels in a larger table; by default their places.

    Raises:
        InputError: a label twice, or below 1.
    """

    def __init__(self, ids: Ints, source: str, noun: str = "node", where: str = "", rows: Ints | None = None) -> None:
        self.ids, self._source, self._noun, self._where = ids, source, noun, where
        is_ascending = bool((ids[1:] > ids[:-1]).all())
        order = np.arange(len(ids)) if is_ascending else np.argsort(ids, kind="stable")
        self.ascending = ids if is_ascending else ids[order]
        # Rows by label.
        self.order = order if rows is None else rows[order]
        twice = self.ascending[1:][np.diff(self.ascending) == 0]
        if len(twice) or (len(ids) and self.ascending[0] < 1):
            label = f"{twice[0]}{where} twice" if len(twice) else f"{self.ascending[0]}{where}"
            raise InputError(
                f"{source} defines the {noun} {label}; expected unique labels from 1", kind="conflict", keyword=noun
            )

    def __len__(self) -> int:
        return len(self.ids)

    def has(self, labels: Ints) -> Bools:
        """True if each label (any shape) is there."""
        return find(self.ascending, np.asarray(labels))[1]

    def rows(self, labels: Ints, who: str) -> Ints:
        """Rows of ``labels`` (any shape).

        Args:
            who: who names them and the verb, such as "elements name".

        Raises:
            InputError: a label that is not defined.
        """
        labels = np.asarray(labels)
        at, there = find(self.ascending, labels)
        if not there.all():
            missing = np.unique(labels[~there])
            some, one = ", ".join(map(str, missing[:10].tolist())), len(missing) == 1
            what = f"the {self._noun} {some}" if one else f"{len(missing)} {self._noun}s"
            rest = f"{self._where}, which is not defined" if one else f"{self._where} that are not defined: {some}"
            raise InputError(f"{self._source}: {who} {what}{rest}", kind="unknown", keyword=self._noun)
        return np.asarray(self.order[at])

    def members(self, ranges: Ints, who: str) -> Ints:
        """Rows, by label, of the labels in ``ranges`` (k, 2), first and last.

        Raises:
            InputError: a label that is not defined.
        """
        ids = self.ascending
        low, high = np.searchsorted(ids, ranges[:, 0]), np.searchsorted(ids, ranges[:, 1], side="right")
        lacking = ranges[:, 1] - ranges[:, 0] + 1 - (high - low)
        if lacking.any():
            at = int(np.flatnonzero(lacking)[0])
            there = ids[low[at] : high[at]] - ranges[at, 0]
            first = ranges[at, 0] + int(np.flatnonzero(np.append(there, -1) != np.arange(len(there) + 1))[0])
            raise InputError(
                f"{self._source}: {who} {lacking.sum()} {self._noun}s that are not defined (first: {first}); write the "
                "file again with all selected",
                kind="file",
            )
        counts = high - low
        places = np.arange(counts.sum()) + np.repeat(low - np.cumsum(counts) + counts, counts)
        # Ranges may lie in each other, or in any order.
        return np.asarray(self.order[distinct(places)])


def find(ids: Ints, labels: Ints) -> tuple[Ints, Bools]:
    """Places of ``labels`` (any shape) among the ascending ``ids`` (n,), and whether each is there."""
    if not len(ids):
        return np.zeros(labels.shape, dtype=np.int64), np.zeros(labels.shape, dtype=bool)
    if ids[-1] - ids[0] + 1 == len(ids):
        # Without gaps a place follows from its label.
        at = labels - ids[0]
        return at, (at >= 0) & (at < len(ids))
    at = np.minimum(np.searchsorted(ids, labels), len(ids) - 1)
    return at, ids[at] == labels


def distinct(labels: Ints) -> Ints:
    """Each label once, ascending; those of most files ascend already."""
    if not (labels[1:] > labels[:-1]).all():
        labels = np.sort(labels)
        labels = labels[np.append(True, labels[1:] != labels[:-1])]
    return labels


def ranges_of(labels: Ints) -> Ints:
    """Ranges (k, 2), first and last, of ``labels`` in any order."""
    labels = distinct(labels)
    if not len(labels):
        return np.empty((0, 2), dtype=np.int64)
    gaps = np.flatnonzero(np.diff(labels) > 1)
    return np.column_stack([labels[np.concatenate([[0], gaps + 1])], labels[np.append(gaps, len(labels) - 1)]])


def ranges_by_number(parts: Iterable[tuple[Ints, Ints]]) -> dict[int, Ints]:
    """Number -> ranges of the labels that have it, from pairs (labels, numbers) (k,), numbers ascending."""
    table = np.concatenate([np.empty((2, 0), dtype=np.int64), *(np.stack(pair) for pair in parts)], axis=1)
    labels, numbers = table[:, np.argsort(table[1], kind="stable")]
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[:1] - 1)).tolist()
    return {int(numbers[a]): ranges_of(labels[a:b]) for a, b in zip(starts, [*starts[1:], len(numbers)], strict=False)}


def in_ranges(labels: Ints, ranges: Ints) -> Bools:
    """True if each of ``labels`` (n,) is in one of ``ranges`` (k, 2)."""
    starts, ends = np.sort(ranges[:, 0]), np.sort(ranges[:, 1])
    # A label is in a range where more of them have begun than ended.
    return np.asarray(np.searchsorted(starts, labels, side="right") > np.searchsorted(ends, labels))
