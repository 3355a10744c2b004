"""Histories of a run with contact: gaps, forces, impacts, energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError, SolverError
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.dynamics.multibody.contact.kinematics import Contact, Contacts, ContactState
from morembs.dynamics.multibody.result import Energy, Result


@dataclass(frozen=True, kw_only=True, eq=False)
class Impact:
    """An impact: ``time`` s, the points that met as (contact, number of the point), of all m points of the system the
    ``approach`` (m,) m/s before, the ``impulse`` (m,) and ``friction`` (m, 2) Ns, and the ``loss`` of energy, J: minus
    the work of the impulses along the mean of the velocities before and after, and the work of prescribed motions
    ``driving`` J meanwhile. ``segment`` starts with it."""

    time: float
    points: tuple[tuple[str, int], ...]
    approach: Floats
    impulse: Floats
    friction: Floats
    loss: float
    driving: float
    segment: int


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactSegment:
    """Histories between two restarts: gap (s, m), force (s, m), friction (s, m, 2), slip (s, m, 2), foot (s, m, 3),
    normal (s, m, 3), sliding (s, m) bool and the energy stored in compliance (s,) J."""

    gap: Floats
    force: Floats
    friction: Floats
    slip: Floats
    foot: Floats
    normal: Floats
    sliding: NDArray[np.bool_]
    stored: Floats

    @classmethod
    def of(cls, states: Sequence[ContactState]) -> ContactSegment:
        """The segment of some states."""
        return cls(
            gap=np.array([s.gap for s in states]),
            force=np.array([s.force for s in states]),
            friction=np.array([s.friction for s in states]),
            slip=np.array([s.slip for s in states]),
            foot=np.array([s.kinematics.foot for s in states]),
            normal=np.array([s.kinematics.normal for s in states]),
            sliding=np.array([s.sliding for s in states]),
            stored=np.array([0.5 * s.force @ s.deflection for s in states]),
        )


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class ContactResult(Result):
    """A run with contact; times of impacts and other restarts occur twice, before and after.

    ``group`` are its contacts, ``touches`` their states in each segment, ``impacts`` all impacts in their order. A
    question about a contact that was not in the run is an InputError.
    """

    group: Contacts
    touches: tuple[ContactSegment, ...]
    impacts: tuple[Impact, ...]

    def _rows(self, contact: Contact) -> slice:
        for other, rows in zip(self.group.contacts, self.group.rows, strict=True):
            if other is contact:
                return rows
        raise InputError(f"contact {contact.name!r} is not one of this run; give the contacts that were simulated")

    def gap(self, contact: Contact) -> Floats:
        """(s, m) m: gaps of the points of a contact, zero where they touch."""
        return np.concatenate([s.gap[:, self._rows(contact)] for s in self.touches])

    def force(self, contact: Contact) -> Floats:
        """(s, m) N: normal forces, positive."""
        return np.concatenate([s.force[:, self._rows(contact)] for s in self.touches])

    def friction(self, contact: Contact) -> Floats:
        """(s, m, 2) N on the points, along the tangents: the part of ``axis`` in the tangent plane, and across."""
        return np.concatenate([s.friction[:, self._rows(contact)] for s in self.touches])

    def slip(self, contact: Contact) -> Floats:
        """(s, m, 2) m/s of the points over the surface."""
        return np.concatenate([s.slip[:, self._rows(contact)] for s in self.touches])

    def foot(self, contact: Contact) -> Floats:
        """(s, m, 3) m: the nearest points of the surface."""
        return np.concatenate([s.foot[:, self._rows(contact)] for s in self.touches])

    @cached_property
    def complementarity(self) -> float:
        """Largest ``|min(gap, force)|`` over time and points, in m or N: zero where the law of contact is met."""
        worst = [float(np.abs(np.minimum(s.gap, s.force)).max(initial=0.0)) for s in self.touches]
        return max(worst, default=0.0)

    def balance(self) -> Energy:
        """Energies with contact: compliance is in ``potential``; friction and impacts take from ``work``.

        ``total - work`` is constant up to integration error.
        """
        plain = self.energy()
        stored = np.concatenate([s.stored for s in self.touches])
        extra, done = [], 0.0
        for number, (segment, touch) in enumerate(zip(self.segments, self.touches, strict=True)):
            power = np.einsum("sia,sia->s", touch.friction, touch.slip)
            steps = 0.5 * (power[1:] + power[:-1]) * np.diff(segment.time)
            done += sum(i.driving - i.loss for i in self.impacts if i.segment == number)
            extra.append(done + np.concatenate(([0.0], np.cumsum(steps))))
            done = float(extra[-1][-1])
        work = plain.work + np.concatenate(extra)
        return Energy(kinetic=plain.kinetic, potential=plain.potential + stored, work=work)


class ContactError(SolverError):
    """A run with contact that ended early; ``result`` is the run so far, None where it did not begin."""

    def __init__(self, message: str, *, result: ContactResult | None) -> None:
        super().__init__(message)
        self.result = result
