"""Slides of a MuJoCo model that stand for the modes that its time step does not resolve, and the error of the file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sl

from morembs.base.summary import upwards
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.body.floating.frame import FloatingFrame
from morembs.exporters.base import ExportContext
from morembs.exporters.read_back import SecondOrder
from morembs.exporters.real_time import (
    RealTime,
    certificate_note,
    gyration,
    refuse_nothing_left,
    slide_note,
    slow_modes,
)
from morembs.exporters.slow_frame import compliance_factor
from morembs.exporters.tolerances import TOL
from morembs.fem.fe_model import rigid_motion


def taken_inertia(frame: FloatingFrame, share: float) -> tuple[float, float]:
    """Mass in kg and rotary inertia in kg m2 that each interface takes."""
    integrals = frame.integrals
    central = np.linalg.eigvalsh(integrals.about(integrals.center).inertia)
    return share * integrals.mass, share * float(central[0])


def with_slides(
    context: ExportContext, frame: FloatingFrame, step: float, share: float
) -> tuple[FloatingFrame, RealTime]:
    """Normal modes of ``frame`` that ``step`` in s resolves, then slides that stand for all others.

    The slides vibrate as fast as the step resolves; their motions are the eigenvectors of the compliance of the modes
    that are gone, less what the tendons yield, so that the file is exact at rest; so is its damping to first order.

    Raises:
        InputError: no mode is left.
    """
    squares, damping = np.diag(frame.Ke), np.maximum(np.diag(frame.De), 0.0)
    slow = slow_modes(np.sqrt(squares), damping, step)
    refuse_nothing_left(context.body.name, step, int(slow.sum()))
    motion = np.vstack([marker.motion for marker in frame.markers.values()])
    gone = motion[:, ~slow] / squares[~slow]
    R = gone @ motion[:, ~slow].T - np.diag(_yielding(context, frame, motion[:, slow], step, share))
    length = np.tile(np.repeat([1.0, gyration(context.source)], 3), len(frame.markers))
    # Of unit compliance; what the tendons yield alone is no slide.
    U, fastest = compliance_factor(R, length)[:, : None if not slow.all() else 0], TOL.resolved_angle / step
    X = np.linalg.pinv(U)
    losses = np.diag(X @ (gone * damping[~slow]) @ gone.T @ X.T)
    both = np.hstack([motion[:, slow], fastest * U])
    markers = {
        name: replace(marker, motion=both[6 * at : 6 * at + 6])
        for at, (name, marker) in enumerate(frame.markers.items())
    }
    stiffness = np.concatenate([squares[slow], np.full(U.shape[1], fastest**2)])
    run = replace(
        frame,
        Ke=np.diag(stiffness),
        De=np.diag(np.concatenate([damping[slow], fastest**2 * np.maximum(losses, 0.0)])),
        markers=markers,
    )
    return run, _measure(context, run, step, share, kept=int(slow.sum()), count=frame.count)


def step_notes(context: ExportContext, found: RealTime, count: int) -> tuple[str, ...]:
    """Notes for the user of a model with ``count`` slides."""
    return (*found.notes, *slide_note(found, count), _integrator_note(found.step), *certificate_note(context.body))


def _yielding(context: ExportContext, frame: FloatingFrame, motion: Floats, step: float, share: float) -> Floats:
    """(6 k,): compliance of tendons at rest. MuJoCo has f = -(r'' + b r' + c r) / R for a row that is off by r, with
    R = (1 - d) / d A, d the impedance and A the inverse inertia of the row, b and c of the time constant, two steps,
    and critical damping."""
    _, R, _, c = _rows(context, frame, motion, step, share)
    return np.asarray(R / c)


def _rows(
    context: ExportContext, frame: FloatingFrame, motion: Floats, step: float, share: float
) -> tuple[Floats, Floats, float, float]:
    """Inertia of the interfaces (6 k,), and R (6 k,), b and c of the tendons, see ``_yielding``."""
    own = np.tile(np.repeat(taken_inertia(context.frame, share), 3), len(frame.markers))
    rigid, d = _rigid_rows(frame), TOL.tendon_impedance
    base = (rigid * np.linalg.solve(frame.integrals.rigid, rigid.T).T).sum(axis=1)
    inverse = 1 / own + base + (motion**2).sum(axis=1)
    return own, (1 - d) / d * inverse, 1 / (step * d), 1 / (2 * step * d) ** 2


def _measure(
    context: ExportContext, run: FloatingFrame, step: float, share: float, *, kept: int, count: int
) -> RealTime:
    """How far the equations of the file are from those of the body, steps of time left aside."""
    whole = context.frame.in_frame("mean-axes")
    found, expected = _run_equations(context, run, step, share), _body_equations(whole)
    length = np.tile(np.repeat([1.0, gyration(context.source)], 3), len(run.markers))
    scale = np.outer(length, length)
    motion = np.vstack([marker.motion for marker in whole.markers.values()])
    size = float((np.abs(motion @ np.linalg.solve(whole.Ke, motion.T)) * scale).max())
    bands = [share * TOL.resolved_angle / step for share in TOL.band_shares]
    errors = []
    for band in bands:
        # Far below, differences are round-off of rigid motion.
        samples = np.linspace(TOL.band_shares[0] * band, band, TOL.error_samples) * (1 - 1j * TOL.sampled_damping)
        difference = (np.abs(found.at(w, 0.0)[0] - expected.at(w, 0.0)[0]) * scale for w in samples.tolist())
        errors.append(max(float(each.max()) for each in difference) / size)
    hz = tuple(in_hz(band) for band in bands)
    errors_of = {"displacements": tuple(errors)}
    return RealTime(step=step, kept=kept, count=count, bands_hz=hz, errors=errors_of, proven=False)


def _run_equations(context: ExportContext, run: FloatingFrame, step: float, share: float) -> SecondOrder:
    """Of rigid motion, slides, and the motion of the interfaces, on which loads act."""
    motion = np.vstack([marker.motion for marker in run.markers.values()])
    own, R, b, c = _rows(context, run, motion, step, share)
    rows, n = motion.shape
    E = np.hstack([-_rigid_rows(run), -motion, np.eye(rows)])
    tendons, still = E.T @ (E / R[:, None]), np.zeros((6, 6))
    C = np.hstack([np.zeros((rows, 6 + n)), np.eye(rows)])
    return SecondOrder(
        M=sl.block_diag(run.integrals.rigid, np.eye(n), np.diag(own)) + tendons,
        K=sl.block_diag(still, run.Ke, np.zeros((rows, rows))) + c * tendons,
        D=sl.block_diag(still, run.De, np.zeros((rows, rows))) + b * tendons,
        B=C.T,
        C=C,
    )


def _body_equations(frame: FloatingFrame) -> SecondOrder:
    """Of rigid motion and elastic coordinates in mean axes; loads act on the interfaces."""
    C = np.hstack([_rigid_rows(frame), np.vstack([marker.motion for marker in frame.markers.values()])])
    still = np.zeros((6, 6))
    M = sl.block_diag(frame.integrals.rigid, frame.integrals.Me)
    return SecondOrder(M=M, K=sl.block_diag(still, frame.Ke), D=sl.block_diag(still, frame.De), B=C.T, C=C)


def _rigid_rows(frame: FloatingFrame) -> Floats:
    """(6 k, 6): motions of the interfaces under unit translations and rotations about the origin."""
    return np.vstack([rigid_motion(np.tile(marker.point, (6, 1)), np.arange(6)) for marker in frame.markers.values()])


def too_fast(angle: float) -> float:
    """Part by which semi-implicit Euler puts the frequency of a mode too high that goes on by ``angle`` in rad in a
    step: it vibrates at 2 / step asin(angle / 2)."""
    return float(2 * np.arcsin(min(angle, 2.0) / 2) / angle - 1)


def _integrator_note(step: float) -> str:
    angles = [share * TOL.resolved_angle for share in TOL.band_shares]
    shown = ", ".join(f"{upwards(too_fast(angle))} at {in_hz(angle / step):.4g} Hz" for angle in angles)
    return f"beside that, the steps of MuJoCo put frequencies too high by {shown}"
