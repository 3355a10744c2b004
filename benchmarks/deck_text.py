"""Case about the text of decks: megabytes a second of one core, from the file to mesh and materials, without assembly.

Each deck is nearly all one block: nodes of one hexahedron and of none, or hexahedra of a cube again and again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from measure import Report, Row, Settings, child, in_rounds

Spec = dict[str, Any]
# Bytes of a deck, and of one of a test of this case.
SIZE, QUICK_SIZE = 100_000_000, 400_000
ROUNDS = 5
# Elements along an edge of the cube; labels of nodes have seven digits, as those of large meshes have.
EDGE, QUICK_EDGE, FIRST = 20, 2, 1_000_001
_COLUMNS = (("file_bytes", "MB", "MB"), ("cpu_seconds", "processor s", "s"), ("speed", "MB/s", "n"))


@dataclass(frozen=True)
class Family:
    """How a deck begins, goes on between nodes and elements, and ends."""

    ending: str
    begin: str
    between: str
    end: str


FAMILIES = {
    "abaqus": Family(
        ".inp",
        "*NODE\n",
        "*ELEMENT, TYPE=C3D8, ELSET=ALL\n",
        "*SOLID SECTION, ELSET=ALL, MATERIAL=M\n*MATERIAL, NAME=M\n*ELASTIC\n2.1e11, 0.3\n*DENSITY\n7850.\n",
    ),
    "nastran": Family(".bdf", "BEGIN BULK\n", "", "PSOLID,1,1\nMAT1,1,2.1+11,,.3,7850.\nENDDATA\n"),
    "ansys": Family(
        ".cdb",
        "/PREP7\nET,1,185\nMP,EX,1,2.1e11\nMP,PRXY,1,0.3\nMP,DENS,1,7850\nNBLOCK,6,SOLID\n(3i9,6e21.13e3)\n",
        "N,R5.3,LOC,       -1,\nEBLOCK,19,SOLID\n(19i9)\n",
        "       -1\nFINISH\n",
    ),
}
_COMMAS, _EIGHT = ",".join(["{}"] * 9), "{:8d}" * 6
# What is measured: the family, and the formats of a node (label and three coordinates) and an element (label and eight
# nodes); the block of the kind that the name ends in is the long one.
RECORDS = {
    "abaqus, nine digits: nodes": ("abaqus", "{:9d}, {:13.9g}, {:13.9g}, {:13.9g}\n", _COMMAS + "\n"),
    "abaqus, 17 digits: nodes": ("abaqus", "{}, {:.16e}, {:.16e}, {:.16e}\n", _COMMAS + "\n"),
    "abaqus: elements": ("abaqus", "{}, {:.9g}, {:.9g}, {:.9g}\n", "{:7d}" + ", {:7d}" * 8 + "\n"),
    "nastran, small fields: nodes": ("nastran", "GRID    {:8d}        {:8.3f}{:8.3f}{:8.3f}\n", ""),
    "nastran, large fields: nodes": (
        "nastran",
        "GRID*   {:16d}                {:16.9E}{:16.9E}*\n*       {:16.9E}\n",
        "",
    ),
    "nastran, free fields: nodes": ("nastran", "GRID,{},,{:.9g},{:.9g},{:.9g}\n", ""),
    "nastran, small fields: elements": (
        "nastran",
        "GRID    {:8d}        {:8.3f}{:8.3f}{:8.3f}\n",
        f"CHEXA   {{:8d}}       1{_EIGHT}+\n+       {{:8d}}{{:8d}}\n",
    ),
    "nastran, free fields: elements": (
        "nastran",
        "GRID,{},,{:.9g},{:.9g},{:.9g}\n",
        "CHEXA,{},1" + ",{}" * 6 + ",+\n+,{},{}\n",
    ),
    "ansys: nodes": ("ansys", "{:9d}        0        0{:21.12E}{:21.12E}{:21.12E}\n", ""),
    "ansys: elements": (
        "ansys",
        "{:9d}        0        0{:21.12E}{:21.12E}{:21.12E}\n",
        "        1" * 4 + "        0" * 4 + "        8        0" + "{:9d}" * 9 + "\n",
    ),
}
_ONE = {"abaqus": _COMMAS + "\n", "nastran": "CHEXA,{},1" + ",{}" * 6 + ",+\n+,{},{}\n"}
_ONE["ansys"] = RECORDS["ansys: elements"][2]


def write(path: Path, name: str, *, quick: bool) -> None:
    """The deck of a row of ``RECORDS``."""
    kind, node, element = RECORDS[name]
    family, size, edge = FAMILIES[kind], QUICK_SIZE if quick else SIZE, QUICK_EDGE if quick else EDGE
    many_nodes = name.endswith("nodes")
    edge = 1 if many_nodes else edge
    line = edge + 1
    nodes = [(float(x), float(y), float(z)) for z, y, x in product(range(line), repeat=3)]
    corners = [x + line * (y + line * z) for z, y, x in product(range(edge), repeat=3)]
    around = [0, 1, line + 1, line, line**2, line**2 + 1, line**2 + line + 1, line**2 + line]
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(family.begin)
        file.writelines(node.format(FIRST + i, *xyz) for i, xyz in enumerate(nodes))
        if many_nodes:
            # As many digits as the format has, at no special place.
            places = ((100 * (0.6180339887 * i % 1) - 50 for i in (k, 2.3 * k, 3.7 * k)) for k in range(size))
            _fill(file, size, (node.format(FIRST + len(nodes) + k, *xyz) for k, xyz in enumerate(places)))
        file.write(family.between)
        cells = ([FIRST + corner + step for step in around] for corner in corners)
        if many_nodes:
            file.write(_ONE[kind].format(1, *next(cells)))
        else:
            every = list(cells)
            _fill(file, size, (element.format(k + 1, *every[k % len(every)]) for k in range(size)))
        file.write(family.end)


def _fill(file: Any, size: int, lines: Iterator[str]) -> None:
    while file.tell() < size:
        file.writelines(line for line, _ in zip(lines, range(10_000 if size == SIZE else 100), strict=False))


def read(spec: Spec) -> Row:
    """Read a deck; called in a child."""
    from morembs.importers import import_file

    path = Path(spec["file"])
    if not path.exists():
        write(path, spec["name"], quick=spec["quick"])
        return {}
    start, used = time.perf_counter(), time.process_time()
    mesh = import_file(path).mesh
    used, size = time.process_time() - used, path.stat().st_size
    return {
        "file_bytes": size,
        "seconds": time.perf_counter() - start,
        "cpu_seconds": used,
        "speed": 1e-6 * size / used,
        "elements": 0 if mesh is None else len(mesh.blocks[0].ids),
    }


def deck_text(settings: Settings) -> None:
    """Each deck in a process of its own, in rounds."""
    measures: dict[str, Callable[[], Row]] = {}
    for name, (kind, *_) in RECORDS.items():
        stem = "".join(c if c.isalnum() else "-" for c in name)
        path = settings.folder / f"{stem}{FAMILIES[kind].ending}"
        wanted = {"file": str(path), "name": name, "quick": settings.quick}
        child("deck", settings, **wanted)
        measures[name] = lambda wanted=wanted: child("deck", settings, **wanted)  # type: ignore[misc]
    report = Report("deck-text", settings)
    report.add(in_rounds(measures, settings.repeat if settings.quick else max(settings.repeat, ROUNDS)))
    report.table("decks: text to mesh", _COLUMNS)
    report.write()


CASES = {"deck-text": deck_text}
