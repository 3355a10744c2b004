"""Slides of a MuJoCo model that stand for the modes that its time step does not resolve, and the error of the file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import InputError
from morembs.base.summary import upwards
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.body.floating.frame import FloatingFrame
from morembs.body.floating.tolerances import TOL as FLOATING
from morembs.exporters.base import ExportContext
from morembs.exporters.read_back import FirstOrder, SecondOrder
from morembs.exporters.real_time import RealTime, certificate_note, gyration, slide_note, slow_modes
from morembs.exporters.sid import in_shapes
from morembs.exporters.slow_frame import compliance_factor
from morembs.exporters.tolerances import TOL
from morembs.fem.fe_model import rigid_motion


def taken_inertia(frame: FloatingFrame, share: float) -> tuple[float, float]:
    """Mass in kg and rotary inertia in kg m2 that each interface takes."""
    integrals = frame.integrals
    central = np.linalg.eigvalsh(integrals.about(integrals.center).inertia)
    return share * integrals.mass, share * float(central[0])


def refuse_too_light(context: ExportContext, share: float) -> None:
    """Refuse a ``share`` that leaves interfaces less mass than MuJoCo takes of a body that moves.

    Raises:
        InputError: in these cases.
    """
    mass, turning = taken_inertia(context.frame, share)
    if min(mass, turning) <= TOL.least_mujoco_inertia:
        raise InputError(
            f"share = {share:g} was given, which gives each interface {mass:.3g} kg and {turning:.3g} kg m2; MuJoCo "
            f"takes more than {TOL.least_mujoco_inertia:g} of both: take a larger share, such as the default, 0.01",
            keyword="share",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Massless:
    """m motions without mass, of unit stiffness: ``motion`` (6 k, m) of the interfaces, ``damping`` (m, m)."""

    motion: Floats
    damping: Floats


def without_massless(context: ExportContext) -> tuple[FloatingFrame, Massless]:
    """The frame of the motions that have mass, and the others."""
    frame, Z = context.frame, context.without_mass
    motion = np.vstack([marker.motion for marker in frame.in_frame("mean-axes").markers.values()])
    if Z is None:
        return frame, Massless(motion=motion[:, :0], damping=np.zeros((0, 0)))
    # Without energy of both.
    rest = sl.null_space(Z.T @ frame.Ke / np.linalg.norm(frame.Ke, axis=0))
    return in_shapes(frame, rest / np.linalg.norm(frame.Ke, axis=0)[:, None]), Massless(
        motion=motion @ Z, damping=Z.T @ frame.De @ Z
    )


def with_slides(
    context: ExportContext, frame: FloatingFrame, gone: Massless, step: float, share: float
) -> tuple[FloatingFrame, RealTime]:
    """Normal modes of ``frame`` that ``step`` in s resolves, then slides that stand for all others.

    The slides vibrate as fast as the step resolves; their motions are the eigenvectors of the compliance of the modes
    that are gone, less what the tendons yield, so that the file is exact at rest; so is its damping to first order.
    """
    slow, motion, shapes, lost = _gone_shapes(frame, gone, step)
    squares, damping = np.diag(frame.Ke), np.maximum(np.diag(frame.De), 0.0)
    R = shapes @ shapes.T - np.diag(_tendon_compliance(context, frame, motion[:, slow], step, share))
    length = np.tile(np.repeat([1.0, gyration(context.source)], 3), len(frame.markers))
    # Of unit compliance; what the tendons yield alone is no slide.
    U, fastest = compliance_factor(R, length)[:, : None if shapes.shape[1] else 0], TOL.resolved_angle / step
    X = np.linalg.pinv(U)
    losses = np.diag(X @ shapes @ lost @ shapes.T @ X.T)
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
    return run, _measure(context, run, step, share, kept=int(slow.sum()), count=context.frame.count)


def _gone_shapes(frame: FloatingFrame, gone: Massless, step: float) -> tuple[np.ndarray, Floats, Floats, Floats]:
    """Which modes are slow (n,), motion (6 k, n) of the interfaces by all, and shapes (6 k, m) of unit stiffness of
    what ``step`` in s does not resolve, with their damping (m, m)."""
    squares, damping = np.diag(frame.Ke), np.maximum(np.diag(frame.De), 0.0)
    slow = slow_modes(np.sqrt(squares), damping, step)
    motion = np.vstack([marker.motion for marker in frame.markers.values()])
    shapes = np.hstack([motion[:, ~slow] / np.sqrt(squares[~slow]), gone.motion])
    return slow, motion, shapes, sl.block_diag(np.diag(damping[~slow] / squares[~slow]), gone.damping)


def tendon_share(context: ExportContext, frame: FloatingFrame, gone: Massless, step: float, share: float) -> float:
    """What the tendons yield beyond the modes that are gone, over the largest static compliance of the body."""
    slow, motion, shapes, _ = _gone_shapes(frame, gone, step)
    length = np.tile(np.repeat([1.0, gyration(context.source)], 3), len(frame.markers))
    both = np.outer(length, length)
    missing = shapes @ shapes.T - np.diag(_tendon_compliance(context, frame, motion[:, slow], step, share))
    whole = shapes @ shapes.T + (motion[:, slow] / np.diag(frame.Ke)[slow]) @ motion[:, slow].T
    return max(0.0, -float(np.linalg.eigvalsh(missing * both)[0])) / float(np.abs(whole * both).max())


def step_notes(context: ExportContext, found: RealTime, count: int, soft: float) -> tuple[str, ...]:
    """Notes for the user of a model with ``count`` slides, whose tendons yield too much by the part ``soft``."""
    yields = (
        f"{upwards(soft)} of that error is what the tendons of MuJoCo yield more than the body does; a larger share "
        "(such as share=0.05) makes them stiffer, as a shorter step does, by its square",
    )
    decay = f"that error holds with {TOL.sampled_damping:.0%} of damping at resonances"
    return (
        *found.notes,
        *slide_note(found, count),
        _integrator_note(found.step),
        decay,
        *certificate_note(context.body),
        *(yields if soft > TOL.large_tendon_share else ()),
    )


def _tendon_compliance(
    context: ExportContext, frame: FloatingFrame, motion: Floats, step: float, share: float
) -> Floats:
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
    """Upper limits of how far the equations of the file are from those of the body, steps of time left aside."""
    whole = context.frame.in_frame("mean-axes")
    found = _elastic_part(_run_equations(context, run, step, share))
    expected = _elastic_part(_body_equations(whole))
    length = np.tile(np.repeat([1.0, gyration(context.source)], 3), len(run.markers))
    motion = length[:, None] * np.vstack([marker.motion for marker in whole.markers.values()])
    size = float(np.abs(motion @ np.linalg.solve(whole.Ke, motion.T)).max())
    difference = FirstOrder(
        A=sl.block_diag(found.A, expected.A),
        B=np.vstack([found.B, expected.B]) * length,
        C=np.hstack([found.C, -expected.C]) * length[:, None],
        D=found.D,
    )
    bands = [share * TOL.resolved_angle / step for share in TOL.band_shares]
    errors = tuple(limit / size for limit in largest_responses(difference, bands))
    hz = tuple(in_hz(band) for band in bands)
    errors_of = {"displacements": errors}
    return RealTime(step=step, kept=kept, count=count, bands_hz=hz, errors=errors_of, proven=True)


def _elastic_part(system: SecondOrder) -> FirstOrder:
    """The ``system`` without its six rigid motions, which file and body have in common: mass, momentum and places of
    the interfaces are the same. States are velocities, and displacements in units of velocities."""
    values, Y = sl.eigh(system.K, system.M)
    elastic = slice(FLOATING.rigid_motions, None)
    Y, omega = Y[:, elastic], np.sqrt(values[elastic])
    n, D = len(omega), np.zeros_like(system.K) if system.D is None else system.D
    C = system.C @ Y
    return FirstOrder(
        A=np.block([[np.zeros((n, n)), np.diag(omega)], [-np.diag(omega), -Y.T @ D @ Y]]),
        B=np.vstack([np.zeros((n, system.B.shape[1])), Y.T @ system.B]),
        C=np.hstack([C / omega, np.zeros_like(C)]),
        D=np.zeros((len(C), system.B.shape[1])),
    )


def largest_responses(system: FirstOrder, bands: Sequence[float]) -> list[float]:
    """Upper limits of all entries of the response at s = w (i + ``sampled_damping``), for all w up to each of the
    rising ``bands`` in rad/s: in cells about w_c by Taylor series, with the remainder of each pole.

    Of C (s - A)^-1 B = sum_k R_k / (s - p_k), term j of the series is sum_k R_k (s_c - s)^j / (s_c - p_k)^(j+1).
    """
    poles, V = np.linalg.eig(system.A)
    left, right = system.C @ V, np.linalg.solve(V, system.B)
    residues = (np.abs(left)[:, :, None] * np.abs(right)).max(axis=(0, 2))
    way, terms, result, start, largest = 1j + TOL.sampled_damping, np.arange(TOL.cell_terms), [], 0.0, 0.0
    for end in bands:
        for center, half in _cells(poles, way, start, end):
            radius, distance = abs(way) * half, center * way - poles
            weights = (radius / distance) ** terms[:, None] / distance
            parts = np.abs((left * weights[:, None, :]) @ right).sum(axis=0)
            size = np.abs(distance)
            remainder = (residues * (radius / size) ** TOL.cell_terms / (size - radius)).sum()
            largest = max(largest, float(parts.max() + remainder))
        result.append(largest)
        start = end
    return result


def _cells(poles: np.ndarray, way: complex, start: float, end: float) -> Iterator[tuple[float, float]]:
    """Centers and half widths of cells from ``start`` to ``end``, small beside their distance to all ``poles``."""
    left = [(start, end)]
    while left:
        a, b = left.pop()
        center, half = (a + b) / 2, (b - a) / 2
        if abs(way) * half <= TOL.cell_radius * np.abs(center * way - poles).min():
            yield center, half
        else:
            left += [(a, center), (center, b)]


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
