"""How many Nastran decks of folders become a model, by own assembly and through MYSTRAN, and what elements cost.

    python -m benchmarks.nastran_decks FOLDER... [--megabytes 1]
    python -m benchmarks.nastran_decks --elements 2000 20000

Decks are files with GRID cards of at most --megabytes; each is imported with --density 7.85e-9 if materials lack one.
Printed are a line for each, with the mass of both and K R of what cancels in it, and the counts. With --elements blocks
of CHEXA and rolled sheets of CQUAD4 are imported through MYSTRAN: processor seconds of this process and of all runs.
"""

from __future__ import annotations

import argparse
import math
import re
import resource
import sys
import tempfile
from pathlib import Path

import numpy as np

from morembs.base.errors import MorembsError
from morembs.fem import FEModel, rigid_motion
from morembs.importers import import_file
from morembs.importers.to_model import model_of
from tests.support.meshes import box
from tests.support.mystran import STEEL, plate

DENSITY = 7.85e-9


def imported(path: Path, engine: str | None) -> FEModel | str:
    """The model of a deck, or why there is none."""
    for options in ({"density": DENSITY}, {}):
        try:
            return model_of(import_file(path, "nastran", options, engine=engine))
        except MorembsError as error:
            reason = str(error)
    return reason


def figures(model: FEModel) -> tuple[float, float]:
    """Mass, and K R over what cancels in it."""
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    terms = float((abs(model.K) @ np.abs(R)).max())
    return float(R[:, 0] @ (model.M @ R[:, 0])), float(np.abs(model.K @ R).max()) / max(terms, 1e-300)


def rate(folders: list[Path], megabytes: float) -> None:
    """A line for each deck, and the counts."""
    counts, total = {"own": 0, "mystran": 0}, 0
    for path in sorted(path for folder in folders for path in folder.rglob("*") if path.is_file()):
        if path.stat().st_size > megabytes * 1e6 or not re.search(rb"^GRID", path.read_bytes(), re.MULTILINE):
            continue
        total += 1
        line = path.name
        for name, engine in (("own", None), ("mystran", "mystran")):
            found = imported(path, engine)
            counts[name] += not isinstance(found, str)
            said = found[:120] if isinstance(found, str) else "{:.4g} kg, {:.0e}".format(*figures(found))
            line += f"; {name}: {said}"
        print(line, flush=True)
    print(f"{total} decks: own assembly {counts['own']}, MYSTRAN {counts['mystran']}")


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
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--megabytes", type=float, default=1.0)
    parser.add_argument("--elements", type=int, nargs="*", default=[])
    given = parser.parse_args(arguments)
    if given.folders:
        rate(given.folders, given.megabytes)
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
