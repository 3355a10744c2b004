"""All reductions of one job side by side: order, errors, time and memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from morembs.app.jobs.run import JobResult
from morembs.app.jobs.style import STYLE
from morembs.app.jobs.tolerances import TOL
from morembs.base.errors import InputError
from morembs.certificate.tolerances import TOL as CERTIFICATE

if TYPE_CHECKING:
    from morembs.certificate.record import Certificate

# What is drawn: label, attribute, marker.
ERRORS = (("largest", "error", "o"), ("static", "static_error", "s"), ("an interface held, median", "held_error", "^"))


@dataclass(frozen=True, kw_only=True)
class Contender:
    """One reduction: ``order`` coordinates, ``seconds`` of its own work, and the peak resident
    memory ``peak_memory_bytes`` of the process during it.

    Relative errors of the transfer matrix: ``error`` that is reached in the band and ``bound`` that is not exceeded
    (None without one), by the ``measure`` of the certificate; ``mean_error`` of the pointwise errors at the sampled
    frequencies,
    ``static_error``, ``held_error`` the worst median over the band with one interface held still. What reductions
    share, such as the factorisation, counts for the first that needs it. ``best`` says that no other is at most as
    large and as wrong.
    """

    name: str
    method: str
    order: int
    measure: str
    error: float
    mean_error: float
    bound: float | None
    static_error: float
    held_error: float | None
    seconds: float
    peak_memory_bytes: int
    best: bool


def contenders(result: JobResult) -> tuple[Contender, ...]:
    """The reductions of a finished job, in its order.

    Raises:
        InputError: a job without certificates.
    """
    stages = {stage.name: stage for stage in result.stages}
    orders = {body.name: body.reduced.order for body in result.bodies}
    errors = {body.name: _error(body.certificate) for body in result.bodies if body.certificate is not None}
    if len(errors) < len(orders):
        raise InputError(
            "a comparison needs errors: add a table [certify] with band_hz = [LOW, HIGH] to the job", kind="missing"
        )
    compared = []
    for body in result.bodies:
        certificate = body.certificate
        if certificate is None:
            continue
        own = (orders[body.name], errors[body.name])
        better = [
            name
            for name in orders
            if (orders[name], errors[name]) != own and orders[name] <= own[0] and errors[name] <= own[1]
        ]
        held = [float(np.nanmedian(row)) for row in certificate.held_error if np.isfinite(row).any()]
        stage = stages[f"reduce {body.name}"]
        compared.append(
            Contender(
                name=body.name,
                method=str(body.recipe["method"]),
                order=own[0],
                measure="pointwise" if certificate.kind == "sampled" else certificate.measure,
                error=own[1] if certificate.kind == "sampled" else certificate.limit.lower,
                mean_error=float(certificate.error.mean()),
                bound=None if certificate.kind == "sampled" else certificate.limit.upper,
                static_error=certificate.static_error,
                held_error=max(held) if held else None,
                seconds=stage.seconds,
                peak_memory_bytes=stage.peak_memory_bytes,
                best=not better,
            )
        )
    return tuple(compared)


def _error(certificate: Certificate) -> float:
    """What reductions are compared by: the limit of their error, or the largest sample of it."""
    return float(certificate.error.max()) if certificate.kind == "sampled" else certificate.limit.upper


def draw_contenders(path: Path, compared: tuple[Contender, ...], title: str) -> None:
    """Errors over order, time and memory as a picture file; the reductions on the Pareto front are joined.

    Raises:
        OutputError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    from morembs.app.jobs.picture import save

    figure = Figure(
        figsize=(12.0, STYLE.contenders_height), dpi=STYLE.dots_per_inch, facecolor="white", layout="constrained"
    )
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=STYLE.contenders_title_left, ha="left", fontweight="bold")
    panels = [figure.add_subplot(1, 3, number) for number in (1, 2, 3)]
    scales: tuple[tuple[str, list[float]], ...] = (
        ("reduced coordinates", [contender.order for contender in compared]),
        ("seconds", [contender.seconds for contender in compared]),
        ("peak memory of the process, GB", [contender.peak_memory_bytes / 1e9 for contender in compared]),
    )
    for panel, (label, x) in zip(panels, scales, strict=True):
        for number, contender in enumerate(compared):
            for _, attribute, marker in ERRORS:
                value = getattr(contender, attribute)
                if value is not None:
                    panel.plot(
                        max(x[number], TOL.least_drawn_cost),
                        max(value, CERTIFICATE.least_drawn_error),
                        marker=marker,
                        color=f"C{number % 10}",
                        linestyle="",
                        fillstyle="full" if attribute == "error" else "none",
                    )
        panel.set_yscale("log")
        if label == "seconds":
            panel.set_xscale("log")
        else:
            panel.xaxis.set_major_locator(MaxNLocator(5, integer=label == "reduced coordinates"))
        panel.set_xlabel(label)
        panel.grid(True, which="major", color="#d0d4d8", linewidth=STYLE.grid_line)
        panel.spines[["top", "right"]].set_visible(False)
    front = sorted((contender.order, contender.error) for contender in compared if contender.best)
    panels[0].plot([n for n, _ in front], [e for _, e in front], color="#9aa0a6", linewidth=1.0, zorder=0)
    panels[0].set_ylabel("relative error of the transfer matrix")
    names = [panels[2].plot([], [], color=f"C{k % 10}", marker="o", linestyle="")[0] for k in range(len(compared))]
    kinds = [
        panels[2].plot(
            [], [], color="#555555", marker=marker, linestyle="", fillstyle="full" if name == "error" else "none"
        )[0]
        for _, name, marker in ERRORS
    ]
    labels = [contender.name for contender in compared] + [label for label, _, _ in ERRORS]
    figure.legend(names + kinds, labels, frameon=False, loc="outside right upper")
    save(figure, path)
