"""Tubes that carry flow: dense eigenvalues, the straight pipe of the literature and a bent tube in space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sl

from morembs import FEModel, Flow, Tube, add_flow, make_interface, tube_model
from morembs.fem import DofMap

PIPE = Tube(outer=0.02, inner=0.018, young=2e11, density=7800.0)
STEEL = Tube(outer=3e-3, inner=2.6e-3, young=195e9, density=8000.0)
BORE = np.pi / 4 * STEEL.inner**2


def dense(model: FEModel) -> dict[str, np.ndarray]:
    """All five matrices, those that are not there as zeros."""
    none = np.zeros((model.size, model.size))
    return {name: none if (A := getattr(model, name)) is None else A.toarray() for name in "KMDGN"}


def eigenvalues(model: FEModel) -> np.ndarray:
    """All s of s^2 M + s (D + G) + K + N in the upper half plane, by size; dense QZ."""
    A, n = dense(model), model.size
    left = np.block([[np.zeros((n, n)), np.eye(n)], [-A["K"] - A["N"], -A["D"] - A["G"]]])
    s = sl.eig(left, sl.block_diag(np.eye(n), A["M"]), right=False)
    s = s[s.imag >= -1e-9 * np.abs(s)]
    return s[np.argsort(np.abs(s))]


def pipe(speed: float, beta: float, ends: str, elements: int = 24) -> tuple[FEModel, float]:
    """Straight pipe of 1 m in a plane with the mass ratio ``beta`` and the dimensionless ``speed`` u, and the unit of
    its dimensionless frequencies in rad/s (Paidoussis 1998, ch. 3)."""
    tube, bore = PIPE, np.pi / 4 * PIPE.inner**2
    mass = tube.density * np.pi / 4 * (tube.outer**2 - tube.inner**2)
    EI = tube.young * np.pi / 64 * (tube.outer**4 - tube.inner**4)
    fluid = beta * mass / (1 - beta)
    whole = tube_model(np.linspace([0.0, 0, 0], [1.0, 0, 0], elements + 1), tube)
    flow = Flow(
        mass_flow=speed * np.sqrt(EI * fluid),
        density=fluid / bore,
        area=bore,
        outlet="free" if ends == "cantilever" else "held",
    )
    carried = add_flow(whole, np.arange(elements + 1), flow)
    node, component = carried.dofs.node, carried.dofs.component
    first, last = node == 0, node == elements
    held = {"pinned": (first | last) & (component == 1), "clamped": first | last, "cantilever": first}[ends]
    return on(carried, np.isin(component, [1, 5]) & ~held), float(np.sqrt(EI / (mass + fluid)))


def on(model: FEModel, free: np.ndarray) -> FEModel:
    """``model`` with all but the ``free`` (N,) dofs held."""
    rows = np.flatnonzero(free)
    parts = {name: A[rows][:, rows] for name in "KMDGN" if (A := getattr(model, name)) is not None}
    return replace(model, **parts, dofs=DofMap(node=model.dofs.node[rows], component=model.dofs.component[rows]))


def arch(mass_flow: float = 0.4, elements: int = 40) -> FEModel:
    """A tube along an arch that leaves its plane, both ends clamped."""
    t = np.linspace(0, np.pi, elements + 1)
    points = np.column_stack([0.1 * np.cos(t), 0.1 * np.sin(t), 0.02 * np.sin(2 * t)])
    flow = Flow(mass_flow=mass_flow, density=1000.0, area=BORE)
    return add_flow(tube_model(points, STEEL, held=(0, elements)), np.arange(elements + 1), flow)


def ports(model: FEModel) -> list:
    """Two interfaces at different nodes: one is loaded along x and z, one moves along y."""
    one = make_interface(model, name="one", nodes=np.array([13]), coupling="direct", components=[0, 2])
    return [one, make_interface(model, name="two", nodes=np.array([25]), coupling="direct", components=[1])]
