"""Reduced model -> elastic body, with what else was asked for: frame, stiffening, ranking of its terms, stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.body.body import Body
from morembs.body.floating.frame import FloatingFrame, floating_frame, why_not_floating
from morembs.body.floating.ranking import ranked_terms
from morembs.body.floating.spin import ReducedSpin
from morembs.body.floating.stiffening import Envelope
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.body.part import Part
from morembs.body.stress_shapes import stress_recovery
from morembs.fem.selection import select_nodes
from morembs.fem.stress_operator import StressOperator, stress_operator
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.responses.static_mode_tables import StaticModeTables

if TYPE_CHECKING:
    from morembs.body.parametric_parts import ParametricParts
    from morembs.certificate.record import Certificate
    from morembs.parametric.model import ParametricModel


@dataclass(frozen=True)
class _Basis:
    """Displacements of nodes for coordinates of a reduced model."""

    transformation: sp.csr_array
    V: Floats

    def __call__(self, columns: slice = slice(None)) -> Floats:
        """(3 n, k) for some coordinates; allocates only these."""
        return np.asarray(self.transformation @ self.V[:, columns])


def elastic_body(
    problem: Problem,
    reduced: ReducedModel,
    part: Part,
    certificate: Certificate | None = None,
    floating: FloatingFrame | None = None,
) -> Body:
    """Make a body from a reduced model and the data that all bodies of a part share.

    Args:
        problem: the full model.
        reduced: its reduced model.
        part: the shared data, from ``make_part``.
        certificate: limits of the error, from ``certify``; the body stores them.
        floating: the floating frame; by default a frame of mean axes.

    >>> elastic_body(problem, reduced, make_part(problem)).frequencies_hz.shape
    (18,)
    """
    if floating is None and not why_not_floating(problem, reduced):
        floating = floating_frame(problem, reduced)
    known = problem.known_frequencies_hz()
    return body_of(reduced, part, certificate=certificate, floating=floating, full_frequencies_hz=known)


def body_of(reduced: ReducedModel, part: Part, frequencies_hz: Floats | None = None, **more: Any) -> Body:
    """The body of a reduced model alone, with its frequencies where they are not known; ``more`` are further fields."""
    if frequencies_hz is None:
        values, Y = reduced.modes()
        omega = np.sqrt(np.maximum(values, 0.0))
        omega[: reduced.rigid_count] = 0.0
        frequencies_hz = in_hz(omega)
        if reduced.congruent:
            # Modes have unit modal mass; those without frequency have no ratio.
            damping = np.einsum("in,in->n", Y, reduced.D @ Y)
            more["damping_ratios"] = np.divide(damping, 2 * omega, out=np.zeros_like(omega), where=omega > 0)
    return Body(
        name=reduced.name,
        mass_matrix=reduced.M,
        stiffness_matrix=reduced.K,
        damping_matrix=reduced.D,
        input_matrix=reduced.B,
        output_matrix=reduced.C,
        frequencies_hz=frequencies_hz,
        mode_kind=reduced.mode_kind,
        rigid_count=reduced.rigid_count,
        recipe=reduced.recipe,
        part=part,
        model=reduced,
        **{"basis": _Basis(part.transformation, reduced.V), **more},
    )


@dataclass(frozen=True, kw_only=True)
class StressOptions:
    """``nodes``: "skin", "all" or a selection; ``single`` precision; mode-acceleration ``correction``; ``jump`` for how
    far single elements miss the average."""

    nodes: str = "skin"
    single: bool = True
    correction: bool = True
    jump: bool = True
    length: float = 1.0

    def operator(self, problem: Problem) -> StressOperator:
        """Stress at the chosen nodes; coordinates of a selection are in units of ``length`` m.

        Raises:
            InputError: a selection that cannot be read or has no nodes, or a model without elements.
        """
        model, whole = problem.model, self.nodes in ("skin", "all")
        nodes = self.nodes if whole else select_nodes(model, self.nodes, length=self.length)
        with problem.budget.in_use():
            return stress_operator(model, nodes, elements=self.jump)


@dataclass(frozen=True, kw_only=True)
class BodyOptions:
    """What every body shall carry.

    ``kind`` and ``interfaces`` of its floating frame, ``origin`` in m in the model (None: the centre of mass);
    ``envelope`` of the loads in use, for the ranking of terms; ``stiffening`` and ``stress`` where they are wanted,
    the former for the loads of its envelope.
    """

    kind: str = "mean-axes"
    interfaces: tuple[str, ...] = ()
    origin: Sequence[float] | None = (0.0, 0.0, 0.0)
    envelope: Envelope | None = None
    stiffening: Envelope | None = None
    stress: StressOptions | None = field(default=None)


def build_body(
    problem: Problem,
    reduced: ReducedModel,
    part: Part,
    options: BodyOptions,
    *,
    certificate: Certificate | None = None,
    operator: StressOperator | None = None,
    switching: StaticModeTables | None = None,
    variation: ParametricModel | None = None,
    spin: ReducedSpin | None = None,
) -> Body:
    """The body of ``reduced`` with all that the ``options`` want; ``operator`` is that of the wanted stress,
    ``switching`` what its reducer made of candidate loads, ``variation`` its reduced model of all values of parameters.
    A body with ``spin`` has no floating frame, in which a simulator would count what spin does again.

    Raises:
        InputError: a frame, stiffening or ranking is wanted of a body that has no floating frame.
    """
    reason = "a body with [spin] has no floating frame" if spin is not None else why_not_floating(problem, reduced)
    asked = options.kind != "mean-axes" or options.stiffening is not None or options.envelope is not None
    if reason and asked:
        raise InputError(f"[frame], [envelope] and [stiffening]: {reason}", keyword="frame")
    floating = None if reason else _frame(problem, reduced, options)
    later: dict[str, Any] = {"switching": switching}
    if variation is not None:
        later["parameters"] = _parametric(problem, reduced, part, variation)
    if options.stress is not None and operator is not None:
        later["recovery"] = stress_recovery(
            problem, reduced, single=options.stress.single, correction=options.stress.correction, operator=operator
        )
    return replace(
        elastic_body(problem, reduced, part, certificate=certificate, floating=floating),
        floating=floating,
        spin=spin,
        ranking=() if floating is None or options.envelope is None else ranked_terms(floating, options.envelope),
        **later,
    )


def _parametric(problem: Problem, reduced: ReducedModel, part: Part, variation: ParametricModel) -> ParametricParts:
    # Not at the top: most bodies have no parameters.
    from morembs.body.parametric_parts import parametric_parts

    return parametric_parts(problem, reduced, part.nodes.ids, variation)


def _frame(problem: Problem, reduced: ReducedModel, options: BodyOptions) -> FloatingFrame:
    origin = problem.mass_properties[1] if options.origin is None else options.origin
    frame = floating_frame(problem, reduced, kind=options.kind, interfaces=options.interfaces, origin=tuple(origin))
    if options.stiffening is None:
        return frame
    return replace(frame, stiffening=geometric_stiffening(problem, reduced, frame, options.stiffening))
