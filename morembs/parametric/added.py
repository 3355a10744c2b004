"""Stiffness that parameters add to that of elements: springs at interfaces, and the stress of a preload."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError, nearest
from morembs.fem import FEModel, skew
from morembs.fem.interface import Elimination, Interface
from morembs.linalg.statics import support_dofs
from morembs.parametric.parameter import Parameter
from morembs.parametric.tolerances import TOL
from morembs.parametric.varied import VariedModel


def with_springs(varied: VariedModel, interfaces: Sequence[Interface]) -> VariedModel:
    """``varied`` with the springs of its parameters at the ``interfaces``.

    Raises:
        InputError: an unknown interface, one without a frame, an average one of very many nodes, or a morph that moves
            the ends of a spring apart.
    """
    springs = [(k, each) for k, each in enumerate(varied.parameters) if each.spring is not None]
    if varied.added or not springs:
        return varied
    model = varied.outline(varied.box.nominal)
    framed = {each.name: each for each in interfaces if each.kind.framed}
    added = []
    for number, parameter in springs:
        spring = parameter.spring
        if spring is None:
            continue
        ends = [spring.interface] if spring.to is None else [spring.interface, spring.to]
        for name in ends:
            if name not in framed:
                raise InputError(
                    f"parameter {parameter.name} names the interface {name!r}; {nearest(name, framed)} "
                    "(only rigid and average interfaces have a frame)",
                    kind="unknown",
                )
        chosen = [framed[name] for name in ends]
        _refuse_apart(varied, parameter, chosen)
        motion = frame_motion(model, chosen[0])
        if spring.to is not None:
            # The frame of the other end, carried along by this one: rigid motion of both strains no spring.
            carried = np.eye(6)
            carried[:3, 3:] = -skew(chosen[1].point - chosen[0].point)
            motion = frame_motion(model, chosen[1]) - sp.csr_array(carried) @ motion
        stiffness = sp.diags_array(np.array(spring.stiffness, dtype=float))
        added.append((number, sp.csr_array(motion.T @ stiffness @ motion)))
    return replace(varied, added=tuple(added))


def frame_motion(model: FEModel, interface: Interface) -> sp.csr_array:
    """(6, N): displacement and rotation of the frame of ``interface`` from the dofs of ``model``; of a rigid one from
    six dofs that determine it.

    Raises:
        InputError: a mean of very many nodes.
    """
    if not interface.kind.carries and len(interface.nodes) > TOL.max_patch_nodes:
        raise InputError(
            f"a spring at the interface {interface.name}, which takes the mean of {len(interface.nodes)} nodes, joins "
            f"all of them; expected {TOL.max_patch_nodes} at most, or coupling = 'rigid'"
        )
    attached = replace(interface, components=(0, 1, 2, 3, 4, 5)).kind.attach(model, interface)
    if not isinstance(attached, Elimination):
        return sp.csr_array(attached.T)
    size = np.abs(attached.motion).max(axis=0)
    chosen = support_dofs(attached.motion / np.where(size > 0, size, 1.0))
    block = np.linalg.inv(attached.motion[chosen])
    at = np.repeat(np.arange(6), 6), np.tile(attached.dofs[chosen], 6)
    return sp.csr_array(sp.coo_array((block.ravel(), at), shape=(6, model.size)))


def _refuse_apart(varied: VariedModel, parameter: Parameter, ends: Sequence[Interface]) -> None:
    size = float(np.ptp(varied.morph.mesh.nodes.xyz, axis=0).max())
    for number, d in zip(varied.morph.which, varied.morph.displacements, strict=True):
        morph = varied.parameters[number]
        moves = np.array([d[each.nodes[0]] for each in ends]) * max(abs(morph.low), abs(morph.high))
        if np.abs(moves - moves[0]).max() > TOL.same_place * size:
            raise InputError(
                f"parameter {morph.name} moves {ends[0].name} and {ends[1].name}, the ends of the spring "
                f"{parameter.name}, apart; a spring may join interfaces that move together, or one to the ground",
                kind="conflict",
                keyword="morph",
            )


def with_preload(varied: VariedModel, geometric: sp.csr_array, critical: float | None) -> VariedModel:
    """``varied`` with the stiffness ``geometric`` (N, N) of a preload as the term of its parameter.

    ``critical`` times the load makes the body buckle, None where that is far away.

    Raises:
        InputError: other parameters that change the stress, or loads beyond buckling.
    """
    (number,) = (k for k, each in enumerate(varied.parameters) if each.kind == "preload")
    own = varied.parameters[number]
    if critical is not None and own.high >= critical:
        raise InputError(
            f"parameter {own.name}: the body buckles at {critical:.4g} times the load of [preload], and the range goes "
            f"up to {own.high:.4g}; lower its upper end",
            kind="model",
            keyword="preload",
        )
    for k, parameter in enumerate(varied.parameters):
        elements = (varied.young if parameter.kind == "young" else varied.density) == k
        if parameter.kind in ("morph", "spring") or (parameter.kind in ("young", "density") and not elements.all()):
            raise InputError(
                f"parameter {parameter.name} ({parameter.kind}) changes the stress of the preload in another way than "
                'by a factor; beside a preload young and density of the set "all" can vary, and the damping',
                kind="unsupported",
                keyword="preload",
            )
    return replace(varied, added=(*varied.added, (number, geometric)))
