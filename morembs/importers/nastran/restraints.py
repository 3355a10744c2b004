"""What SPC, SPC1 and the permanent restraints of grids hold in Nastran bulk data."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Bools, Floats, Ints
from morembs.fem.constraints import Equations
from morembs.importers.decks.labels import distinct
from morembs.importers.decks.tables import Supports
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.cards import integer
from morembs.importers.nastran.motions import components
from morembs.importers.nastran.properties import labels_of, pad
from morembs.importers.tolerances import TOL


def supports_of(bulk: Bulk) -> Supports:
    """What is held, by grids and components: in the set that the case control asks for (in all sets without case
    control), and by PS of GRID; directions are along the basic axes.

    Raises:
        InputError: subcases that ask for different sets, or cards that cannot be read.
    """
    grids = bulk.grids
    asked, has_control = bulk.choose("SPC", " with --boundary keep")
    chosen = asked if asked or has_control else None
    # Six times the row of a grid plus a component.
    codes = [np.empty(0, dtype=np.int64)]

    def hold(labels: Ints, text: str, what: str) -> None:
        if text.strip("0"):
            held = np.array(components(text, what), dtype=np.int64)
            codes.append((6 * grids.rows(labels, what)[:, None] + held).ravel())

    for number in np.unique(grids.ps[grids.ps != 0]).tolist():
        hold(grids.ids[grids.ps == number], str(number), f"{bulk.file}: PS of GRID")
    for name in ("SPC", "SPC1"):
        for words in bulk.rows[name]:
            what = f"{bulk.file}: {name} {pad(words, 1)[0]}"
            if chosen is not None and integer(pad(words, 1)[0], what) not in chosen:
                continue
            if name == "SPC1":
                hold(np.array(labels_of(words[2:], what, grids.ids), dtype=np.int64), pad(words, 2)[1], what)
                continue
            for label, text in (pad(words[at : at + 2], 2) for at in range(1, len(words), 3)):
                if label:
                    hold(np.array([integer(label, what)]), text, what)
    rows, held = np.divmod(distinct(np.concatenate(codes)), 6)
    directions = np.eye(6)[held]
    for i in np.flatnonzero(grids.cd[rows] > 0).tolist():
        directions[i] = bulk.systems.direction(int(rows[i]), int(held[i]), grids)
    return Supports(nodes=grids.ids[rows], directions=directions)


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
