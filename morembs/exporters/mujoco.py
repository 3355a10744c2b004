"""MuJoCo: an MJCF model whose modal coordinates are slides tied to the interfaces by tendons.

MuJoCo has no modes. In mean axes rigid and elastic motion exchange no momentum to first order, so that each normal mode
can be a slide of its own with the mass 1 and the stiffness of the mode, and the frame a rigid body. Interfaces are
bodies on it that move by six joints; a fixed tendon holds each of these at its sum of modes, and by the same row forces
at the interface reach the modes. The interfaces take a part of the mass of the body, which is taken off elsewhere:
rigid and elastic inertia of the whole stay as they were. Coriolis and centrifugal forces on the modes are left out.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar
from xml.sax.saxutils import quoteattr

import numpy as np

from morembs.base.errors import InputError
from morembs.base.limits import Part, Positive, RelativeError
from morembs.base.optional import optional
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.body.floating.frame import FloatingFrame
from morembs.exporters.base import ExportContext, Exported, Exporter
from morembs.exporters.mujoco_slides import (
    Massless,
    refuse_too_light,
    step_notes,
    taken_inertia,
    tendon_share,
    too_fast,
    with_slides,
    without_massless,
)
from morembs.exporters.real_time import RealTime, price_note
from morembs.exporters.sid import normal_coordinates
from morembs.exporters.simscape import quaternion
from morembs.exporters.tolerances import TOL
from morembs.fem import skew
from morembs.storage.safefile import replacing

AXES = ("x", "y", "z", "rx", "ry", "rz")
DIRECTIONS = ("1 0 0", "0 1 0", "0 0 1")


@dataclass(frozen=True, kw_only=True)
class MuJoCo(Exporter):
    """``highest_hz`` leaves out faster modes, which need short steps, as far as the static compliance of the interfaces
    stays within ``tolerance``; ``share`` is the part of the mass that each interface takes. A ``time_step`` in s leaves
    out modes that it does not resolve; slides at the limit of the step have their compliance.
    """

    name: ClassVar[str] = "mujoco"
    suffix: ClassVar[str] = ".mujoco.xml"
    about: ClassVar[str] = "MuJoCo (MJCF): rigid body and modal coordinates, tied to interfaces by tendons"
    holds: ClassVar[frozenset[str]] = frozenset({"damping"})

    highest_hz: float | None = None
    tolerance: RelativeError = 0.05
    share: Part = 0.01
    time_step: Positive | None = None

    def _write(self, context: ExportContext) -> Exported:
        context.markers("MuJoCo")
        refuse_too_light(context, self.share)
        frame, gone = _lighten(context, self.share)
        run, real_time = frame, tuple[str, ...]()
        if self.time_step is None:
            kept = self._kept_modes(frame)
            highest = float(np.sqrt(frame.Ke[kept[-1], kept[-1]]))
            step = 1 / (TOL.steps_per_radian * highest)
            first_notes: tuple[str, ...] = (
                f"{len(kept)} of {frame.count} modes, up to {in_hz(highest):.5g} Hz: the time step is {step:.3g} s; "
                "highest_hz takes fewer, within the tolerance",
            )
        else:
            self._refuse_both()
            step = self.time_step
            run, found = with_slides(context, frame, gone, step, self.share)
            kept = list(range(run.count))
            soft = tendon_share(context, frame, gone, step, self.share)
            real_time = step_notes(context, found, run.count, soft)
            first_notes = real_time
        with replacing(context.path) as file:
            for note in real_time:
                file.write(f"<!-- {note} -->\n".encode())
            for line in _lines(context, run, kept, step, self.share):
                file.write(f"{line}\n".encode())
            file.check()
        first_notes += () if self.time_step is None else price_note(_seconds_of_step(context.path), step)
        crossed = np.abs(frame.De - np.diag(np.diag(frame.De))).max(initial=0.0)
        notes = [
            *first_notes,
            "Coriolis and centrifugal forces on the modes are left out; deflections must be small and spin slow",
            "mean axes: the body of the file is at the origin of the frame, whatever the frame of the body file is",
        ]
        if crossed > TOL.left_out_damping * np.abs(frame.De).max(initial=0.0):
            notes.append(f"damping between different modes, of up to {crossed:.3g} 1/s, is left out")
        return Exported(paths=(context.path,), notes=tuple(notes))

    def truncate(self, context: ExportContext, step: float) -> RealTime:
        context.markers("MuJoCo")
        return with_slides(context, *_lighten(context, self.share), step, self.share)[1]

    def step_error(self, context: ExportContext, angle: float) -> float:
        return too_fast(angle)

    def _refuse_both(self) -> None:
        if self.highest_hz is not None:
            raise InputError(
                f"highest_hz = {self.highest_hz:g} and a time step of {self.time_step:g} s were given; leave one out",
                keyword="highest_hz",
            )

    def _kept_modes(self, frame: FloatingFrame) -> list[int]:
        """Modes up to the limit.

        Raises:
            InputError: what is left out carries too much of the compliance of the interfaces.
        """
        squares = np.diag(frame.Ke)
        limit = np.inf if self.highest_hz is None else (2 * np.pi * self.highest_hz) ** 2
        kept = np.flatnonzero(squares <= limit).tolist()
        rows = np.vstack([marker.motion for marker in frame.markers.values()])
        each = rows**2 / squares
        lost = 1 - each[:, kept].sum(axis=1) / np.where(each.any(axis=1), each.sum(axis=1), 1.0)
        if not kept or lost.max() > self.tolerance:
            worst = int(lost.argmax())
            name, axis = list(frame.markers)[worst // 6], AXES[worst % 6]
            raise InputError(
                f"highest_hz = {self.highest_hz} was given; the modes beyond carry {100 * lost[worst]:.3g} % of the "
                f"static compliance of {name!r} along {axis}, and the tolerance is {100 * self.tolerance:.3g} %; take "
                "more modes, or raise the tolerance",
                keyword="highest_hz",
            )
        return kept


def _seconds_of_step(path: Path) -> float | None:
    """Processor time in s of one step of the model, the mean of ``timed_steps``; None where MuJoCo is not installed."""
    try:
        mujoco = optional("mujoco", "the price of a step")
    except InputError:
        return None
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    start = time.process_time()
    mujoco.mj_step(model, data, nstep=TOL.timed_steps)
    return (time.process_time() - start) / TOL.timed_steps


def _lighten(context: ExportContext, share: float) -> tuple[FloatingFrame, Massless]:
    """Normal modes in mean axes of what is left when each interface took its mass, and the motions without mass.

    Raises:
        InputError: the interfaces take more than moves with them.
    """
    frame, gone = without_massless(context)
    integrals = frame.integrals
    mass, turning = taken_inertia(frame, share)
    first, inertia = integrals.first.copy(), integrals.inertia.copy()
    Ct, Cr, Me = integrals.Ct.copy(), integrals.Cr.copy(), integrals.Me.copy()
    for marker in frame.markers.values():
        point, phi, psi = marker.point, marker.motion[:3], marker.motion[3:]
        first -= mass * point
        inertia -= mass * skew(point).T @ skew(point) + turning * np.eye(3)
        Ct -= mass * phi.T
        Cr -= mass * (skew(point) @ phi).T + turning * psi.T
        Me -= mass * phi.T @ phi + turning * psi.T @ psi
    # Integrals of higher order stay as they were: nothing here goes by them.
    left = replace(
        integrals, mass=integrals.mass - mass * len(frame.markers), first=first, inertia=inertia, Ct=Ct, Cr=Cr, Me=Me
    )
    light = replace(frame, integrals=left, stiffening=None).in_frame("mean-axes")
    if np.linalg.eigvalsh(left.rigid)[0] <= 0 or np.linalg.eigvalsh(light.integrals.Me)[0] <= 0:
        raise InputError(
            f"share = {share} takes more mass for the interfaces than moves with some mode; take a smaller share, as "
            f"by --set share={share / 10:g}",
            keyword="share",
        )
    return normal_coordinates(light)[0], gone


def _lines(context: ExportContext, frame: FloatingFrame, kept: list[int], step: float, share: float) -> Iterator[str]:
    name, integrals = context.body.name, frame.integrals
    mass, turning = taken_inertia(context.frame, share)
    center = integrals.center
    J = integrals.about(center).inertia
    full = _numbers([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]])
    firm = f'solref="{2 * step!r} 1" solimp="{TOL.tendon_impedance} {TOL.tendon_impedance} 0.001 0.5 2"'
    yield f"<mujoco model={quoteattr(name)}>"
    yield f'  <option timestep="{step!r}" integrator="implicitfast"/>'
    # Frames of the model are taken as they are.
    yield '  <compiler angle="radian" balanceinertia="false" boundmass="0"/>'
    yield "  <worldbody>"
    yield f"    <body name={quoteattr(name)} pos={_text(frame.origin)}>"
    yield f"      <freejoint name={quoteattr(f'{name}:free')}/>"
    yield f'      <inertial pos={_text(center)} mass="{integrals.mass!r}" fullinertia="{full}"/>'
    for at, marker in frame.markers.items():
        yield f"      <body name={quoteattr(f'{name}:{at}')} pos={_text(marker.point)}>"
        for number, axis in enumerate(AXES):
            kind = "slide" if number < 3 else "hinge"
            yield (
                f'        <joint name={quoteattr(f"{name}:{at}:{axis}")} type="{kind}" '
                f'axis="{DIRECTIONS[number % 3]}"/>'
            )
        yield f'        <inertial pos="0 0 0" mass="{mass!r}" diaginertia="{_numbers([turning] * 3)}"/>'
        turn = quaternion(context.source.interfaces[at].axes.T)
        yield f"        <site name={quoteattr(f'{name}:{at}:frame')} quat={_text(turn)}/>"
        yield "      </body>"
    yield "    </body>"
    for mode in kept:
        spring = f'stiffness="{float(frame.Ke[mode, mode])!r}" damping="{max(float(frame.De[mode, mode]), 0.0)!r}"'
        yield f'    <body name={quoteattr(f"{name}:mode:{mode + 1}")} gravcomp="1">'
        yield f'      <joint name={quoteattr(f"{name}:mode:{mode + 1}")} type="slide" axis="1 0 0" {spring}/>'
        yield '      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        yield "    </body>"
    yield "  </worldbody>"
    yield "  <tendon>"
    for at, marker in frame.markers.items():
        for row, axis in enumerate(AXES):
            yield f"    <fixed name={quoteattr(f'{name}:{at}:{axis}')}>"
            yield f'      <joint joint={quoteattr(f"{name}:{at}:{axis}")} coef="-1"/>'
            for mode in kept:
                if marker.motion[row, mode]:
                    coefficient = float(marker.motion[row, mode])
                    yield f'      <joint joint={quoteattr(f"{name}:mode:{mode + 1}")} coef="{coefficient!r}"/>'
            yield "    </fixed>"
    yield "  </tendon>"
    yield "  <equality>"
    for at in frame.markers:
        for axis in AXES:
            yield f"    <tendon tendon1={quoteattr(f'{name}:{at}:{axis}')} {firm}/>"
    yield "  </equality>"
    yield "</mujoco>"


def _numbers(values: Floats | list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _text(values: Floats) -> str:
    return f'"{_numbers(values)}"'
