"""Small decks of shells and beams of CalculiX: plates, folds, frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from tests.support.calculix import STEEL

Move = Callable[[float, float], Sequence[float]]


def plate(
    code: str, n: tuple[int, int] = (3, 2), *, move: Move | None = None, section: str = "", data: str = "0.2"
) -> str:
    """A plate of 10 x 6, whose points ``move`` takes elsewhere; nodes of the edge x = 0 are the set END."""
    step = 2 if code[1] in "68" else 1
    nx, ny = step * n[0] + 1, step * n[1] + 1

    def label(i: int, j: int) -> int:
        return 1 + i + nx * j

    elements = []
    for j in range(0, ny - 1, step):
        for i in range(0, nx - 1, step):
            corners = [(i, j), (i + step, j), (i + step, j + step), (i, j + step)]
            middles = [(i + 1, j), (i + 2, j + 1), (i + 1, j + 2), (i, j + 1)]
            center = (i + 1, j + 1)
            if code in ("S3", "S6"):
                halves = ((0, 1, 2), [*middles[:2], center]), ((0, 2, 3), [center, *middles[2:]])
                elements += [[corners[c] for c in three] + (more if step == 2 else []) for three, more in halves]
            else:
                elements.append(corners + (middles if step == 2 else []))
    used = sorted({label(*node) for element in elements for node in element})
    text = "*NODE, NSET=ALL\n"
    for number in used:
        i, j = (number - 1) % nx, (number - 1) // nx
        x, y = 10.0 * i / (nx - 1), 6.0 * j / (ny - 1)
        place = (x, y, 0.0) if move is None else move(x, y)
        text += f"{number}, " + ", ".join(f"{value:.15g}" for value in place) + "\n"
    text += f"*ELEMENT, TYPE={code}, ELSET=PLATE\n"
    for number, element in enumerate(elements, start=1):
        text += f"{number}, " + ", ".join(str(label(*node)) for node in element) + "\n"
    end = ", ".join(str(label(0, j)) for j in range(ny) if label(0, j) in used)
    return f"{text}*NSET, NSET=END\n{end}\n{STEEL}*SHELL SECTION, ELSET=PLATE, MATERIAL=STEEL{section}\n{data}\n"


def fold(angle: float) -> Move:
    """Half of a plate turned about the line x = 5."""
    return lambda x, y: (x, y, 0.0) if x <= 5 else (5 + (x - 5) * np.cos(angle), y, (x - 5) * np.sin(angle))


def roll(radius: float) -> Move:
    """A plate on a cylinder."""
    return lambda x, y: (radius * np.sin(x / radius), y, radius * (1 - np.cos(x / radius)))


def frame(
    code: str,
    corners: Sequence[Sequence[float]],
    n: int = 2,
    *,
    section: str = "RECT",
    data: str = "0.3, 0.5",
    direction: str = "0, 1, 0",
) -> str:
    """Beams along a line through ``corners``, ``n`` between two."""
    step = int(code[2])
    places = [np.array(corners[0], dtype=float)]
    for a, b in pairwise(corners):
        places += [np.array(a) + (np.array(b) - np.array(a)) * i / (step * n) for i in range(1, step * n + 1)]
    text = "*NODE, NSET=ALL\n"
    text += "".join(f"{i}, {x:.15g}, {y:.15g}, {z:.15g}\n" for i, (x, y, z) in enumerate(places, start=1))
    text += f"*ELEMENT, TYPE={code}, ELSET=BEAMS\n"
    for number in range(n * (len(corners) - 1)):
        nodes = range(step * number + 1, step * number + step + 2)
        text += f"{number + 1}, {', '.join(map(str, nodes))}\n"
    text += f"{STEEL}*BEAM SECTION, ELSET=BEAMS, MATERIAL=STEEL, SECTION={section}\n{data}\n"
    return text + (f"{direction}\n" if direction else "")


def doubled(code: str) -> str:
    """Beams along a line with a bend, each with another of another section on its nodes."""
    text = frame(code, ((0, 0, 0), (5, 0, 0), (10, 0, 0.8)), 1)
    return (
        f"{text}*ELEMENT, TYPE={code}, ELSET=MORE\n101, 1, 2, 3\n102, 3, 4, 5\n"
        "*BEAM SECTION, ELSET=MORE, MATERIAL=STEEL, SECTION=RECT\n0.5, 0.2\n0, 1, 0\n"
    )


def arc(code: str) -> str:
    """Beams beside an arc, in its plane."""
    places = [(10 * np.sin(a), 0.0, 10 * np.cos(a)) for a in np.linspace(0, 0.9, 4)]
    return frame(code, places, 1, section="RECT, OFFSET1=0.1, OFFSET2=0.5")


PORTAL = ((0, 0, 0), (0, 0, 8), (6, 0, 8), (6, 0, 0))
LINE = ((0, 0, 0), (10, 0, 0))


def stiffened(move: Move | None = None) -> str:
    """A plate with a beam along an edge, whose axis is beside it."""
    text = plate("S8R", move=move) + "*ELEMENT, TYPE=B32R, ELSET=RIB\n101, 1, 2, 3\n102, 3, 4, 5\n103, 5, 6, 7\n"
    return text + "*BEAM SECTION, ELSET=RIB, MATERIAL=STEEL, SECTION=RECT, OFFSET2=0.5\n0.3, 0.5\n0, 1, 0\n"


def stepped(code: str) -> str:
    """A plate whose thickness doubles at its middle."""
    text = plate(code, (4, 2)).replace("*MATERIAL", "*ELSET, ELSET=THICK\n3, 4, 7, 8\n*MATERIAL", 1)
    return text + "*SHELL SECTION, ELSET=THICK, MATERIAL=STEEL\n0.4\n"


def on_solid() -> str:
    """A plate that goes on from two solids, with which it shares three nodes of an edge."""
    text = plate("S8")
    nodes = "".join(
        f"{100 + i}, {x:g}, {y:g}, {z:g}\n"
        for i, (x, y, z) in enumerate([(x, y, z) for z in (0, 2) for y in (0, 3, 6) for x in (-2, 0)])
    )
    # Corners of hexahedra at x = 0, z = 0 are nodes 1, 15 and 29 of the plate.
    same = {101: 1, 103: 15, 105: 29}
    rows = [[100, 101, 103, 102, 106, 107, 109, 108], [102, 103, 105, 104, 108, 109, 111, 110]]
    lines = "".join(f"{201 + i}, " + ", ".join(str(same.get(n, n)) for n in row) + "\n" for i, row in enumerate(rows))
    kept = "".join(line + "\n" for line in nodes.splitlines() if int(line.split(",")[0]) not in same)
    return f"{text}*NODE\n{kept}*ELEMENT, TYPE=C3D8, ELSET=SOLID\n{lines}*SOLID SECTION, ELSET=SOLID, MATERIAL=STEEL\n"


# Free structures by name.
STRUCTURES: dict[str, str] = {
    **{f"flat {code}": plate(code) for code in ("S3", "S4", "S4R", "S6", "S8", "S8R")},
    **{f"rolled {code}": plate(code, move=roll(20.0)) for code in ("S3", "S4", "S6", "S8", "S8R")},
    **{f"folded {code}": plate(code, (4, 2), move=fold(1.0)) for code in ("S3", "S4", "S6", "S8", "S8R")},
    "steeply rolled S8R": plate("S8R", (4, 2), move=roll(3.5)),
    "S8 off its nodes": plate("S8", move=roll(20.0), section=", OFFSET=0.3"),
    "S8R with normals": plate("S8R") + "*NORMAL\n1, 1, 0.3, 0, 1\n2, 3, 0.05, 0, 1\n",
    "S8 with thicknesses": plate("S8", section=", NODAL THICKNESS").replace(
        "*MATERIAL", "*NODAL THICKNESS\nALL, 0.2\nEND, 0.3\n*MATERIAL", 1
    ),
    "stepped S8R": stepped("S8R"),
    "stiffened S8R": stiffened(),
    "rolled and stiffened S8R": stiffened(roll(20.0)),
    "S8 on solids": on_solid(),
    "S8R on a rigid body": plate("S8R", move=roll(20.0)).replace("*NSET, NSET=END\n", "*NSET, NSET=END\n4, ")
    + "*NODE\n900, -1, 3, 0.5\n*RIGID BODY, NSET=END, REF NODE=900\n",
    "folded S4 on a rigid body": plate("S4", (4, 2), move=fold(1.0))
    + "*NSET, NSET=FOLD\n3, 8, 13, 1\n*NODE\n900, 3, 3, 4\n*RIGID BODY, NSET=FOLD, REF NODE=900\n",
    **{f"portal {code}": frame(code, PORTAL) for code in ("B31", "B32", "B32R")},
    "portal off its nodes": frame("B32", PORTAL, section="RECT, OFFSET1=0.4, OFFSET2=-0.2"),
    "straight B31": frame("B31", LINE, 4, direction=""),
    "round B32": frame("B32", PORTAL, section="CIRC", data="0.4"),
    "elliptic B32R": frame("B32R", PORTAL, section="CIRC", data="0.4, 0.5"),
    "straight B32R": frame("B32R", LINE, direction=""),
    **{f"doubled {code}": doubled(code) for code in ("B32", "B32R")},
    **{f"{code} off a bend": arc(code) for code in ("B32", "B32R")},
    "bent B32": frame("B32", ((0, 0, 0), (4, 0, 0.5), (8, 0.5, 1.5)), direction="0, 0.3, 1"),
}
