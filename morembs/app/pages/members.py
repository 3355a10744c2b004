"""Content and drawings of a file of planar members in a report, in the form of those of bodies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.app.pages.content import origin_of
from morembs.app.report.style import STYLE
from morembs.dynamics.gmp import ReducedMember
from morembs.dynamics.gmp.stored import read_members, read_origin

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def content_of_members(path: Path) -> dict[str, Any]:
    """What a file of members holds, with the keys of ``content_of`` and ``members``."""
    members = {name: ReducedMember.of(data) for name, data in read_members(path).items()}
    recipe, provenance = read_origin(path)
    first = next(iter(members))
    mass = float(members[first].rigid[:, 0] @ (members[first].M @ members[first].rigid[:, 0]))
    return {
        "members": True,
        "bodies": {name: _member(member) for name, member in members.items()},
        "shown": first,
        "dofs": len(members[first].data.fields.turning) + members[first].data.fields.translations.size,
        "mass_kg": mass,
        "center_of_mass_m": [],
        "warnings": [],
        "interfaces": {frame: {"coupling": "rigid", "nodes": 1} for frame in ("start", "end")},
        **origin_of(provenance, str(dict(recipe.get("member") or {}).get("mesh") or "beam")),
    }


def _member(member: ReducedMember) -> dict[str, Any]:
    """A member: its size, range and error, and the frequencies of its bending between held frames."""
    data = member.data
    hz = np.sqrt(data.squares[: data.count]) / (2 * np.pi)
    notes = (
        f"frequencies between held frames; end angles up to {data.reach:.4g} rad, tables of "
        f"{len(data.table.coefficients)} points per angle, whose derivatives miss motions and reactions by "
        f"{float(data.errors.max()):.1e}"
    )
    return {
        "method": f"global modal parameterisation, {data.formulation}",
        "order": member.size,
        "asked": {"modes": member.modes},
        "frequencies_hz": hz[: STYLE.document_frequencies].tolist(),
        "kind": "none",
        "measure": "",
        "limits": {},
        "band_hz": None,
        "notes": notes,
    }


def draw_member(figure: Figure, path: Path, name: str, *, bare: bool = False) -> bool:
    """Shapes of equilibrium at end angles over the range of the tables; ``bare`` without axes."""
    member = ReducedMember.of(read_members(path)[name])
    figure.set_layout_engine("constrained")
    axes, data = figure.add_subplot(), member.data
    places, reach = data.fields.translations, data.reach
    for a, b in ((-1, 1), (-0.5, 0.5), (0, 0), (0.5, -0.5), (1, -1), (1, 1)):
        shape = member.nodes(data.parts(data.at(reach * np.array([a, b], dtype=float))[0])[0])
        axes.plot(*shape[places].T, ".", markersize=1 if bare else 2, label=f"{a * reach:.3g}, {b * reach:.3g} rad")
    axes.set_aspect("equal")
    if bare:
        axes.set_axis_off()
        return True
    axes.set(xlabel="x, m", ylabel="y, m")
    axes.legend(title="end angles", loc="center left", bbox_to_anchor=(1, 0.5))
    return True
