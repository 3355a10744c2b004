"""Axes along which programs have materials of shells where a deck gives none: each has other ones."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.importers.decks.tables import DeckTables, Section
from morembs.importers.tolerances import TOL


def is_isotropic(C: Floats | None) -> bool:
    """True if a stiffness (6, 6) is there and the same along all axes."""
    if C is None:
        return False
    plain = np.diag([2 * C[3, 3]] * 3 + [C[3, 3]] * 3)
    plain[:3, :3] += C[0, 1]
    return bool(np.abs(C - plain).max() <= TOL.isotropic_error * np.abs(C).max())


def refuse_own_axes(deck: DeckTables, section: Section, program: str, what: str) -> None:
    """Refuse layers and materials of shells along axes that the program of the deck has otherwise than ``program``.

    Raises:
        InputError: in these cases; the message begins with ``what``.
    """
    if section.kind not in ("shell", "membrane") or section.axes is not None or deck.program == program:
        return
    given = (deck.materials.get(name) for name in [ply.material for ply in section.plies] or [section.material])
    stiff = [own.stiffness for own in given if own is not None and own.stiffness is not None]
    if not all(map(is_isotropic, stiff)):
        raise InputError(
            f"{what} has a material with axes and no orientation; give it one",
            kind="unsupported",
            keyword="orientation",
        )
