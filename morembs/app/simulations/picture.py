"""Pictures of a simulation, for its page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from morembs.app.report.style import STYLE
from morembs.app.simulations.result_file import Recording
from morembs.base.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Draws on a figure, and says whether there was anything to draw.
Drawing = Callable[["Figure"], bool]


def pictures_of(recording: Recording) -> list[tuple[str, Drawing]]:
    """What is drawn of a simulation, each with its title: motions, deflections, reactions, contact, energy."""
    t = recording.time
    drawn: list[tuple[str, Drawing]] = []
    for name, body in recording.bodies.items():
        for key, marker in body.markers.items():
            drawn.append(_curves(f"position of {name}:{key}", "m", t, dict(zip("xyz", marker.position.T, strict=True))))
        if body.kind in ("elastic", "held") and body.coordinates.shape[1]:
            columns = {str(k): column for k, column in enumerate(body.coordinates.T, start=1)}
            drawn.append(_curves(f"elastic coordinates of {name}", "", t, columns))
    forces = {name: np.linalg.norm(joint.reaction[:, :3], axis=1) for name, joint in recording.joints.items()}
    drawn += [_curves("reaction forces", "N", t, forces)] if forces else []
    pushes = {name: each.force.sum(axis=1) for name, each in recording.contacts.items()}
    drawn += [_curves("contact forces", "N", t, pushes)] if pushes else []
    for name, each in recording.sliders.items():
        drawn.append(_curves(f"path below {name}", "m", t, dict(zip("xyz", each.displacement.T, strict=True))))
    energy = recording.energy
    drawn.append(
        _curves("energy", "J", t, {"kinetic": energy.kinetic, "potential": energy.potential, "work": energy.work})
    )
    return drawn


def _curves(title: str, unit: str, t: Floats, curves: Mapping[str, Floats]) -> tuple[str, Drawing]:
    def draw(figure: Figure) -> bool:
        axes = figure.subplots()
        for name, values in curves.items():
            axes.plot(t, values, label=name, linewidth=STYLE.curve_line)
        axes.set_title(title, loc="left")
        axes.set_xlabel("time, s")
        axes.set_ylabel(unit)
        axes.grid(alpha=STYLE.grid_opacity)
        if len(curves) <= STYLE.named_curves:
            axes.legend(loc="upper right")
        figure.tight_layout()
        return True

    return title, draw
