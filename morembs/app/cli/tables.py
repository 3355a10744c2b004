"""Tables and words for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from morembs.app.cli.style import STYLE
from morembs.app.cli.tolerances import TOL
from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame
from morembs.body.floating.ranking import RankedTerm


def titled(console: Console, title: str, table: Table) -> None:
    """Print a table; on a terminal that is too narrow its lines run on below, and no word or number is broken."""
    console.print(f"\n[bold]{title}[/]", highlight=False, soft_wrap=True)
    for column in table.columns:
        texts = [str(column.header), *map(str, column.cells)]
        words = texts if column.no_wrap else [word for text in texts for word in text.split()]
        column.min_width = max(map(len, words), default=0)
    width = console.width
    console.width = max(
        width, Measurement.get(console, console.options.update(width=STYLE.max_table_width), table).minimum
    )
    console.print(table, crop=False)
    console.width = width


def words(kinds: Sequence[str]) -> str:
    """``12 constraint + 30 fixed-interface = 42 coordinates``."""
    counts = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
    return " + ".join(f"{count} {kind}" for kind, count in counts.items()) + f" = {len(kinds)} coordinates"


def plain_table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column(columns[0], no_wrap=True)
    for column in columns[1:]:
        table.add_column(column, justify="right")
    table.show_header = any(columns)
    return table


def percent(ratio: float) -> str:
    return "0" if abs(ratio) < TOL.zero_ratio else f"{100 * ratio:.2g}"


def mass_table(mass: float, center: Floats, inertia: Floats) -> Table:
    table = plain_table("", "")
    table.add_row("mass", f"{mass:.6g} kg")
    table.add_row("centre of mass", ", ".join(f"{v:.6g}" for v in _clean(center)) + " m")
    for label, row in zip(("inertia about it", "", ""), _clean(inertia), strict=True):
        table.add_row(label, "  ".join(f"{v:12.5e}" for v in row) + " kg m2")
    return table


def _clean(values: Floats) -> Floats:
    """What lies below the digits shown, against the largest entry, becomes zero."""
    return np.where(np.abs(values) < TOL.zero_entry * np.abs(values).max(initial=0.0), 0.0, values)


def listed(values: Floats | None) -> list[float] | None:
    return None if values is None else values.tolist()


def bytes_words(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"


def frame_words(frame: FloatingFrame) -> str:
    """``tangent frame at big_end, 36 elastic coordinates, geometric stiffening (6 of 24 terms kept)``."""
    at = f" at {' and '.join(frame.interfaces)}" if frame.interfaces else ""
    words = f"{frame.kind} frame{at}, {frame.count} elastic coordinates"
    if frame.stiffening is not None:
        stiffening = frame.stiffening
        kept = sum(share > 0 and name not in stiffening.dropped for name, share in stiffening.share.items())
        words += f", geometric stiffening ({kept} of {len(stiffening.share)} terms matter)"
    return words


def _percent(share: float) -> str:
    return f"{100 * share:.0f}" if share >= TOL.whole_percent_share else f"{100 * share:.2g}"


def ranking_words(terms: Sequence[RankedTerm]) -> str:
    """``Oe 45 % (elastic), ...``: the inertia terms that matter most."""
    shown = [f"{term.name} {_percent(term.share)} % ({term.equation})" for term in terms[: STYLE.ranked_terms]]
    return ", ".join(shown) + (", ..." if len(terms) > STYLE.ranked_terms else "")
