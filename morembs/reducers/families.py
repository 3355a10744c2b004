"""What methods have in common that take modes, or that follow responses: options, refusals and cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from morembs.base.errors import InputError
from morembs.base.limits import Count, PositiveHertz
from morembs.reducers.base import Reducer
from morembs.reducers.cost import mode_seconds, response_seconds
from morembs.reducers.problem_summary import ProblemSummary, ShiftedFactorisations
from morembs.responses.direct import why_no_response


@dataclass(frozen=True, kw_only=True)
class OfModes(Reducer):
    """Methods of a number of modes, or of all up to a frequency.

    Args:
        modes: number of modes; this or ``up_to_hz``.
        up_to_hz: all modes up to this frequency.
    """

    modes: Count | None = None
    up_to_hz: PositiveHertz | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.modes is None) == (self.up_to_hz is None):
            raise InputError(
                f'method "{self.method}" needs either modes = COUNT or up_to_hz = LIMIT (one of the two)',
                kind="missing",
                keyword="modes",
            )

    @property
    def below(self) -> float | None:
        """``up_to_hz`` in (rad/s)2."""
        return square_frequency(self.up_to_hz)

    @property
    def mode_count(self) -> int:
        return self.modes or 0

    @property
    def computes_modes(self) -> bool:
        return True

    def why_not(self, facts: ProblemSummary) -> str:
        if self.mode_count > facts.size:
            return (
                f"modes = {self.modes} was given, but the coupled model has only {facts.size} degrees of freedom; ask "
                "for fewer modes"
            )
        return super().why_not(facts)

    def seconds(self, facts: ProblemSummary, factor_entries: int = 0) -> float | None:
        return None if self.modes is None else mode_seconds(facts.size, self.modes, factor_entries)


@dataclass(frozen=True, kw_only=True)
class OfResponses(Reducer):
    """Methods that follow the responses to all interface degrees of freedom in a reference model.

    ``of_reference`` is how often they do the work on that model.
    """

    of_reference: ClassVar[float] = 3.0

    @property
    def follows_responses(self) -> bool:
        return True

    def why_not(self, facts: ProblemSummary) -> str:
        reason = self.why_no_response(facts)
        return super().why_not(facts) or (f'method "{self.method}": {reason}' if reason else "")

    def why_no_response(self, facts: ProblemSummary) -> str:
        """Why the full model has no response to follow."""
        return why_no_response(facts.damping, facts.own_damping, facts.size)

    def plan_factorisations(self, facts: ProblemSummary) -> Sequence[ShiftedFactorisations]:
        return facts.at_frequencies(0)

    def seconds(self, facts: ProblemSummary, factor_entries: int = 0) -> float | None:
        return response_seconds(facts.size, facts.inputs, factor_entries, self.of_reference)


def square_frequency(hz: float | None) -> float | None:
    """(rad/s)2 of a frequency in Hz."""
    return None if hz is None else (2 * np.pi * hz) ** 2
