"""NumPy archives of strangers, looked at before any array is unpacked."""

from __future__ import annotations

import zipfile
from collections import Counter

from morembs.base.errors import InputError
from morembs.base.memory import refuse_too_large


def refuse_unsafe_archive(source: str, archive: zipfile.ZipFile | None) -> None:
    """Refuse an archive whose arrays do not fit into the memory, or that holds two arrays of one name.

    NumPy reads one of two such arrays; other programs may read the other.

    Raises:
        InputError: in these cases.
    """
    if archive is None:
        return
    refuse_too_large(source, sum(entry.file_size for entry in archive.infolist()))
    names = Counter(name.removesuffix(".npy") for name in archive.namelist())
    twice = next((name for name, count in names.items() if count > 1), None)
    if twice is not None:
        raise InputError(
            f"{source} holds {names[twice]} arrays {twice!r}; expected each name once, save it again",
            kind="file",
            keyword=twice,
        )
