"""Poles of a body against those of the full model: frequencies, shapes and residues, without the damping."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from morembs.base.types import Floats, Ints
from morembs.base.units import eigenvalue_in_hz, in_hz
from morembs.certificate.tolerances import TOL
from morembs.reducers.base import ReducedModel
from morembs.responses.certified_reference import CertifiedReference
from morembs.responses.pencils import modes_of


@dataclass(frozen=True, kw_only=True, eq=False)
class Poles:
    """Of the k modes whose enclosure meets the band: ``frequencies_hz`` (k,), ``enclosure_hz`` (k, 2) between which
    they lie, ``excited`` (k,) whether loads reach them; of a body the relative ``deviation`` (k,) of its frequencies,
    the ``mac`` (k,) and the relative ``residue`` deviation (k,), of the whole cluster where modes are close."""

    frequencies_hz: Floats
    enclosure_hz: Floats
    excited: NDArray[np.bool_]
    deviation: Floats
    mac: Floats
    residue: Floats


def enclosures(reference: CertifiedReference) -> Floats:
    """(k, 2) Hz between which the modes below the cut of ``reference`` lie, each by its number.

    Ritz values lie above. For what lies below, the blocks of the modes and of their complement couple by
    e = (sum sigma_p^2 / theta_p^3)^(1/2) at most in 1 / lam, and eigenvalues move by at most
    2 e^2 / (gap + (gap^2 + 4 e^2)^(1/2)) (Li and Li 2005; Weyl where there is no gap). Round-off in K is counted.
    """
    theta, k = reference.values[: len(reference.sigma)], len(reference.sigma)
    radius = reference.unsure[:k]
    each = reference.sigma**2 / theta**3
    coupled = float(np.sqrt(each.sum()))
    # The complement has nothing above 1 / lam^.
    beyond = 1 / reference.cut + float((each / (1 / theta - 1 / reference.cut)).sum())
    gap = np.maximum(1 / theta - beyond, 0.0)
    moved = 2 * coupled**2 / np.maximum(gap + np.sqrt(gap**2 + 4 * coupled**2), np.finfo(float).tiny)
    low = 1 / (1 / theta + moved)
    return np.asarray(eigenvalue_in_hz(np.stack([low - radius, theta + radius], axis=1)))


def poles_of(reference: CertifiedReference, reduced: ReducedModel) -> Poles:
    """The modes of ``reference`` in its band against those of ``reduced``.

    Partners are sought for the modes below the band as well, which else would take those of modes in it. A mode whose
    enclosure meets an end of the band may lie in it, and counts.
    """
    problem, (low, high) = reference.problem, reference.band_hz
    limits = enclosures(reference)
    band = np.flatnonzero((limits[:, 1] >= low) & (limits[:, 0] <= high))
    inside = int(band.max(initial=-1)) + 1
    omega, b = np.sqrt(reference.values[:inside]), reference.b
    energy = (b**2).sum(axis=1) / reference.values
    shapes = problem.compute_once(
        ("M times modes", reference.band_hz, reference.floor),
        lambda: problem.space.map_columns(lambda X: problem.M @ X, reference.vectors[:, :inside]),
    )
    correlations = problem.space.dot(shapes, reduced.V)
    partner, deviation, cross = _partners(reduced, correlations, omega)
    mac, residue = np.zeros(inside), np.full(inside, np.nan)
    rigid = reduced.rigid_count
    X, L = (modes[:, rigid:] for modes in modes_of(reduced.M, reduced.K, rigid, reduced.symmetric)[1:])
    scale = problem.motion_scale
    outputs, inputs = ((reduced.C * scale[:, None]) @ X).T, L.T @ (reduced.B * scale)
    excited = energy[:inside] > TOL.unexcited_energy * energy.sum()
    starts = np.flatnonzero(np.diff(omega, prepend=-np.inf) > TOL.mode_cluster_gap * omega)
    for first, last in pairwise([*starts, inside]):
        partners = partner[first:last]
        partners = partners[partners >= 0]
        block = cross[first:last][:, partners]
        s = np.linalg.svd(block, compute_uv=False) if block.size else np.zeros(1)
        mac[first:last] = s.min() ** 2 if last - first == block.shape[1] else 0.0
        true = b[first:last].T @ b[first:last]
        if excited[first:last].any():
            error = np.linalg.norm(outputs[partners].T @ inputs[partners] - true)
            residue[first:last] = error / np.linalg.norm(true)
    return Poles(
        frequencies_hz=in_hz(omega[band]),
        enclosure_hz=limits[band],
        excited=excited[band],
        deviation=deviation[band],
        mac=mac[band],
        residue=residue[band],
    )


def _partners(reduced: ReducedModel, correlations: Floats, omega: Floats) -> tuple[Ints, Floats, Floats]:
    """Number (k,) of the body's mode for each of the full model, -1 for none, the deviation (k,) of its frequency,
    and the modes' correlations (k, n), from Phi' M V ``correlations`` (k, n + r)."""
    values, Y = reduced.modes()
    theta, Y = np.maximum(values[reduced.rigid_count :], 0.0), Y[:, reduced.rigid_count :]
    cross = correlations @ Y
    partner, deviation = np.full(len(omega), -1), np.full(len(omega), np.nan)
    if not cross.size:
        return partner, deviation, cross
    if not reduced.symmetric:
        cross = cross / np.maximum(np.linalg.norm(cross, axis=0).max(initial=0.0), 1.0)
    rows, matched = linear_sum_assignment(-(cross**2))
    partner[rows] = matched
    deviation[rows] = np.abs(np.sqrt(theta[matched]) / omega[rows] - 1)
    return partner, deviation, cross
