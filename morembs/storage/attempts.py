"""Attempts at files: several processes may try to write the same ones, and their watcher takes one attempt.

An attempt lies hidden beside the file that it is for, under a name with a token that no other attempt has. No lock is
needed, on network disks neither: only the one who watches gives an attempt the name of the file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from morembs.base.scratch import remove_abandoned
from morembs.storage.safefile import PREFIX, Place, checked, take_names

# The token is eight digits of a key and the number of the attempt.
_LEFT = re.compile(r"\.(.+)\.[0-9a-f]{8}\.\d+\.part((?:\.(?!old$)[^.]+)?)(?:\.old)?")


def attempt_at(path: Path, token: str) -> Path:
    """Where an attempt at ``path`` is written; its end is the same, as that says the format."""
    target = Path(os.path.realpath(path))
    return target.with_name(f".{target.stem}.{token}.part{target.suffix}")


def take(paths: Iterable[Path], token: str) -> None:
    """Give an attempt the names of the files that it is for: all or none.

    Raises:
        FileNotFoundError: a part of the attempt is not there.
        OutputError: a name cannot be taken.
    """
    places = [Place(path=path, target=checked(path), new=attempt_at(path, token)) for path in paths]
    for place in places:
        os.stat(place.new)
    try:
        take_names(places)
    finally:
        for place in places:
            with suppress(OSError):
                place.old.unlink()


def discard(paths: Iterable[Path]) -> None:
    """Remove all attempts at files that nobody took, and what killed processes left beside them."""
    names: dict[Path, set[str]] = {}
    for path in paths:
        target = Path(os.path.realpath(path))
        names.setdefault(target.parent, set()).add(target.name)
    for folder, targets in names.items():
        with suppress(OSError):
            remove_abandoned(folder, PREFIX)
            for name in os.listdir(folder):
                left = _LEFT.fullmatch(name)
                if left is not None and f"{left[1]}{left[2]}" in targets:
                    with suppress(OSError):
                        (folder / name).unlink()
