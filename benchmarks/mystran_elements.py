"""Processor seconds that elements cost through MYSTRAN, of this process and of all runs.

    python -m benchmarks.mystran_elements 2000 20000

Blocks of CHEXA and rolled sheets of CQUAD4 of about as many elements are imported.
"""

from __future__ import annotations

import argparse
import math
import resource
import sys
import tempfile
from pathlib import Path

import numpy as np

from morembs.importers import import_file
from tests.support.meshes import box
from tests.support.mystran import STEEL, plate


def solids(count: int) -> str:
    """A block of about ``count`` CHEXA."""
    side = round((count / 2.5) ** (1 / 3))
    mesh = box("hex8", (round(count / side**2), side, side), (2.5, 1.0, 1.0))
    lines = [f"GRID,{i},,{x:.9f},{y:.9f},{z:.9f}" for i, (x, y, z) in enumerate(mesh.nodes.xyz, 1)]
    for e, row in enumerate((mesh.blocks[0].nodes + 1).tolist(), 1):
        lines.append(f"CHEXA,{e},1,{','.join(map(str, row[:6]))}\n,{row[6]},{row[7]}")
    return "\n".join([*lines, "PSOLID,1,1,0,TWO"]) + "\n" + STEEL


def sheet(count: int) -> str:
    """A rolled sheet of about ``count`` CQUAD4."""
    side = round(math.sqrt(count))
    return plate(side, side, np.eye(3), radius=0.5) + "PSHELL,1,1,.01,1,,1\n" + STEEL


def processor_seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("elements", type=int, nargs="+")
    given = parser.parse_args(arguments)
    for kind, deck in (("CHEXA", solids), ("CQUAD4", sheet)):
        for count in given.elements:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "deck.bdf"
                path.write_text(deck(count) + "ENDDATA\n")
                begin = processor_seconds()
                import_file(path, engine="mystran")
                print(f"{kind} {count}: {processor_seconds() - begin:.1f} s of processors", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
