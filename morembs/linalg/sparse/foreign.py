"""Libraries written in C: opening them, and the layout of their structures as their headers give it.

A structure changes between releases, and a wrong layout corrupts memory. So it is read from the header that was
installed with the library, and each function that opens the library checks that the versions of the two agree.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import re
import sysconfig
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

Library = TypeVar("Library")
Fields = list[tuple[str, Any]]


class UnusableError(Exception):
    """A library or header that cannot be used; the message says why."""


def find_library(name: str) -> str | None:
    """Name or path of a shared library of the system, None without it.

    What ``ctypes`` finds without its last resort on Linux, a compiler: that takes its time whenever a library is not
    there, and leaves a file where a run is killed. Instead the links are looked at that compilers follow.
    """
    cached = getattr(ctypes.util, "_findSoname_ldconfig", None)
    if cached is None:
        return ctypes.util.find_library(name)
    own = [Path(folder) for folder in os.environ.get("LD_LIBRARY_PATH", "").split(":") if folder]
    many = sysconfig.get_config_var("MULTIARCH") or ""
    system = [Path(folder) for folder in (f"/usr/lib/{many}", "/usr/local/lib", "/usr/lib64", "/usr/lib")]

    def find_linked(folders: list[Path]) -> str | None:
        return next((str(path) for folder in folders if (path := folder / f"lib{name}.so").is_file()), None)

    return find_linked(own) or cached(name) or find_linked(system)


def open_deep(path: str) -> ctypes.CDLL:
    """The library at ``path``, bound to the BLAS that it was linked with, even where another (MKL's) is global.

    Raises:
        OSError: it cannot be loaded.
    """
    return ctypes.CDLL(path, mode=ctypes.DEFAULT_MODE | getattr(os, "RTLD_DEEPBIND", 0))


def without_comments(text: str) -> str:
    """The text of a header, each comment replaced by a blank."""
    return re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)


def constants(text: str) -> dict[str, str]:
    """Values of ``#define NAME VALUE``, in parentheses or not."""
    return dict(re.findall(r"^[ \t]*#[ \t]*define[ \t]+(\w+)[ \t]+\(?([^\s()]+)\)?[ \t]*$", text, flags=re.MULTILINE))


def struct_fields(body: str, types: Mapping[str, Any], defined: Mapping[str, str]) -> Fields:
    """Names and types of the fields between the braces of a struct; pointers become c_void_p.

    Args:
        types: name of a type -> its type of ctypes; None stands for a handle, which is a pointer.
        defined: values of the constants that array lengths name.

    Raises:
        UnusableError: a field that is not understood.
    """
    fields: Fields = []
    known = dict(types)
    inner = re.compile(r"struct\s+\w+\s*\{([^{}]*)\}\s*(\w+\s*\[[^\]]+\])\s*;")
    for number, match in enumerate(inner.finditer(body)):
        known[f"inner{number}"] = structure(f"Inner{number}", struct_fields(match[1], types, defined))
        body = body.replace(match[0], f"inner{number} {match[2]};")
    body = re.sub(r"void\s*\(\s*\*\s*(\w+)\s*\)\s*\([^()]*\)\s*;", r"void *\1;", body)
    for statement in filter(None, (part.strip() for part in body.split(";"))):
        kind, *rest = statement.split(None, 1)
        for declarator in (rest[0] if rest else "").split(","):
            parts = re.fullmatch(r"\s*(\*?)\s*(\w+)\s*(?:\[([^\]]+)\])?\s*", declarator)
            if parts is None or not (parts[1] or kind in known):
                raise UnusableError(f"its header has a field that is not understood: {statement!r}")
            base = None if parts[1] else known[kind]
            fields.append((parts[2], _size_array(ctypes.c_void_p if base is None else base, parts[3], defined)))
    return fields


def structure(name: str, fields: Fields) -> type[ctypes.Structure]:
    """A structure with these fields."""
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def pad_structure(data: type[ctypes.Structure], padding: int) -> Any:
    """An empty ``data`` before ``padding`` bytes: a library that is newer than its header writes into these."""
    return structure("Padded", [("data", data), ("padding", ctypes.c_char * padding)])()


def refuse_missing(fields: Fields, needed: set[str], what: str) -> None:
    """Raise UnusableError where ``fields`` lack some of the ``needed`` ones."""
    missing = sorted(needed - {name for name, _ in fields})
    if missing:
        raise UnusableError(f"{what} of its header lacks {', '.join(missing)}")


def _size_array(kind: Any, length: str | None, defined: Mapping[str, str]) -> Any:
    if length is None:
        return kind
    try:
        return kind * sum(int(defined.get(term.strip(), term)) for term in length.split("+"))
    except ValueError:
        raise UnusableError(f"its header has an array length that is not understood: {length!r}") from None


def with_header(
    path: str, headers: Iterable[Path], opened: Callable[[Path], Library], name: str, hint: str
) -> Library | str:
    """What ``opened`` gives of the first of ``headers`` that fits the library at ``path``, or why none does.

    ``name`` is that of the header, ``hint`` a command that installs both.
    """
    reason = f"its header {name} was not found"
    for header in headers:
        if not header.is_file():
            continue
        try:
            return opened(header)
        except UnusableError as error:
            reason = str(error)
    return f"{path} cannot be used: {reason}; get both with: {hint}"
