"""Static modes of candidate loads in a body file, both ways: the group ``switching`` of a body."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from morembs.errors import InputError
from morembs.storage.storable import json_text

if TYPE_CHECKING:
    from morembs.reducers.switching_tables import Switching

# Stores one dataset: name, value, what it is, its units.
Put = Callable[..., None]
_TABLES = {
    "node_ids": ("labels of the candidate nodes, in the order of the path", ""),
    "xyz": ("positions of these nodes in the model", "m"),
    "node": ("per candidate: place of its node in node_ids, ascending", ""),
    "direction": ("per candidate: unit vector of the load", ""),
    "modes": ("row i: displacement along candidate i per unit of each coordinate", ""),
    "stiffness": ("band of R = Psi' K Psi: entry [k, j] of candidates j - k and j; displacements per load", "m/N"),
    "mass": ("band of Q = Psi' M Psi, as stiffness", "kg m2/N2"),
    "coupling": ("V' M Psi; zero where eigenmodes span the basis", ""),
    "weight": ("load on the coordinates under unit gravity along x, y, z", ""),
    "static_weight": ("the same on the static modes", ""),
}
_STRESS = {
    "stress": ("[p, c, l]: stress c (xx, yy, zz, xy, yz, zx) at node p per unit of coordinate l", "Pa"),
    "static_stress": ("[p, c, k]: the same per unit load of candidate stress_first[p] + k", "Pa/N"),
    "stress_first": ("first candidate in static_stress, per node", ""),
}


def write_switching(put: Put, group: str, its: Switching) -> None:
    """Store ``its`` under ``group`` with ``put(name, value, about, units)``."""
    put(f"{group}/kind", its.kind, "path: loads slide from node to node; surface: any of them may be loaded")
    for name, (about, units) in _TABLES.items():
        put(f"{group}/{name}", getattr(its, name), about, units)
    put(f"{group}/turns", its.turns.astype("u1"), "per candidate: 1 for a moment and rotation, 0 for a force")
    for name, (about, units) in _STRESS.items():
        if getattr(its, name) is not None:
            put(f"{group}/{name}", getattr(its, name), about, units)
    put(f"{group}/notes", json_text(its.notes), "what was found on the way, as JSON")


def read_switching(group: Any) -> Switching:
    """What ``write_switching`` wrote, from an open HDF5 ``group``.

    Raises:
        InputError: a dataset is missing.
    """
    from morembs.reducers.switching_tables import Switching

    missing = [name for name in (*_TABLES, "kind", "turns", "notes") if not hasattr(group.get(name), "shape")]
    if missing:
        raise InputError(f"the switching data lack {', '.join(missing)}; write the body file again")
    return Switching(
        kind=group["kind"][()].decode(), turns=group["turns"][()].astype(bool), notes=json.loads(group["notes"][()]),
        **{name: group[name][()] for name in (*_TABLES, *_STRESS) if name in group},
    )  # fmt: skip
