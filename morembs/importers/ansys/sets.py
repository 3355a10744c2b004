"""Components of ANSYS archives as sets of nodes and elements."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import ElementBlock
from morembs.importers.ansys.archive import Archive


def _members(ranges: Ints, ids: Ints, what: str, name: str) -> Ints:
    """Labels in ``ranges`` (k, 2), all of which must be among the ascending ``ids``."""
    low, high = np.searchsorted(ids, ranges[:, 0]), np.searchsorted(ids, ranges[:, 1], side="right")
    lacking = ranges[:, 1] - ranges[:, 0] + 1 - (high - low)
    if lacking.any():
        at = int(np.flatnonzero(lacking)[0])
        there = ids[low[at] : high[at]] - ranges[at, 0]
        first = ranges[at, 0] + int(np.flatnonzero(np.append(there, -1) != np.arange(len(there) + 1))[0])
        raise InputError(
            f"{name} names {lacking.sum()} {what} that are not defined (first: {first}); write the archive "
            "again with all selected (ALLSEL)"
        )
    mark = np.zeros(len(ids) + 1, dtype=np.int64)
    np.add.at(mark, low, 1)
    np.add.at(mark, high, -1)
    return ids[np.cumsum(mark[:-1]) > 0]


def node_sets(archive: Archive, ids: Ints, used: Ints, notes: list[str]) -> dict[str, Ints]:
    """Components of nodes as rows of ``used`` among all labels ``ids``, both ascending."""
    sets = {}
    for name, ranges in archive.node_sets.items():
        labels = _members(ranges, ids, "nodes", f"{archive.name}: the component {name}")
        members = labels[np.isin(labels, used)]
        if len(members) < len(labels):
            notes.append(
                f"the component {name} has {len(labels) - len(members)} nodes of no solid, which were left out"
            )
        if len(members):
            sets[name] = np.searchsorted(used, members)
    return sets


def element_sets_of(
    archive: Archive, blocks: tuple[ElementBlock, ...], all_ids: Ints, notes: list[str]
) -> dict[str, tuple[Ints, ...]]:
    """Components of elements as rows in each block."""
    sets = {}
    for name, ranges in archive.element_sets.items():
        labels = _members(ranges, all_ids, "elements", f"{archive.name}: the component {name}")
        picked = tuple(np.flatnonzero(np.isin(block.ids, labels)) for block in blocks)
        if (kept := sum(map(len, picked))) < len(labels):
            notes.append(
                f"the component {name} has {len(labels) - kept} elements that are no solids, which were left out"
            )
        if kept:
            sets[name] = picked
    return sets
