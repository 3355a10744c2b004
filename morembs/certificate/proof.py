"""The lemmas that the limits of a certificate rest on; docs/background/proofs.md has a section for each proof."""

from __future__ import annotations

import numpy as np

from morembs.base.summary import upwards
from morembs.base.units import eigenvalue_in_hz
from morembs.certificate.poles import enclosures
from morembs.certificate.record import ErrorLimits
from morembs.responses.certified_reference import CertifiedReference
from morembs.storage.lemma import ESTIMATE, PROVEN, Lemma


def proof_of(reference: CertifiedReference, limits: ErrorLimits) -> tuple[Lemma, ...]:
    """The chain behind the limits ``limits`` against ``reference``."""
    return (
        _count(reference),
        _enclosures(reference),
        _complement(reference),
        _residual(reference),
        _damping(reference),
        _round_off(reference),
        _cells(reference, limits),
    )


def _lemma(name: str, statement: str, kind: str = PROVEN, **numbers: float) -> Lemma:
    """Infinite numbers are left out: the statement says so."""
    finite = {key: float(value) for key, value in numbers.items() if np.isfinite(value)}
    return Lemma(name=name, statement=statement, numbers=finite, kind=kind)


def _count(reference: CertifiedReference) -> Lemma:
    count, below = len(reference.sigma), float(eigenvalue_in_hz(reference.cut))
    name, how = (
        ("sturm-count", "by the negative pivots of K - sigma M")
        if reference.counted
        else ("dense-spectrum", "as LAPACK has all eigenvalues of this small model")
    )
    return _lemma(name, f"{count} elastic modes lie below {below:,.6g} Hz, {how}", modes=count, below_hz=below)


def _enclosures(reference: CertifiedReference) -> Lemma:
    hz = enclosures(reference)
    widest = float((hz[:, 1] - hz[:, 0]).max(initial=0.0))
    statement = f"each of these modes lies in its enclosure, at most {upwards(widest)} Hz wide"
    return _lemma("ritz-enclosures", statement, modes=len(hz), widest_hz=widest)


def _complement(reference: CertifiedReference) -> Lemma:
    least = float(eigenvalue_in_hz(reference.least))
    statement = f"beside the vectors of these modes K >= lam^ M, with lam^ that of {least:,.6g} Hz"
    return _lemma("complement-bound", statement, least_hz=least, highest_hz=reference.band_hz[1])


def _residual(reference: CertifiedReference) -> Lemma:
    bound, order = float(reference.error_bounds.max(initial=0.0)), len(reference.values)
    # Without a damping matrix what else makes an estimate is the damping table.
    doubtful = not reference.proven and (reference.problem.D is not None or not len(reference.model.damping.jumps))
    what = "by residuals at frequencies of the band" if doubtful else "on all of the band"
    size = f"at most {upwards(bound)} times the envelope" if np.isfinite(bound) else "unbounded"
    statement = f"|H - H_ref| is {size}, {what}, for the reference of {order} modes"
    statement = "; ".join([statement, *reference.doubts]) if doubtful else statement
    return _lemma("reference-residual", statement, ESTIMATE if doubtful else PROVEN, error=bound, order=order)


def _damping(reference: CertifiedReference) -> Lemma:
    damping, kind = reference.model.damping, PROVEN
    if reference.problem.D is not None:
        kind = PROVEN if reference.proven else ESTIMATE
        statement = "the damping matrix of the model is symmetric, and couples modes as the reference has it"
    elif damping.is_modal:
        statement = "modal damping acts on the modes of the reference, each of which has one ratio of the table"
        if not reference.proven and len(damping.jumps):
            kind, statement = ESTIMATE, "; ".join(reference.doubts)
    else:
        statement = (
            "damping is a function of K and M, and diagonal in the modes"
            if damping.is_viscous or (damping.structural)
            else "there is no damping"
        )
    return _lemma("damping", statement, kind, damping_floor=reference.floor)


def _round_off(reference: CertifiedReference) -> Lemma:
    with np.errstate(divide="ignore", invalid="ignore"):
        lost, at_hz = reference.measure_loss()
    lost = np.inf if np.isnan(lost) else lost
    size = f"at most {upwards(lost)} times the envelope" if np.isfinite(lost) else "unbounded"
    statement = f"round-off and the residual together move H by {size}, at resonances and ends of the band"
    return _lemma("round-off", statement, error=lost, at_hz=at_hz)


def _cells(reference: CertifiedReference, limits: ErrorLimits) -> Lemma:
    low, high = reference.band_hz
    upper = {name: limit.upper for name, limit in limits.limits.items()}
    statement = (
        f"on {len(limits.cells_hz):,} cells, which cover {low:,.6g} to {high:,.6g} Hz, the errors are at most "
        + ", ".join(f"{name} {upwards(value)}" for name, value in upper.items())
    )
    return _lemma("cells-of-the-band", statement, PROVEN, cells=len(limits.cells_hz), low_hz=low, high_hz=high, **upper)
