"""An overhung rotor of solid elements: a massless shaft along x with a square disc at its end."""

from __future__ import annotations

import itertools

import numpy as np

from morembs.fem import ElementBlock, FEModel, Mesh
from morembs.fem.assembly import assemble
from morembs.fem.interface import Interface, make_interface
from morembs.fem.material import isotropic
from tests.support.meshes import merged, points_and_cells, where

SHAFT, DISC = 0.3, 0.02
# Edges of the elements of the disc across: those of the shaft are among them.
ACROSS = (-0.1, -0.055, -0.01, 0.0, 0.01, 0.055, 0.1)


def rotor_mesh() -> Mesh:
    """Shaft of 10 x 2 x 2 and disc of 1 x 6 x 6 elements hex20, sets SHAFT and DISC."""
    shaft = points_and_cells("hex20", list(itertools.product(range(10), range(2), range(2))))
    shaft = shaft * [SHAFT / 10, 0.01, 0.01] - [0, 0.01, 0.01]
    disc = points_and_cells("hex20", list(itertools.product(range(1), range(6), range(6))))
    across = [np.interp(disc[..., k], range(7), ACROSS) for k in (1, 2)]
    disc = np.stack([SHAFT + DISC * disc[..., 0], *across], axis=-1)
    whole = merged("hex20", np.concatenate([shaft, disc]))
    nodes, count = whole.blocks[0].nodes, len(shaft)
    block = ElementBlock(type="hex20", nodes=nodes, ids=np.arange(1, len(nodes) + 1))
    sets = {"SHAFT": (np.arange(count),), "DISC": (np.arange(count, len(nodes)),)}
    return Mesh(nodes=whole.nodes, blocks=(block,), element_sets=sets, source="rotor")


def rotor() -> tuple[FEModel, list[Interface]]:
    """The model, free, with rigid interfaces "clamp" at x = 0 and "disc" on the far face."""
    model = assemble(
        rotor_mesh(),
        [
            isotropic(set="SHAFT", young=2.1e11, poisson=0.3, density=7.85),
            isotropic(set="DISC", young=300 * 2.1e11, poisson=0.3, density=7850.0),
        ],
    )
    ends = (("clamp", 0.0), ("disc", SHAFT + DISC))
    return model, [make_interface(model, name=name, nodes=where(model, 0, x), point=[x, 0, 0]) for name, x in ends]
