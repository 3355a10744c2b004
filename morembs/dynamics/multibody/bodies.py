"""Rigid bodies and elastic bodies in a floating frame, from the data that a user gives."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Positive
from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame
from morembs.body.floating.integrals import ShapeIntegrals
from morembs.body.floating.stiffening import Stiffening
from morembs.dynamics.multibody.component import Marker, checked_rotation, numbers, vector
from morembs.dynamics.multibody.floating_body import FloatingBody
from morembs.dynamics.multibody.inertia import Foreshortening, Inertia
from morembs.dynamics.multibody.tolerances import TOL


def _place_body(
    label: str,
    position: ArrayLike,
    turn: ArrayLike | None,
    velocity: ArrayLike,
    spin: ArrayLike,
    q: Floats,
    rate: Floats,
) -> tuple[Floats, Floats]:
    """Configuration and velocity at the start."""
    R = checked_rotation(f"{label}: rotation", turn)
    x = np.concatenate((vector(f"{label}: position", position), R.ravel(), q))
    v = np.concatenate((vector(f"{label}: velocity", velocity), vector(f"{label}: angular_velocity", spin), rate))
    return x, v


@checked
class RigidBody(FloatingBody):
    """A rigid body.

    Args:
        mass: kg, positive.
        inertia: (3, 3) kg m2 about the centre of mass along the axes of the body, or its three principal moments.
        center_of_mass: (3,) m from the origin of the body.
        position, rotation: origin (3,) m and axes (3, 3) of the body at the start.
        velocity, angular_velocity: of the origin along the inertial axes, of the body along its own axes, at the start.
        markers: names and points (3,) m along the axes of the body.

    Raises:
        InputError: a mass or inertia that is not positive, wrong shapes.
    """

    def __init__(
        self,
        mass: Positive,
        inertia: ArrayLike,
        *,
        center_of_mass: ArrayLike = (0.0, 0.0, 0.0),
        position: ArrayLike = (0.0, 0.0, 0.0),
        rotation: ArrayLike | None = None,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        markers: Mapping[str, ArrayLike] | None = None,
        name: str = "body",
    ) -> None:
        label = f"body {name!r}"
        mass = float(mass)
        square = np.diag(inertia) if np.ndim(inertia) == 1 else inertia
        J = numbers(f"{label}: inertia", square, (3, 3))
        if np.abs(J - J.T).max() > TOL.inertia_asymmetry * np.abs(J).max() or np.linalg.eigvalsh(J)[0] <= 0:
            raise InputError(
                f"{label}: the inertia given is not symmetric with three positive principal moments",
                kind="model",
                keyword="inertia",
            )
        c = vector(f"{label}: center_of_mass", center_of_mass)
        about_origin = J + mass * (c @ c * np.eye(3) - np.outer(c, c))
        none = np.zeros((0, 0))
        integrals = Inertia(
            mass=mass,
            first=mass * c,
            inertia=about_origin,
            Ct=np.zeros((0, 3)),
            Cr=np.zeros((0, 3)),
            Me=none,
            x_phi=np.zeros((3, 3, 0)),
            phi_phi=np.zeros((3, 3, 0, 0)),
        )
        x, v = _place_body(label, position, rotation, velocity, angular_velocity, np.zeros(0), np.zeros(0))
        super().__init__(name=name, inertia=integrals, Ke=none, De=none, configuration=x, velocity=v)
        for key, point in (markers or {}).items():
            self.marker_at(point, name=key)

    def marker_at(self, point: ArrayLike, *, axes: ArrayLike | None = None, name: str = "") -> Marker:
        """Marker at ``point`` (3,) m of the body, with ``axes`` (3, 3) as columns, by default those of the body.

        Raises:
            InputError: wrong shapes, or axes that are no rotation.
        """
        label = f"body {self.name!r}: marker {name!r}"
        where, turn = vector(f"{label}: point", point), checked_rotation(f"{label}: axes", axes)
        return self.add_marker(name, where, np.zeros((6, 0)), axes=turn)


def inertia_of(parts: ShapeIntegrals, terms: Stiffening | None = None) -> Inertia:
    """Inertia of the integrals of a frame, with stiffening where its terms are given."""
    return Inertia(
        mass=parts.mass,
        first=parts.first,
        inertia=parts.inertia,
        Ct=parts.Ct,
        Cr=parts.Cr,
        Me=parts.Me,
        x_phi=parts.x_phi,
        phi_phi=parts.phi_phi,
        foreshortening=None
        if terms is None
        else Foreshortening(linear=terms.acceleration, angular=terms.angular_acceleration, centrifugal=terms.rotation),
    )


@checked
class FlexibleBody(FloatingBody):
    """An elastic body in the floating frame, with all inertia terms of second order in q.

    Args:
        frame: integrals, Ke, De and markers of the body.
        position, rotation, velocity, angular_velocity: of the frame, as for a rigid body.
        elastic, elastic_rate: (n,) elastic coordinates and their rates at the start.
        stiffening: take the geometric stiffening of the frame. Its second-order displacements then act on inertia
            forces, gravity and interface displacements alike, so that energy is conserved.
        derivatives: those of the frame by parameters, by name (``Evaluation.frame_derivatives``), for sensitivities.

    Raises:
        InputError: a singular mass matrix, wrong shapes, stiffening that the frame does not have.
    """

    def __init__(
        self,
        frame: FloatingFrame,
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        rotation: ArrayLike | None = None,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        elastic: ArrayLike | None = None,
        elastic_rate: ArrayLike | None = None,
        stiffening: bool = False,
        derivatives: Mapping[str, FloatingFrame] | None = None,
        name: str = "body",
    ) -> None:
        n, label, terms = len(frame.Ke), f"body {name!r}", None
        if stiffening:
            terms = frame.stiffening
            if terms is None:
                raise InputError(
                    f"{label}: its frame has no stiffening; compute it first, or take stiffening=False",
                    kind="missing",
                    keyword="stiffening",
                )
            if derivatives:
                raise InputError(f"{label}: derivatives with stiffening=True were given; they are known without it")
        for key, slope in (derivatives or {}).items():
            if slope.count != n or set(slope.markers) != set(frame.markers):
                raise InputError(
                    f"{label}: the derivatives by {key!r} have {slope.count} elastic coordinates and the markers "
                    f"{', '.join(slope.markers)}; expected those of its frame, {n} and {', '.join(frame.markers)}"
                )
        self.derivatives = dict(derivatives or {})
        q = np.zeros(n) if elastic is None else vector(f"{label}: elastic", elastic, n)
        rate = np.zeros(n) if elastic_rate is None else vector(f"{label}: elastic_rate", elastic_rate, n)
        x, v = _place_body(label, position, rotation, velocity, angular_velocity, q, rate)
        inertia = inertia_of(frame.integrals, terms)
        super().__init__(name=name, inertia=inertia, Ke=frame.Ke, De=frame.De, configuration=x, velocity=v)
        self.frame = frame
        for key, marker in frame.markers.items():
            short = None if terms is None else terms.wrench.get(key)
            self.add_marker(key, marker.point, marker.motion, short)

    def marker_at(
        self, point: ArrayLike, motion: ArrayLike, *, axes: ArrayLike | None = None, name: str = ""
    ) -> Marker:
        """Marker at an arbitrary node.

        ``point`` (3,) m undeformed position from the origin of the frame; ``motion`` (6, n) displacement and small
        rotation per elastic coordinate, or (3, n) where no rotation is needed; ``axes`` (3, 3) as columns.

        Raises:
            InputError: wrong shapes, or axes that are no rotation.
        """
        label, n = f"body {self.name!r}: marker {name!r}", self.inertia.n
        where, turn = vector(f"{label}: point", point), checked_rotation(f"{label}: axes", axes)
        rows = np.asarray(motion, dtype=float)
        if rows.shape == (3, n):
            rows = np.vstack((rows, np.zeros((3, n))))
        return self.add_marker(name, where, numbers(f"{label}: motion", rows, (6, n)), axes=turn)
