"""Charts of certificates: responses, and errors with their limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np

from morembs.base.charts import Chart, Curve, Panel
from morembs.base.types import Floats
from morembs.certificate.tolerances import TOL
from morembs.responses.measures import MEASURES


class Curves(Protocol):
    """What a chart takes of a ``Certificate``."""

    @property
    def frequencies_hz(self) -> Floats: ...

    @property
    def full(self) -> Floats: ...

    @property
    def reduced(self) -> Floats: ...

    @property
    def error(self) -> Floats: ...

    @property
    def limits(self) -> Mapping[str, Any]: ...

    @property
    def cells_hz(self) -> Floats: ...

    @property
    def cell_limit(self) -> Floats: ...


def certificate_chart(known: Mapping[str, Curves]) -> Chart:
    """Responses of the full model and of bodies by name, and below the errors of the bodies with their limits."""
    responses: list[Curve] = []
    errors: list[Curve] = []
    for number, (name, certificate) in enumerate(known.items()):
        hz = certificate.frequencies_hz
        if not responses:
            responses.append(Curve(name="full model", x=hz, y=certificate.full))
        responses.append(Curve(name=name, x=hz, y=certificate.reduced, color=number, dash="dashed"))
        error = np.maximum(certificate.error, TOL.least_drawn_error)
        errors += [Curve(name=name, x=hz, y=error, color=number), *_limits(name, certificate, number)]
    notes = ["solid: pointwise, |E| / |H|"]
    notes += ["dotted: limit of it"] if any(curve.dash == "dotted" for curve in errors) else []
    return Chart(
        title="Elastic frequency response between the interfaces",
        panels=(Panel(y_label="‖H‖ in m/N", curves=responses), Panel(y_label="error", curves=errors)),
        note="; ".join(notes),
    )


def _limits(name: str, certificate: Curves, color: int) -> Iterator[Curve]:
    """The pointwise limit in steps over the band; none where the certificate holds at samples alone."""
    if not certificate.limits or not len(certificate.cells_hz):
        return
    cells, limit = _fewer(certificate.cells_hz, certificate.cell_limit[:, MEASURES.index("pointwise")])
    limit = np.where(np.isfinite(limit), np.maximum(limit, TOL.least_drawn_error), np.nan)
    yield Curve(name=f"{name}, limit", x=cells.ravel(), y=np.repeat(limit, 2), color=color, dash="dotted")


def _fewer(cells: Floats, limit: Floats) -> tuple[Floats, Floats]:
    """As many cells (nc, 2) with their limits (nc,) as can be seen: neighbours become one with the larger limit."""
    step = -(-len(cells) // TOL.drawn_cells)
    starts = np.arange(0, len(cells), step)
    ends = np.minimum(starts + step, len(cells)) - 1
    return np.stack([cells[starts, 0], cells[ends, 1]], axis=1), np.maximum.reduceat(limit, starts)
