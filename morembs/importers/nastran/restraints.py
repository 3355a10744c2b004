"""What SPC, SPC1 and the permanent restraints of grids hold in Nastran bulk data."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Bools, Floats
from morembs.fem.constraints import Equations
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.cards import integer
from morembs.importers.nastran.motions import components
from morembs.importers.nastran.properties import labels_of, padded
from morembs.importers.tolerances import TOL


def held_directions(bulk: Bulk) -> dict[int, Floats]:
    """For rows of grids the directions (k, 6) in basic components along which they are held: those of the set that the
    case control asks for (of all sets without case control), and PS of GRID.

    Raises:
        InputError: subcases that ask for different sets, or cards that cannot be read.
    """
    asked, has_control = bulk.chosen("SPC", " with --boundary keep")
    chosen = asked if asked or has_control else None
    named: dict[int, set[int]] = {}

    def hold(label: int, text: str, what: str) -> None:
        if text.strip("0"):
            row = int(bulk.grids.rows(np.array([label]), what)[0])
            named.setdefault(row, set()).update(components(text, what))

    for grid in np.flatnonzero(bulk.grids.ps).tolist():
        hold(int(bulk.grids.ids[grid]), str(int(bulk.grids.ps[grid])), f"{bulk.file}: PS of GRID")
    for words in bulk.rows["SPC"]:
        what = f"{bulk.file}: SPC {padded(words, 1)[0]}"
        if chosen is None or integer(padded(words, 1)[0], what) in chosen:
            for at in range(1, len(words), 3):
                named_grid, text = padded(words[at : at + 2], 2)
                if named_grid:
                    hold(integer(named_grid, what), text, what)
    for words in bulk.rows["SPC1"]:
        what = f"{bulk.file}: SPC1 {padded(words, 1)[0]}"
        if chosen is None or integer(padded(words, 1)[0], what) in chosen:
            for label in labels_of(words[2:], what, bulk.grids.ids):
                hold(label, padded(words, 2)[1], what)
    return {
        row: np.array([bulk.systems.direction(row, c, bulk.grids) for c in sorted(own)])
        for row, own in sorted(named.items())
    }


def held_equations(held: dict[int, Floats], there: Bools) -> Equations | None:
    """Equations that hold the directions, among the dofs that are ``there`` (n, 6); None where nothing is held."""
    nodes, dofs, offsets, least = list[int](), list[int](), [0], TOL.repeated_direction
    term_nodes, term_components, coefficients = list[int](), list[int](), list[float]()
    for row, directions in held.items():
        own = np.flatnonzero(there[row])
        if not len(own):
            continue
        # The directions that stand out are solved for first.
        R, order = sl.qr(directions[:, own], mode="r", pivoting=True)
        rank = int((np.abs(np.diag(R)) > least).sum())
        follows = -np.linalg.solve(R[:rank, :rank], R[:rank, rank:])
        for i in range(rank):
            terms = [(own[order[rank + j]], value) for j, value in enumerate(follows[i]) if abs(value) > least]
            nodes.append(row)
            dofs.append(int(own[order[i]]))
            term_nodes += [row] * len(terms)
            term_components += [int(c) for c, _ in terms]
            coefficients += [float(value) for _, value in terms]
            offsets.append(len(coefficients))
    if not nodes:
        return None
    return Equations(
        name="SPC",
        nodes=np.array(nodes),
        components=np.array(dofs),
        offsets=np.array(offsets),
        term_nodes=np.array(term_nodes),
        term_components=np.array(term_components),
        coefficients=np.array(coefficients),
    )
