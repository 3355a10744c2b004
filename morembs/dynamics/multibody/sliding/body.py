"""A body with static modes that are switched on and off as loads slide along it (Heirman, Tamarozzi, Desmet 2011).

The constant basis is another component: ``LinearBody`` for a body that is held or moves little, ``FlexibleBody`` in its
floating frame. Quasi-static variant: static modes have no state, their amplitudes are the loads on the candidates.
Dynamic variant: they keep their mass, in coordinates that diagonalise each active set. The places of the active sets
belong to the configuration, so markers, joints and forces stay as they are at a switch. In a floating frame the static
modes take part in no Coriolis or centrifugal force.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import PositiveCount, number, one_of
from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody.bodies import FlexibleBody
from morembs.dynamics.multibody.component import Component, FixedMarker, Marker, MarkerState
from morembs.dynamics.multibody.linear_body import LinearBody
from morembs.dynamics.multibody.sliding.path import PathState
from morembs.dynamics.multibody.tolerances import TOL
from morembs.fem import freeze
from morembs.responses.static_mode_tables import INTERPOLATIONS, ActiveSet, StaticModeTables, active_set

VARIANTS = ("quasi-static", "dynamic")


@dataclass(frozen=True, eq=False)
class Active:
    """The static modes of one choice of windows: their coordinates, and the candidates that each window reads.

    ``on_inner`` (., r) is the mass between velocities of the inner body, all along its own axes, and z; ``read`` the
    window's candidates, ``rows`` (6 + k, .) their rates by velocities of the body below those of its frame, which are
    zero here, ``R`` (k, k) of the window by itself.
    """

    set: ActiveSet | None
    on_inner: Floats
    read: tuple[Ints, ...]
    rows: tuple[Floats, ...]
    R: tuple[Floats, ...]


@checked
class SwitchingBody(Component):
    """``inner`` (the constant basis) with the static modes of ``switching``.

    ``at`` (one number for each load or slider that moves along the path): positions along the path at the start, m.
    Each has an active window: the nodes that its place depends on, ``look_ahead`` nodes ahead and as many behind.
    ``damping_ratio`` belongs to the coordinates of the dynamic ``variant``. Configuration: that of ``inner``, z, and
    the first node of each window.

    Raises:
        InputError: a start outside the path, data that do not belong to the body, a window without look-ahead.
    """

    def __init__(
        self,
        inner: LinearBody | FlexibleBody,
        switching: StaticModeTables,
        *,
        at: Sequence[float] | float = (0.0,),
        variant: Annotated[str, one_of(*VARIANTS)] = "quasi-static",
        look_ahead: PositiveCount = 1,
        damping_ratio: Annotated[
            float, number("a number from 0, such as 0.1", ge=0, lt=10)
        ] = TOL.default_damping_ratio,
        interpolation: Annotated[str, one_of(*INTERPOLATIONS)] = "catmull-rom",
    ) -> None:
        label = f"body {inner.name!r}"
        self.name, self.inner, self.switching = inner.name, inner, switching
        self.variant, self.look_ahead, self.interpolation = variant, look_ahead, interpolation
        self.damping_ratio = damping_ratio
        floating = isinstance(inner, FlexibleBody)
        # Elastic coordinates among the velocities and the configuration of the inner body.
        self.in_v, self.in_x = (
            (slice(6, inner.size), slice(12, inner.configuration_size))
            if floating
            else (slice(0, inner.size), slice(0, inner.size))
        )
        self.map = inner.frame.elastic if isinstance(inner, FlexibleBody) else np.eye(inner.size)
        # Reduced coordinates by velocities of the inner body: static modes next to constraint modes push its frame too.
        self.all_inner = np.hstack((inner.frame.rigid, self.map)) if isinstance(inner, FlexibleBody) else self.map
        self.origin = inner.frame.origin if isinstance(inner, FlexibleBody) else np.zeros(3)
        if len(self.map) != switching.modes.shape[1]:
            raise InputError(
                f"{label} has {len(self.map)} reduced coordinates, but its static modes were made beside "
                f"{switching.modes.shape[1]}; take both from one reduction"
            )
        self._refuse_far(label)
        nodes = len(switching.node_ids)
        self.width = min(TOL.path_support + 2 * look_ahead, nodes)
        places = np.atleast_1d(np.asarray(at, dtype=float))
        self.windows = len(places)
        for s in places:
            self.refuse_outside(float(s), "at the start")
        per_window = max(
            int(switching.starts[f + self.width] - switching.starts[f]) for f in range(nodes - self.width + 1)
        )
        self.extra = min(per_window * self.windows, switching.count) if variant == "dynamic" else 0
        self.size = inner.size + self.extra
        self.configuration_size = inner.configuration_size + self.extra + self.windows
        self._active: OrderedDict[tuple[int, ...], Active] = OrderedDict()
        self._first = np.array([self.window_about(float(s)) for s in places], dtype=float)

    def _refuse_far(self, label: str) -> None:
        """Refuse a floating frame so far from its body that restarts at switches lose their digits."""
        if not isinstance(self.inner, FlexibleBody):
            return
        integrals = self.inner.frame.integrals
        center = integrals.first / integrals.mass
        about_center = np.trace(integrals.inertia) / (2 * integrals.mass) - center @ center
        if center @ center > TOL.farthest_frame**2 * about_center:
            raise InputError(
                f"{label}: the origin of its frame is {np.linalg.norm(center):.4g} m from its centre of mass, more "
                f"than {TOL.farthest_frame:g} radii of gyration, and every switch would lose digits; take [frame] "
                'origin = "center-of-mass"',
                keyword="frame",
            )

    def refuse_outside(self, s: float, when: str) -> None:
        """Raise InputError where ``s`` is not on the path."""
        length = self.switching.length
        if not -TOL.path_end * length <= s <= length * (1 + TOL.path_end):
            raise InputError(
                f"body {self.name!r}: the load is outside all candidates {when}: s = {s:.9g} m on a path of "
                f"{length:.9g} m; end the run earlier, add candidates there, or remove the load",
                keyword="s",
            )

    def window_about(self, s: float) -> int:
        """First node of the window about ``s`` (m)."""
        centred = self.switching.interval(s) - 1 - self.look_ahead
        return int(np.clip(centred, 0, len(self.switching.node_ids) - self.width))

    def firsts(self, x: Floats) -> tuple[int, ...]:
        """First node of each window in a configuration."""
        return tuple(int(k) for k in x[self.configuration_size - self.windows :])

    def split(self, x: Floats) -> tuple[Floats, Floats]:
        """Configuration of the inner body, and z."""
        k = self.inner.configuration_size
        return x[:k], x[k : k + self.extra]

    def active(self, x: Floats) -> Active:
        """The active set of a configuration."""
        return self.active_of(self.firsts(x))

    def active_of(self, firsts: tuple[int, ...]) -> Active:
        """The active set of windows that begin at these nodes."""
        active = self._active.get(firsts)
        if active is None:
            active = self._active[firsts] = self._make(firsts)
            if len(self._active) > TOL.kept_active_sets:
                self._active.popitem(last=False)
        return active

    def _make(self, firsts: tuple[int, ...]) -> Active:
        tables = self.switching
        read = tuple(tables.of_nodes(first, self.width) for first in firsts)
        # Beyond this many elastic coordinates nothing here grows: neither with all candidates nor with the model.
        rows = tuple(np.zeros((6 + len(window), self.size)) for window in read)
        for table, window in zip(rows, read, strict=True):
            table[6:, self.in_v] = tables.modes[window] @ self.map
        R = tuple(tables.R(window) for window in read)
        if self.variant != "dynamic":
            return Active(None, np.zeros((self.inner.size, 0)), read, tuple(map(freeze, rows)), R)
        together = np.unique(np.concatenate(read))
        chosen = active_set(tables, together)
        pad = self.extra - chosen.rank
        Y = np.hstack([chosen.Y, np.zeros((len(together), pad))])
        chosen = ActiveSet(together, Y, np.concatenate([chosen.omega, np.full(pad, chosen.omega[0])]))
        for table, window in zip(rows, read, strict=True):
            table[6:, self.inner.size :] = tables.R(window, together) @ Y
        on_inner = self.all_inner.T @ (tables.coupling[:, together] @ Y)
        return Active(chosen, on_inner, read, tuple(map(freeze, rows)), R)

    def on_inner(self, active: Active, inner: Floats) -> Floats:
        """(., r) mass between velocities of the inner body and z."""
        if not isinstance(self.inner, FlexibleBody):
            return active.on_inner
        # Velocities of the frame are along the inertial axes.
        return np.vstack((self._axes(inner) @ active.on_inner[:3], active.on_inner[3:]))

    def start(self) -> tuple[Floats, Floats]:
        x, v = self.inner.start()
        none = np.zeros(self.extra)
        return np.concatenate((x, none, self._first)), np.concatenate((v, none))

    def move(self, x: Floats, step: Floats) -> Floats:
        inner, z = self.split(x)
        moved = self.inner.move(inner, step[: self.inner.size])
        return np.concatenate((moved, z + step[self.inner.size :], x[self.configuration_size - self.windows :]))

    def tangent(self, step: Floats) -> Floats | None:
        inner = self.inner.tangent(step[: self.inner.size])
        if inner is None:
            return None
        T = np.eye(self.size)
        T[: self.inner.size, : self.inner.size] = inner
        return T

    def bracket(self, a: Floats, b: Floats) -> Floats:
        value = np.zeros(self.size)
        value[: self.inner.size] = self.inner.bracket(a[: self.inner.size], b[: self.inner.size])
        return value

    def dynamics(self, t: float, x: Floats, v: Floats, gravity: Floats) -> tuple[Floats, Floats]:
        inner, z = self.split(x)
        k = self.inner.size
        M_inner, g_inner = self.inner.dynamics(t, inner, v[:k], gravity)
        if not self.extra:
            return M_inner, g_inner
        active = self.active(x)
        M, g = np.zeros((self.size, self.size)), np.empty(self.size)
        M[:k, :k] = M_inner
        M[:k, k:] = self.on_inner(active, inner)
        M[k:, :k] = M[:k, k:].T
        M[k:, k:] = np.eye(self.extra)
        g[:k] = g_inner
        modes = active.set
        if modes is not None:
            g[k:] = modes.omega * (modes.omega * z + 2 * self.damping_ratio * v[k:])
            if gravity.any():
                g[k:] -= (self._axes(inner).T @ gravity) @ (self.switching.static_weight[modes.candidates].T @ modes.Y)
        return M, g

    def _axes(self, inner: Floats) -> Floats:
        return inner[3:12].reshape(3, 3) if isinstance(self.inner, FlexibleBody) else np.eye(3)

    def energy(self, x: Floats, v: Floats, gravity: Floats) -> tuple[float, float]:
        inner, z = self.split(x)
        k = self.inner.size
        T, U = self.inner.energy(inner, v[:k], gravity)
        active = self.active(x)
        if active.set is None:
            return T, U
        weight = self._axes(inner).T @ gravity @ self.switching.static_weight[active.set.candidates].T @ active.set.Y
        T += float(0.5 * v[k:] @ v[k:] + v[:k] @ self.on_inner(active, inner) @ v[k:])
        return T, U + float(0.5 * (active.set.omega * z) @ (active.set.omega * z) - weight @ z)

    def power(self, x: Floats, v: Floats) -> float:
        inner, _ = self.split(x)
        k = self.inner.size
        modes = self.active(x).set
        lost = 0.0 if modes is None else 2 * self.damping_ratio * float(modes.omega @ v[k:] ** 2)
        return self.inner.power(inner, v[:k]) - lost

    def deflection(self, x: Floats) -> float | None:
        """That of the constant basis."""
        return self.inner.deflection(self.split(x)[0])

    def path(self, window: int = 0) -> PathMarker:
        """The path as the slider of that number sees it, for a load, a support or a joint that moves along it.

        Raises:
            InputError: more sliders than the body was made for.
        """
        if not 0 <= window < self.windows:
            raise InputError(
                f"body {self.name!r}: slider {window} was asked for, but it was made for {self.windows}; give at = "
                "one position for each"
            )
        return PathMarker(self, f"path {window}", window)

    def marker(self, name: str) -> Marker:
        word, _, number = name.partition(" ")
        if word == "path" and number.isdigit():
            return self.path(int(number))
        inner = self.inner.marker(name)
        return inner if isinstance(inner, FixedMarker) else InnerMarker(self, name, inner)


@dataclass(frozen=True, eq=False)
class InnerMarker(Marker):
    """A marker of the constant basis; static modes do not move it."""

    component: SwitchingBody
    name: str
    inner: Marker

    def place(self, x: Floats) -> MarkerState:
        place = self.inner.place(self.component.split(x)[0])
        extra = np.zeros((len(place.jacobian), self.component.extra))
        return MarkerState(position=place.position, axes=place.axes, jacobian=np.hstack((place.jacobian, extra)))


@dataclass(frozen=True, eq=False)
class PathMarker(Marker):
    """A window of the path of a body."""

    component: SwitchingBody
    name: str
    window: int

    def place(self, x: Floats) -> PathState:
        body = self.component
        inner, z = body.split(x)
        active, k = body.active(x), body.inner.size
        read, jacobian = active.read[self.window], active.rows[self.window]
        amplitudes = jacobian[6:, body.in_v] @ inner[body.in_x] + jacobian[6:, k:] @ z
        position, axes = np.zeros(3), np.eye(3)
        if isinstance(body.inner, FlexibleBody):
            position, axes, jacobian = inner[:3], inner[3:12].reshape(3, 3), jacobian.copy()
            jacobian[:3, :3] = np.eye(3)
            jacobian[3:6, 3:6] = axes
        return PathState(
            position=position,
            axes=axes,
            jacobian=jacobian,
            switching=body.switching,
            candidates=read,
            amplitudes=amplitudes,
            R=active.R[self.window],
            offset=body.origin,
            first=body.firsts(x)[self.window],
            width=body.width,
            interpolation=body.interpolation,
        )
