"""What a body carries beyond its reduced matrices: frame, stiffening, ranking of its terms, stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from morembs.base.errors import InputError
from morembs.base.former_names import with_progress_argument
from morembs.body.body import ElasticBody, Part, elastic_body
from morembs.body.floating.frame import FloatingFrame, floating_frame, why_not_floating
from morembs.body.floating.ranking import ranked_terms
from morembs.body.floating.spin import ReducedSpin
from morembs.body.floating.stiffening import Envelope
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.body.stress_shapes import stress_recovery
from morembs.fem.selection import select_nodes
from morembs.fem.stress_operator import StressOperator, stress_operator
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.reducers.switching_tables import StaticModeTables

if TYPE_CHECKING:
    from morembs.body.parametric_parts import ParametricParts
    from morembs.certificate.certify import Certificate
    from morembs.parametric.model import ParametricModel


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
        return stress_operator(model, nodes, elements=self.jump, budget=problem.budget)


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


@with_progress_argument
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
) -> ElasticBody:
    """The body of ``reduced`` with all that the ``options`` want; ``operator`` is that of the wanted stress,
    ``switching`` what its reducer made of candidate loads, ``variation`` its reduced model of all values of parameters.
    A body with ``spin`` has no floating frame, in which a simulator would count what spin does again.

    Raises:
        InputError: a frame, stiffening or ranking is wanted of a body that has no floating frame.
    """
    reason = "a body with [spin] has no floating frame" if spin is not None else why_not_floating(problem, reduced)
    asked = options.kind != "mean-axes" or options.stiffening is not None or options.envelope is not None
    if reason and asked:
        raise InputError(f"[frame], [envelope] and [stiffening]: {reason}")
    floating = None if reason else _frame(problem, reduced, options)
    return replace(
        elastic_body(problem, reduced, part, certificate=certificate, floating=floating),
        floating=floating,
        switching=switching,
        spin=spin,
        parametric=None if variation is None else _parametric(problem, reduced, part, variation),
        ranking=() if floating is None or options.envelope is None else ranked_terms(floating, options.envelope),
        recovery=None
        if options.stress is None or operator is None
        else stress_recovery(
            problem, reduced, single=options.stress.single, correction=options.stress.correction, operator=operator
        ),
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
