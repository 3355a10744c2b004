"""Tiny input decks and job files for tests of the command line."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from morembs.importers.decks.problems import DeckError

CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
Cell = tuple[int, int, int]
BEAM: tuple[Cell, ...] = tuple(itertools.product(range(6), range(2), range(2)))
# Two cubes of eight elements with nothing but one edge in common, and two with nothing at all.
HINGED: tuple[Cell, ...] = tuple((x + d, y + d, z) for d in (0, 2) for x, y, z in itertools.product(range(2), repeat=3))
APART: tuple[Cell, ...] = tuple((x + d, y, z) for d in (0, 5) for x, y, z in itertools.product(range(2), repeat=3))
# Steel of all elements of BEAM.
MATERIAL = (
    "*ELSET, ELSET=EVERY, GENERATE\n1, 24, 1\n*MATERIAL, NAME=STEEL\n*ELASTIC\n210e3, 0.3\n*DENSITY\n7.85e-9\n"
    "*SOLID SECTION, ELSET=EVERY, MATERIAL=STEEL\n"
)

JOB: dict[str, str] = {
    "model": 'mesh = "part.inp"\nunits = "mm-t-s"',
    "material": 'set = "all"\nyoung = 210e3\npoisson = 0.3\ndensity = 7.85e-9',
    "interface": 'name = "left"\nnodes = "set:LEFT"',
    "interface2": 'name = "right"\nnodes = "set:RIGHT"',
    "reduce": 'name = "cb"\nmethod = "craig-bampton"\nmodes = 4',
    "output": 'path = "part.h5"',
}
ARRAYS = {"parameter", "material", "interface", "reduce"}


def refusals(read: Callable[[], object]) -> list[tuple[str, int, tuple[str, ...]]]:
    """Keyword, line and options of each problem that a deck is refused for."""
    with pytest.raises(DeckError) as told:
        read()
    return [(problem.keyword, problem.line, problem.flags) for problem in told.value.problems]


def deck(cells: Sequence[Cell], size: float = 10.0, kind: str = "C3D8", flipped: Sequence[int] = ()) -> str:
    """Cubes of edge ``size`` at whole places, joined where they touch; the elements ``flipped`` are inside out.

    *NODE FILE says that the deck is one of CalculiX, whose C3D8 is what is assembled here.

    Sets: nodes LEFT and RIGHT (lowest and highest x), LINE (y = z = 0) and elements FIRST.
    """
    places = sorted({tuple(c + d for c, d in zip(cell, corner, strict=True)) for cell in cells for corner in CORNERS})
    label = {place: number for number, place in enumerate(places, start=1)}
    lines = ["*NODE"]
    lines += [f"{label[p]}, " + ", ".join(str(size * c) for c in p) for p in places]
    lines.append(f"*ELEMENT, TYPE={kind}")
    for number, cell in enumerate(cells, start=1):
        nodes = [label[tuple(c + d for c, d in zip(cell, corner, strict=True))] for corner in CORNERS]
        if number in flipped:
            nodes = nodes[4:] + nodes[:4]
        lines.append(", ".join(map(str, [number, *nodes])))
    ends = [min(p[0] for p in places), max(p[0] for p in places)]
    sets = {
        "LEFT": [label[p] for p in places if p[0] == ends[0]],
        "RIGHT": [label[p] for p in places if p[0] == ends[1]],
        "LINE": [label[p] for p in places if p[1] == p[2] == 0],
    }
    for name, members in sets.items():
        lines += [f"*NSET, NSET={name}", *(str(member) for member in members)]
    lines += ["*ELSET, ELSET=FIRST", "1", "*NODE FILE", "U"]
    return "\n".join(lines) + "\n"


def job(tables: Mapping[str, str | None] | None = None) -> str:
    """A job text: ``JOB`` with some tables changed, added, or left out (None)."""
    parts = []
    for name, body in {**JOB, **(tables or {})}.items():
        bare = name.rstrip("0123456789")
        if body is not None:
            parts.append(f"[[{bare}]]\n{body}\n" if bare in ARRAYS else f"[{bare}]\n{body}\n")
    return "\n".join(parts)


def folder(path: Path, tables: Mapping[str, str | None] | None = None, text: str | None = None) -> Path:
    """A folder with ``part.inp`` and ``job.toml``; gives the path of the job."""
    (path / "part.inp").write_text(deck(BEAM) if text is None else text)
    (path / "job.toml").write_text(job(tables))
    return path / "job.toml"


def filled(mark: str, size: int) -> str:
    """``size`` characters, 160 or more, of lines that are comments by their ``mark``."""
    line = mark.ljust(79, "-") + "\n"
    return mark.ljust(79 + size % 80, "-") + "\n" + (size // 80 - 1) * line


def damaged(sources: Sequence[str], count: int, seed: int, marks: bytes) -> Iterator[bytes]:
    """``count`` damaged copies: cut off, bytes changed to some of ``marks``, lines swapped, lines doubled."""
    chance = random.Random(seed)
    for turn in range(count):
        data = bytearray(sources[turn % len(sources)].encode())
        how = turn // len(sources) % 4
        if how == 0:
            data = data[: chance.randrange(len(data))]
        elif how == 1:
            for _ in range(chance.randrange(1, 4)):
                data[chance.randrange(len(data))] = chance.choice(marks)
        else:
            rows = bytes(data).split(b"\n")
            i, j = chance.randrange(len(rows)), chance.randrange(len(rows))
            rows[i], rows[j] = (rows[j], rows[i]) if how == 2 else (rows[i], rows[i])
            data = bytearray(b"\n".join(rows))
        yield bytes(data)
