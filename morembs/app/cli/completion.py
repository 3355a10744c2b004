"""What a shell offers for values: names of tables, and files by their endings."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path

Offer = Callable[[str], list[str]]
JOBS = (".toml",)
BODIES = (".h5", ".hdf5")
TABLES = (".csv",)


def names_of(module: str, table: str) -> Offer:
    """Names of the ``table`` of a ``module``, which is loaded when they are asked for."""

    def offer(incomplete: str) -> list[str]:
        return match_start(getattr(import_module(module), table), incomplete)

    return offer


def match_start(names: Iterable[str], incomplete: str) -> list[str]:
    """Those that begin as what was typed."""
    return [name for name in names if name.startswith(incomplete)]


def files_with(*endings: str) -> Offer:
    """Files with one of ``endings``, and folders; none where no name fits, and the shell offers all of its own."""
    return lambda incomplete: _files(incomplete, endings)


def models(incomplete: str) -> list[str]:
    """Files that can be imported."""
    from morembs.importers import IMPORTERS

    return _files(incomplete, tuple(ending for importer in IMPORTERS.values() for ending in importer.endings))


def parts(incomplete: str) -> list[str]:
    """Files that a first job is written for."""
    from morembs.app.kinds import PARTS, kind_of

    return [name for name in _files(incomplete, ("",)) if name.endswith("/") or kind_of(Path(name)) in PARTS]


def known_files(incomplete: str) -> list[str]:
    """Files of every kind that is known."""
    from morembs.app.kinds import kind_of

    return [name for name in _files(incomplete, ("",)) if name.endswith("/") or kind_of(Path(name)) is not None]


def _files(incomplete: str, endings: tuple[str, ...]) -> list[str]:
    folder, slash, start = incomplete.rpartition("/")
    found = []
    try:
        entries = sorted(os.scandir(os.path.expanduser(folder + slash) or "."), key=lambda entry: entry.name)
    except OSError:
        return []
    for entry in entries:
        if not entry.name.startswith(start) or (entry.name.startswith(".") and not start.startswith(".")):
            continue
        if entry.is_dir():
            found.append(f"{folder}{slash}{entry.name}/")
        elif entry.name.lower().endswith(endings):
            found.append(f"{folder}{slash}{entry.name}")
    if len(found) == 1 and found[0].endswith("/"):
        # A shell ends a word that is offered alone; what lies in the folder keeps it open.
        return _files(found[0], endings)
    return found
