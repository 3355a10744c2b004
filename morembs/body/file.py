"""The HDF5 file of elastic bodies, described in docs/reference/schema.md: read lazily."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from morembs.body.body import Body
from morembs.body.delivery_check import refuse_unsound, stored_findings
from morembs.body.stored import FORMAT, BodyFile, FormatVersion, StoredBodies
from morembs.body.stored_check import check_file
from morembs.body.write import check_names, write_body
from morembs.storage.checksums import Checksums

if TYPE_CHECKING:
    from morembs.body.parametric import ParametricBody

# What is compared with its checksums when it is read.
_LATER = re.compile(r"VTKHDF|bodies/[^/]+/(recovery|switching|parametric|basis/)")


def read_body(path: str | Path, *, whole: bool = False) -> StoredBodies:
    """Read a body file. Bases are read later, when a method needs them.

    Compares the stored properties of each body, such as frequencies, with its matrices.

    Args:
        whole: compare all data with their checksums now. By default the checksums of bases, stress shapes, static
            modes of candidate loads and shapes for ParaView are compared when these data are read.

    Raises:
        InputError: the file does not exist, is not a body file, was written by a newer version, is damaged or
            incomplete, or has properties that contradict its matrices.

    >>> path = write_body("bar.h5", [body])
    >>> read_body(path)
    StoredBodies: bodies craig-bampton (order 18); mass 7.85 kg; nodes 20; interfaces LEFT, RIGHT
    """
    stored = read_unexamined(path, whole=whole)
    refuse_unsound(path, stored_findings(stored))
    return stored


def read_unexamined(path: str | Path, *, whole: bool = False) -> StoredBodies:
    """Read a body file as ``read_body`` does, to show what is in it: its bodies may contradict themselves.

    Raises:
        InputError: as ``read_body``, but for that.
    """
    source = BodyFile(Path(path), _parametric)
    with source.open_file() as file:
        check_file(source.path, file)
        Checksums(source.path, file).verify(lambda name: whole or not _LATER.match(name))
        if "provenance" in file:
            Checksums(source.path, file["provenance"]).verify()
        return source.load(file)


def _parametric(source: BodyFile, body: Body) -> ParametricBody:
    # Not at the top: most who read a file do not evaluate it.
    from morembs.body.parametric import ParametricBody

    return ParametricBody(source.path, source.content, body, body.parameters())


__all__ = ["FORMAT", "FormatVersion", "StoredBodies", "check_names", "read_body", "write_body"]
