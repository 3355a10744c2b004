"""Mass, centre of mass and inertia as M has them, against the limits of real bodies and against the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Floats
from morembs.body.diagnostics.findings import Finding, Names
from morembs.body.diagnostics.readings import orders
from morembs.body.diagnostics.tolerances import TOL
from morembs.fem import DofMap, Mesh, Nodes
from morembs.fem.assembly import chunks
from morembs.fem.elements import TYPES
from morembs.fem.formulations import geometry
from morembs.fem.mass import mass_properties
from morembs.fem.material import Material
from morembs.fem.mesh import material_of_elements
from morembs.fem.rigid_residual import motion


def mass_findings(M: sp.csr_array, nodes: Nodes, dofs: DofMap, names: Names) -> tuple[list[Finding], dict[str, Any]]:
    """What is wrong with the rigid-body mass of M, and mass in kg, centre of mass (3,) in m, inertia (3, 3) in kg m2
    about it (in other units where the input has others)."""
    if not (np.isin([0, 1, 2], dofs.component)).all():
        return [], {}
    R, center, length = motion(nodes, dofs)
    G = R.T @ (M @ R)
    along = np.diag(G)[:3]
    if not (along > 0).all():
        sentence = f"the mass along x, y, z is {_numbers(along)}; expected three equal positive numbers"
        cure = "look for negative densities or point masses, or a wrong map of the dofs"
        return [Finding(code="no-mass", severity="error", sentence=sentence, cure=cure)], {}
    plain = R.copy()
    plain[:, 3:] *= length
    mass, center_of_mass, inertia = mass_properties(M, plain, center)
    facts = {"mass": mass, "center_of_mass": center_of_mass, "inertia": inertia}
    off = float(np.abs(G[:3, :3] - mass * np.eye(3)).max()) / mass
    if off > TOL.isotropic_mass:
        return [_anisotropic(M, nodes, dofs, along, off)], facts
    findings = []
    used = nodes.xyz[np.unique(dofs.node)]
    low, high = used.min(axis=0), used.max(axis=0)
    reach = TOL.center_outside * float(np.linalg.norm(high - low))
    if (center_of_mass < low - reach).any() or (center_of_mass > high + reach).any():
        sentence = f"the centre of mass ({_numbers(center_of_mass)}) m lies outside the nodes"
        cure = "check that coordinates and dof map belong to the mass matrix"
        findings.append(Finding(code="center-outside", severity="warning", sentence=sentence, cure=cure))
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    if np.linalg.eigvalsh(second)[0] < -TOL.negative_inertia * max(float(np.trace(inertia)), np.finfo(float).tiny):
        principal = np.asarray(np.linalg.eigvalsh(inertia), dtype=np.float64)
        words = f"principal moments of inertia {_numbers(principal)} kg m2"
        sentence = f"{words} are impossible: one exceeds the sum of the others"
        cure = "check the coordinates, and the inertias of point masses"
        findings.append(Finding(code="impossible-inertia", severity="warning", sentence=sentence, cure=cure))
    return findings, facts


def _anisotropic(M: sp.csr_array, nodes: Nodes, dofs: DofMap, along: Floats, off: float) -> Finding:
    sentence = (
        f"the mass along x, y, z is {_numbers(along)}, with {off:.1e} of it between directions; expected equal masses"
    )
    for words, other in orders(nodes, dofs):
        T = motion(nodes, other)[0][:, :3]
        G = T.T @ (M @ T)
        # Rotations without mass have equal masses too.
        if np.trace(G) > 0 and np.abs(G - np.trace(G) / 3 * np.eye(3)).max() <= 1e-6 * np.trace(G):
            sentence += f"; the dofs of M are {words}"
            return Finding(
                code="mass-dof-order", severity="error", sentence=sentence, cure="write K and M in one order"
            )
    cure = "check the dof map of M, and for point masses or fluid that act along some directions only"
    return Finding(code="mass-by-direction", severity="warning", sentence=sentence, cure=cure)


def against_mesh(facts: dict[str, Any], mesh: Mesh, materials: Sequence[Material]) -> list[Finding]:
    """The mass of M against density times volume, with the volume among the facts."""
    owner = material_of_elements(mesh, materials)
    density = np.array([material.density for material in materials])
    volume = mass = 0.0
    first = np.zeros(3)
    for block, rows in chunks(mesh):
        kind = TYPES[block.type]
        rule = kind.rule(kind.stiffness_order)
        x = mesh.nodes.xyz[block.nodes[rows]]
        dV = geometry(x, rule, block.ids[rows], kind).dV
        rho = density[owner[id(block)][rows]]
        volume += float(dV.sum())
        mass += float(rho @ dV.sum(axis=1))
        first += np.einsum("e,eq,qk,eka->a", rho, dV, rule.N, x, optimize=True)
    facts |= {"volume": volume, "mesh_mass": mass, "mesh_center_of_mass": first / mass}
    ratio = facts["mass"] / mass
    if abs(ratio - 1) <= TOL.geometry_mass:
        return []
    heavier = 1 < ratio < 10
    sentence = f"M has {ratio:.6g} times the mass of the mesh ({facts['mass']:.6g} and {mass:.6g} kg)"
    cure = "point masses would explain it" if heavier else "check density and units, and whether M has all parts"
    severity = "note" if heavier else "warning"
    return [Finding(code="mass-of-mesh", severity=severity, sentence=sentence, cure=cure)]


def _numbers(values: Floats) -> str:
    return ", ".join(f"{value:.6g}" for value in np.asarray(values).tolist())
