"""The examination of a model before it is used: refuses what no reduction takes, warns of what looks wrong."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from morembs.base.units import Units
from morembs.body.diagnostics.doctor import examine
from morembs.body.diagnostics.elements import double_elements, open_seams
from morembs.body.diagnostics.findings import Diagnosis, Finding, Names, sentences
from morembs.body.diagnostics.tolerances import TOL
from morembs.body.diagnostics.units import estimate, unit_findings
from morembs.fem import DofMap, FEModel
from morembs.fem.fe_model import refuse_complex, refuse_unsymmetric
from morembs.fem.rigid_residual import motion, residual
from morembs.linalg.congruence import congruence

# Findings that blame coordinates, axes or the map of dofs.
_OF_GEOMETRY = ("node-mapping", "not-this-geometry", "local-axes")
# Errors of other models look the same as these: interfaces may join parts, and springs along the axes or displacements
# that were taken out hold a body as other coordinates would. The factorisation of the coupled model decides.
_SUSPECTED = ("parts", "node-mapping")


def diagnosis_of(model: FEModel, *, deep: bool = False, declared: Units | None = None) -> Diagnosis:
    """What is wrong with a model (SI, of an input in the units ``declared``); rigid elements are eliminated before.

    What its import warned of stands among the findings.

    Peak memory: that of ``examine``, and copies of K, M and D where there are rigid elements.
    """
    K, M, D, dofs = model.K, model.M, model.D, model.dofs
    if model.dependent is not None:
        free = np.flatnonzero(model.dependent.owner < 0)
        T = sp.csr_array(model.dependent.S[:, free])
        K, M = (congruence(T, A) for A in (K, M))
        D = None if D is None else congruence(T, D)
        dofs = DofMap(node=dofs.node[free], component=dofs.component[free])
    if not np.ptp(model.nodes.xyz, axis=0).any():
        # All in one point: matrices without a place in space.
        diagnosis = examine(K, M, D, deep=deep)
    else:
        diagnosis = examine(K, M, D, model.nodes, dofs, model.mesh, model.materials, deep=deep, declared=declared)
    of_import = tuple(Finding(code="import", severity="warning", sentence=sentence) for sentence in model.warnings)
    findings = diagnosis.findings
    if any(finding.code in _OF_GEOMETRY for finding in findings):
        straining = straining_equations(model)
        if straining is not None:
            findings = (*(finding for finding in findings if finding.code not in _OF_GEOMETRY), straining)
    return Diagnosis(findings=(*of_import, *findings), facts=diagnosis.facts)


def straining_equations(model: FEModel) -> Finding | None:
    """Equations that rigid motion does not satisfy, where K fits the coordinates without them; None without such.

    They tie nodes that lie apart, mostly on purpose, and the body cannot turn without strain.
    """
    if model.dependent is None:
        return None
    R, _, _ = motion(model.nodes, model.dofs)
    free = model.dependent.owner < 0
    is_strained = np.abs(model.dependent.S @ np.where(free[:, None], R, 0.0) - R) > TOL.wrong_place
    rows = np.flatnonzero(~free & is_strained.any(axis=1))
    if not len(rows) or residual(sp.csr_array(model.K), model.nodes, model.dofs).bad.any():
        return None
    labels, words = Names(nodes=model.nodes, dofs=model.dofs).places(rows)
    names = ", ".join(dict.fromkeys(model.dependent.names[i] for i in model.dependent.owner[rows].tolist()))
    resisted = "rigid motion" if is_strained[rows, :3].any() else "rotation of the whole body"
    sentence = f"equations resist {resisted} ({names}): they tie {words} to nodes that lie apart"
    cure = "leave them as they are if that is meant; else check their nodes, coefficients and axes"
    return Finding(code="equations-strain", severity="warning", sentence=sentence, cure=cure, where=labels)


def list_warnings(model: FEModel, *, declared: Units | None = None) -> tuple[str, ...]:
    """Warnings of the cheap examination of a model (SI), one sentence each; none where nothing looks wrong.

    Units are among them: numbers that no solid has, and the system that they look like. ``declared`` are the units
    that the input was read as, for that sentence.

    Args:
        model: in SI.
        declared: units of the input.

    Raises:
        InputError: matrices that no reduction takes, or errors of the examination, all in one message.

    >>> list_warnings(model)
    ()
    """
    refuse_complex(model)
    diagnosis = diagnosis_of(model, declared=declared)
    Diagnosis(findings=tuple(finding for finding in diagnosis.errors if finding.code not in _SUSPECTED)).refuse_errors()
    refuse_unsymmetric(model)
    mapped = tuple(finding for finding in diagnosis.errors if finding.code == "node-mapping")
    return sentences((*mapped, *diagnosis.warnings))


def examined_mesh(model: FEModel, declared: Units | None = None) -> tuple[str, ...]:
    """Warnings about a mesh and its materials (SI, of an input in the units ``declared``); K and M are not looked at.

    What its reader warned of is among them, and a body of more than a hundred metres: coordinates in mm beside a
    material in SI units; and elements that are there twice, and nodes that were not merged.
    """
    findings = unit_findings(None, model.materials, np.ptp(model.nodes.xyz, axis=0), Units(), declared)
    if model.mesh is not None:
        findings += [*double_elements(model.mesh), *open_seams(model.mesh)]
    units = sentences(tuple(finding for finding in findings if finding.severity == "warning" or finding.code == "size"))
    return (*model.warnings, *units)


def imported_warnings(model: FEModel, declared: Units) -> tuple[str, ...]:
    """Warnings about an imported model (SI, of an input in the units ``declared``) that cost next to nothing.

    About its units, elements that are there twice and nodes that were not merged; ``diagnosis_of`` finds other faults.
    """
    if model.mesh is not None and model.materials:
        return examined_mesh(model, declared)
    if not np.ptp(model.nodes.xyz, axis=0).any() or np.iscomplexobj(model.K.data) or np.iscomplexobj(model.M.data):
        return model.warnings
    estimated = estimate(model.K, model.M, model.nodes, model.dofs)
    findings = unit_findings(estimated, (), np.ptp(model.nodes.xyz, axis=0), Units(), declared)
    return (*model.warnings, *sentences([finding for finding in findings if finding.severity == "warning"]))
