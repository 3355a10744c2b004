"""Examines the matrices of a model before they are used, and says in plain words what is wrong with them.

The cheap part takes a few dozen passes over the entries of K and M. ``deep`` adds factorisations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.base.units import Units
from morembs.body.diagnostics import matrices
from morembs.body.diagnostics.dof_map import map_findings
from morembs.body.diagnostics.elements import double_elements
from morembs.body.diagnostics.findings import Diagnosis, Finding, Names
from morembs.body.diagnostics.mass import against_mesh, mass_findings
from morembs.body.diagnostics.modes import mode_findings
from morembs.body.diagnostics.parts import part_of_dofs, parts_findings
from morembs.body.diagnostics.readings import fitting_order, rotation_factor, rotation_finding
from morembs.body.diagnostics.rigid import free_motions, rigid_findings
from morembs.body.diagnostics.tolerances import TOL
from morembs.body.diagnostics.units import estimate, unit_findings
from morembs.fem import DofMap, FEModel, Mesh, Nodes
from morembs.fem.material import Material
from morembs.fem.rigid_residual import is_mounted, residual
from morembs.fem.tolerances import TOL as FEM
from morembs.linalg.congruence import magnitudes
from morembs.linalg.sparse.solver import LinearSolver


@dataclass(eq=False)
class _Case:
    """A model under examination; matrices become whole, and the dof map right, as it goes on."""

    K: sp.csr_array
    M: sp.csr_array
    D: sp.csr_array | None
    nodes: Nodes | None
    dofs: DofMap | None
    findings: list[Finding] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def names(self) -> Names:
        return Names(nodes=self.nodes, dofs=self.dofs)


def examine(
    K: sp.sparray,
    M: sp.sparray,
    D: sp.sparray | None = None,
    nodes: Nodes | None = None,
    dofs: DofMap | None = None,
    mesh: Mesh | None = None,
    materials: Sequence[Material] = (),
    *,
    deep: bool = False,
    units: Units | None = None,
    declared: Units | None = None,
    solver: LinearSolver | None = None,
    up_to_hz: float | None = None,
) -> Diagnosis:
    """Faults and facts of a model.

    Args:
        K, M, D: (N, N) as they came, half stored or not symmetric.
        nodes, dofs, mesh: what is known of the geometry, in the units of the matrices.
        materials: those of the mesh.
        deep: factorise: count zero-energy motions, find mechanisms, estimate the lowest frequencies.
        units: of the input; SI where not given. Numbers in sentences have SI units only where the input has them.
        declared: the units that the input was read as before it was converted to ``units``, where it was.
        solver: for ``deep``.
        up_to_hz: for ``deep``, count the modes below this exactly.

    Facts, as far as they are known: "dofs", "nodes", "mass", "center_of_mass", "inertia", "volume", "free_motions"
    (of 6), "rigid_residual", "parts", "length", "speed_of_sound", "density", "dof_order", and with ``deep``
    "zero_modes", "frequencies_hz" (upper bounds), "modes_below".

    Peak memory: 30 columns of length N and a copy of K; three copies where it is half stored or not symmetric.

    Raises:
        InputError: something that is not a matrix.
    """
    units = units if units is not None else Units()
    case = _open_case(K, M, D, nodes, dofs, mesh)
    if isinstance(case, Diagnosis):
        return case
    _matrices(case)
    names = case.names
    case.findings += matrices.empty_and_massless(case.K, case.M, names) + matrices.duplicate_rows(case.K, case.M, names)
    _order_dofs(case)
    part = part_of_dofs(case.K, case.dofs)
    case.facts["parts"] = int(part.max(initial=-1)) + 1
    case.findings += parts_findings(case.K, part, case.nodes, case.dofs, case.names, mesh)
    if mesh is not None:
        case.findings += double_elements(mesh)
    if case.nodes is not None and case.dofs is not None:
        _geometry(case, mesh, tuple(materials), units, declared)
    if deep and not any(finding.severity == "error" and finding.code in _BLOCKING for finding in case.findings):
        of_modes, facts = mode_findings(
            case.K,
            case.M,
            nodes=case.nodes,
            dofs=case.dofs,
            solver=solver,
            up_to_hz=up_to_hz,
            time=units.time,
            expected=case.facts.get("free_motions"),
            parts=case.facts["parts"],
            rounding=_rounding(case),
        )
        case.findings += of_modes
        case.facts |= facts
    return Diagnosis(findings=tuple(case.findings), facts=case.facts)


# Findings that leave nothing to factorise.
_BLOCKING = ("indefinite", "empty-dofs", "no-stiffness", "zero-matrix", "duplicate-dofs")


def _rounding(case: _Case) -> float:
    """Relative error of the entries of K, as rigid motion shows it; 0 where it shows something else."""
    codes = {finding.code for finding in case.findings}
    return float(case.facts.get("rigid_residual", 0.0)) if "few-digits" in codes else 0.0


def examine_model(model: FEModel, *, deep: bool = False, solver: LinearSolver | None = None) -> Diagnosis:
    """``examine`` of a finite-element model (SI)."""
    return examine(
        model.K, model.M, model.D, model.nodes, model.dofs, model.mesh, model.materials, deep=deep, solver=solver
    )


def complete_half_stored(
    K: sp.sparray, M: sp.sparray, D: sp.sparray | None = None
) -> tuple[sp.csr_array, sp.csr_array, sp.csr_array | None, tuple[Finding, ...]]:
    """The matrices with half-stored triangles completed, and a note for each that was; nothing else is changed.

    Raises:
        InputError: something that is not a square matrix.
    """
    whole: list[sp.csr_array | None] = []
    notes = []
    for name, A in (("K", K), ("M", M), ("D", D)):
        if A is None:
            whole.append(None)
            continue
        _refuse_shape(A, name)
        # Complex values (structural damping) stay.
        B = sp.csr_array(A)
        half = matrices.half_stored(B)
        if half:
            sentence = f"{matrices.WORDS[name]} held only {half} and was completed"
            notes.append(Finding(code="completed", severity="note", sentence=sentence))
            B = matrices.complete_triangles(B)
        whole.append(B)
    stiffness, mass, damping = whole
    if stiffness is None or mass is None:
        raise InputError("K or M is missing; expected two sparse matrices", kind="missing")
    return stiffness, mass, damping, tuple(notes)


def _refuse_shape(A: Any, name: str) -> None:
    if not sp.issparse(A) or A.ndim != 2 or A.shape[0] != A.shape[1] or not A.shape[0]:
        given = f"shape {A.shape}" if hasattr(A, "shape") else type(A).__name__
        raise InputError(
            f"{name} was given with {given}; expected a square sparse matrix", kind="conflict", keyword=name
        )


def _open_case(
    K: sp.sparray, M: sp.sparray, D: sp.sparray | None, nodes: Nodes | None, dofs: DofMap | None, mesh: Mesh | None
) -> _Case | Diagnosis:
    """The case, or what is so wrong with it that nothing more can be said."""
    named: dict[str, Any] = {name: A for name, A in (("K", K), ("M", M), ("D", D)) if name != "D" or A is not None}
    for name, A in named.items():
        _refuse_shape(A, name)
    nodes = mesh.nodes if nodes is None and mesh is not None else nodes
    N = K.shape[0]
    shapes = {A.shape[0] for A in named.values()} | (set() if dofs is None else {len(dofs)})
    if len(shapes) > 1:
        rows = ", ".join(f"{name} {A.shape[0]}" for name, A in named.items())
        sentence = f"the matrices and their map do not fit together: rows {rows}" + (
            "" if dofs is None else f", dofs {len(dofs)}"
        )
        return _diagnosis_of(
            Finding(code="shapes", severity="error", sentence=sentence, cure="take all from one model")
        )
    mapped = map_findings(nodes, dofs)
    if mapped:
        return _diagnosis_of(*mapped)
    findings, ready = [], {}
    for name, A in named.items():
        ready[name], notes = matrices.canonical(A, name)
        findings += notes
        findings += matrices.values(ready[name], name, Names(nodes=nodes, dofs=dofs))
    if any(finding.severity == "error" for finding in findings):
        return _diagnosis_of(*findings)
    case = _Case(K=ready["K"], M=ready["M"], D=ready.get("D"), nodes=nodes, dofs=dofs, findings=findings)
    case.facts |= {"dofs": N} | ({} if nodes is None else {"nodes": len(nodes)})
    return case


def _diagnosis_of(*findings: Finding) -> Diagnosis:
    return Diagnosis(findings=findings)


def _matrices(case: _Case) -> None:
    """What each matrix shows by itself; afterwards all are symmetric."""
    for name in ("K", "M", "D"):
        A = getattr(case, name)
        if A is None:
            continue
        whole, findings = matrices.symmetry(A, name, case.names)
        setattr(case, name, whole)
        case.findings += findings + matrices.definiteness(whole, name, case.names)


def _order_dofs(case: _Case) -> None:
    """Take the order of the dofs in which K fits the geometry, and say so where it is not the given one."""
    if case.nodes is None:
        return
    given = case.dofs
    if given is None:
        N, n = case.K.shape[0], len(case.nodes)
        if N % n or not 1 <= N // n <= 6 or N // n not in (3, 6):
            sentence = f"{N} dofs of {n} nodes are not 3 or 6 each, so the map of the dofs cannot be guessed"
            cure = "give the dof map; geometry was not checked"
            case.findings.append(Finding(code="no-dof-map", severity="warning", sentence=sentence, cure=cure))
            return
        at = np.arange(N, dtype=np.int64)
        given = DofMap(node=at // (N // n), component=at % (N // n))
    residuals = residual(case.K, case.nodes, given)
    share = 0.0 if is_mounted(residuals, case.nodes, given) else float(residuals.bad.mean())
    other = fitting_order(case.K, case.nodes, given) if share > TOL.many_dofs else None
    if case.dofs is None:
        case.dofs = given if other is None else other[1]
        words = "node by node (x, y, z of the first node, then of the next)" if other is None else other[0]
        case.facts["dof_order"] = words
        if other is None and share > FEM.most_dofs:
            case.dofs = None
            sentence = "no known order of the dofs fits the geometry"
            cure = "give the dof map; and check that the coordinates belong to these matrices"
            case.findings.append(Finding(code="no-dof-map", severity="warning", sentence=sentence, cure=cure))
    elif other is not None:
        sentence = f"the order of the dofs is not the given one: K fits the geometry {other[0]}"
        cure = "map the dofs in this order"
        case.facts["dof_order"] = other[0]
        case.findings.append(Finding(code="dof-order", severity="error", sentence=sentence, cure=cure))
        case.dofs = other[1]


def _geometry(
    case: _Case, mesh: Mesh | None, materials: tuple[Material, ...], units: Units, declared: Units | None
) -> None:
    """Rigid motion, mass and units, with nodes and dofs known."""
    nodes, dofs = case.nodes, case.dofs
    if nodes is None or dofs is None:
        return
    names = case.names
    residuals = residual(case.K, nodes, dofs)
    free = free_motions(residuals, is_mounted(residuals, nodes, dofs))
    case.facts |= {"rigid_residual": float(residuals.worst.max(initial=0.0)), "free_motions": free}
    case.facts["length"] = 2 * residuals.length
    factor = rotation_factor(case.K, residuals, dofs)
    if factor is not None:
        case.findings.append(rotation_finding(factor))
    else:
        case.findings += rigid_findings(case.K, residuals, nodes, dofs, names)
    _grounded_damping(case, residuals.R)
    massive, facts = mass_findings(case.M, nodes, dofs, names)
    case.findings += massive
    case.facts |= facts
    if mesh is not None and materials and "mass" in case.facts:
        try:
            case.findings += against_mesh(case.facts, mesh, materials)
        except InputError as error:
            case.findings.append(Finding(code="mesh", severity="error", sentence=str(error)))
    estimated = estimate(case.K, case.M, nodes, dofs)
    if estimated is not None:
        case.facts["speed_of_sound"], case.facts["density"] = estimated
    extent = np.ptp(nodes.xyz[np.unique(dofs.node)], axis=0)
    case.findings += unit_findings(estimated, materials, extent, units, declared, float(case.facts.get("mass", np.nan)))


def _grounded_damping(case: _Case, R: Floats) -> None:
    """A note where damping resists rigid motion."""
    if case.D is None:
        return
    force, size = case.D @ R, magnitudes(case.D, R).max(axis=1)
    held = np.flatnonzero(np.abs(force).max(axis=1) > FEM.strained_force * size)
    if len(held):
        labels, words = case.names.places(held)
        sentence = f"the damping matrix D resists rigid motion at {words}"
        cure = "leave out damping that is proportional to mass, or dampers to the ground, unless that is meant"
        code = "grounded-damping"
        case.findings.append(Finding(code=code, severity="note", sentence=sentence, cure=cure, where=labels))
