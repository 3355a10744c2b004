"""How wrong a body is, as a body file keeps it. NumPy only: files are shown without what certifies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.optional import optional
from morembs.base.summary import error_words, summarised, upwards
from morembs.base.types import Floats
from morembs.responses.measures import MEASURES, Limit
from morembs.storage.lemma import Lemma, proof_json, read_lemmas
from morembs.storage.table import dataset, derived, table_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OLD_KINDS = {"proven": "bound", "estimate": "estimate", "sampled": "none"}
_MAYBE = "may be absent"


class CertificateFormat:
    """Versions of the group ``certificate`` of ``morembs-body``; those without a version have errors at samples."""

    # Limits hold at every frequency of a band.
    LIMITS = 2


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorLimits:
    """``limits`` of the error by measure, on every frequency of the band. ``block_limit`` (ni, ni) upper limits of each
    block (motion of interface i, load on interface j) by its own envelope; ``cells_hz`` (nc, 2) cover the band, and
    ``cell_limit`` (nc, 3) are the upper limits on them, in the order of ``limits``. ``notes`` say what hinders.

    >>> error_limits(certified_reference(problem, [0.0, 3000.0]), reduced)
    ErrorLimits: errors at most envelope ..., peak ..., pointwise ...
    """

    limits: dict[str, Limit] = dataset(
        "any",
        "3",
        "largest error over the band: at least, at most, where the former is, Hz",
        name="limits/*",
        doc="`envelope`, `peak`, `pointwise`: largest error over the band: a value that is reached, one that is not "
        "exceeded (infinite where there is none), and the frequency of the former in Hz",
        known=MEASURES,
        write=lambda own: {
            name: np.array([limit.lower, limit.upper, limit.at_hz]) for name, limit in own.limits.items()
        },
    )
    block_limit: Floats = dataset(
        "any",
        "ni ni",
        "upper limit of motion of interface i to load on interface j",
        doc="upper limits of the motions of interface i under loads at interface j, each by its own envelope",
        since="0.2",
    )
    cells_hz: Floats = dataset("real", "nc 2", "cells that cover the band without gaps", "Hz", since="0.2")
    cell_limit: Floats = dataset("any", "nc 3", "upper limits on the cells: envelope, peak, pointwise", since="0.2")
    notes: tuple[str, ...] = dataset("notes", default_factory=tuple, doc="what there is to say about them", when=_MAYBE)

    def _facts(self) -> dict[str, object]:
        upper = ", ".join(f"{name} {upwards(limit.upper)}" for name, limit in self.limits.items())
        return {"errors at most": upper, "notes": "; ".join(self.notes)}


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate(ErrorLimits):
    """Errors of the elastic transfer matrix H over ``band_hz``; the radius of gyration scales rotations and moments.

    ``limits`` hold at every frequency of the band. ``kind`` is "proven" if all lemmas of ``proof`` are proven,
    "estimate" if one of them is an estimate, and "sampled" without limits. ``measure`` is the requested measure.
    ``damping_floor`` is the ratio of critical damping that is added to the full model and the body, for errors of H
    only.

    Curves at ``frequencies_hz`` (nf,):

    - ``full``, ``reduced`` (nf,): Frobenius norms of H in m/N;
    - ``error`` (nf,): norm of the difference over the norm of the full model;
    - ``reference_error`` (nf,): bound of the error of the full response, with round-off in K;
    - ``bound`` (nf,): sum of ``error`` and ``reference_error``;
    - ``held_error`` (ni, nf): relative error with interface i fixed, from the whole transfer matrix with its
      rigid-body part; NaN at frequencies below ``TOL.least_held`` of the upper frequency.

    ``block_error`` (ni, ni) is the largest relative error of each block of H at these frequencies. ``static_error`` is
    the error at 0 Hz, ``static_block_error`` (ni, ni) the error of the static compliance of each block.

    Modes of the full model whose enclosure ``mode_enclosure_hz`` (k, 2) meets the band: ``mode_frequencies_hz`` (k,),
    ``mode_deviation`` (k,) relative deviation of the frequencies of the body, ``mode_mac`` (k,) mass-weighted modal
    assurance criterion, ``residue_deviation`` (k,) relative deviation of the residues. The last two compare a whole
    cluster of close modes. ``residue_deviation`` is NaN for modes that no load excites. No mode below
    ``verified_below_hz`` is missing.

    Certificates of files of 0.1 have no ``limits``, and None for data that the file lacks.

    >>> [certificate] = certify(problem, [reduced], [0.0, 3000.0])
    >>> certificate.limit.lower <= certificate.limit.upper
    True
    >>> certificate
    Certificate: error at most ...
    """

    band_hz: tuple[float, float] = dataset("real", "2", "the limits hold from here to there", "Hz", since="0.2")
    measure: str = dataset(
        "text", "", "the limit that counts", doc="the limit that counts: `envelope`, `peak` or `pointwise`", since="0.2"
    )
    damping_floor: float = dataset(
        "real", "", "ratio of critical damping assumed in the full model and the body", since="0.2"
    )
    frequencies_hz: Floats = dataset("any", "nf", "of the curves", "Hz")
    full: Floats = dataset("any", "nf", "size of the transfer matrix of the full model", "m/N", when=_MAYBE)
    reduced: Floats = dataset("any", "nf", "size of that of the body", "m/N", when=_MAYBE)
    error: Floats = dataset("any", "nf", "size of the difference, relative to the full model")
    bound: Floats = dataset(
        "any",
        "nf",
        "upper limit of the error, or an estimate: see bound_kind",
        doc="`error` and `uncertainty`; infinite where there is none",
    )
    block_error: Floats = dataset(
        "any",
        "ni ni",
        "largest error of motion of interface i to load on interface j",
        doc="largest error at the samples of the motions of interface i under loads at interface j",
        when=_MAYBE,
    )
    held_error: Floats = dataset(
        "any",
        "ni nf",
        "error of what is left when interface i is held still",
        doc="error of what is left when interface i is held still; not a number at low frequencies",
        when=_MAYBE,
    )
    static_error: float = dataset("any", "", "error at 0 Hz", when=_MAYBE)
    static_block_error: Floats = dataset(
        "any",
        "ni ni",
        "error at 0 Hz of motion of interface i under load on interface j",
        doc="error at 0 Hz of the motions of interface i under loads at interface j, relative to these motions",
        since="0.2",
    )
    mode_frequencies_hz: Floats = dataset(
        "any",
        "nm",
        "of the full model in the band",
        "Hz",
        doc="free-free modes of the full model whose enclosure meets the band; files of earlier versions have those "
        "below the band too",
        when=_MAYBE,
    )
    mode_enclosure_hz: Floats = dataset(
        "any", "nm 2", "between these a frequency of the full model lies", "Hz", since="0.2"
    )
    mode_deviation: Floats = dataset(
        "any",
        "nm",
        "relative deviation of the body's frequencies",
        doc="relative deviation of the body's frequencies; no number for a mode without a partner",
        when=_MAYBE,
    )
    mode_mac: Floats = dataset(
        "any",
        "nm",
        "mass-weighted modal assurance criterion",
        doc="mass-weighted MAC, of the whole cluster where modes are close; near 0 for a mode that the body lacks",
        when=_MAYBE,
    )
    residue_deviation: Floats = dataset(
        "any",
        "nm",
        "relative deviation of the body's residues",
        doc="relative deviation of the residues of each mode, or of its cluster; not a number for modes that no load "
        "excites",
        since="0.2",
    )
    verified_below_hz: float = dataset(
        "any",
        "",
        "no mode below is missing",
        "Hz",
        doc="no mode below is missing: by a Sturm count, or as LAPACK found all modes of a small model, see `proof`",
        when=_MAYBE,
    )
    reference_error: Floats = dataset("any", "nf", "as uncertainty", when=_MAYBE)
    proof: tuple[Lemma, ...] = dataset(
        "json",
        "",
        "lemmas that the limits rest on",
        default=(),
        doc="JSON, `lemmas` lists the lemmas of the limits: `name` (a section of proofs.md), "
        "`statement`, `numbers` by name, `kind` (`proven` or `estimate`)",
        since="0.2",
        when="absent without limits",
        write=lambda own: proof_json(own.proof),
    )

    @derived("whole", "", "2: limits on every frequency of the band", name="version", since="0.2")
    def format_version(self) -> int | None:
        """What the datasets of a file mean; those of 0.1 do not say it."""
        return CertificateFormat.LIMITS if self.limits else None

    @derived(
        "any",
        "nf",
        "how far the full response is not known, relative to its size",
        doc="limit of what is not known of the full response, relative to `full`, round-off included",
        since="0.2",
    )
    def uncertainty(self) -> Floats:
        """``reference_error`` by its name in files."""
        return self.reference_error

    @derived("any", "", "largest difference over the largest size, at the samples", when=_MAYBE)
    def absolute_error(self) -> float | None:
        """Largest error of H at the sampled frequencies, relative to the largest norm of H there."""
        return None if self.full is None else float((self.error * self.full).max() / self.full.max())

    kind: str = dataset(
        "text",
        doc="`bound` (proven in exact arithmetic), `estimate` or `none`",
        name="bound_kind",
        known=tuple(OLD_KINDS.values()),
        write=lambda own: own.bound_kind,
    )

    @property
    def bound_kind(self) -> str:
        """``kind`` by its names in files: "bound", "estimate" or "none"."""
        return OLD_KINDS[self.kind]

    @property
    def datasets(self) -> Mapping[str, Any]:
        """Names to values as a body file keeps them, without missing ones."""
        values = {row.place.rstrip("/"): row.of(self) for row in CERTIFICATE}
        values |= {
            "band_hz": np.array(self.band_hz) if self.limits else None,
            "limits": values["limits"] or None,
            "notes": "; ".join(self.notes) or " ",
            "proof": [asdict(lemma) for lemma in self.proof] or None,
        }
        return {name: value for name, value in values.items() if value is not None}

    @property
    def limit(self) -> Limit:
        """The limit of ``measure``; infinite where the certificate holds at samples alone, as in files of 0.1."""
        worst = int(np.argmax(self.error))
        at_samples = Limit(lower=float(self.error[worst]), upper=np.inf, at_hz=float(self.frequencies_hz[worst]))
        return self.limits.get(self.measure, at_samples)

    def plot(self) -> Figure:
        """Responses of the full model and of the body, and the error with its limit, drawn with Matplotlib.

        >>> [certificate] = certify(problem, [reduced], [0.0, 3000.0])
        >>> certificate.plot().savefig("certificate.png")
        """
        # Not at the top: charts are made of certificates.
        from morembs.certificate.charts import certificate_chart

        return certificate_chart({"body": self}).figure()

    @property
    def words(self) -> str:
        """The largest error, in words."""
        if not self.limits:
            return f"{float(np.max(self.error)):.1e} at samples"
        return error_words(self.measure, self.limit.upper, self.error, self.band_hz, self.kind)

    def to_xarray(self) -> Any:
        """The curves as an ``xarray.Dataset`` over ``frequency_hz``: full, reduced, error, bound, reference_error.

        Raises:
            InputError: xarray is not installed.
        """
        xarray = optional("xarray", "to_xarray")
        names = ("full", "reduced", "error", "bound", "reference_error")
        return xarray.Dataset(
            {name: ("frequency_hz", getattr(self, name)) for name in names}, {"frequency_hz": self.frequencies_hz}
        )

    def _facts(self) -> dict[str, object]:
        return {
            "error": self.words,
            "static error": None if self.static_error is None else f"{self.static_error:.1e}",
            "modes in the band": None if self.mode_frequencies_hz is None else len(self.mode_frequencies_hz),
            "damping floor": self.damping_floor or None,
            "notes": "; ".join(self.notes),
        }


KINDS = {stored: kind for kind, stored in OLD_KINDS.items()}


def _read(*, kind: str, limits: Mapping[str, Any], **values: Any) -> Certificate:
    """The certificate that datasets of a file tell."""
    lacking: dict[str, Any] = dict.fromkeys(row.key for row in CERTIFICATE if row.read) | {"notes": (), "proof": ()}
    low, high = values.pop("band_hz", values["frequencies_hz"][[0, -1]]).tolist()
    if "proof" in values:
        values["proof"] = read_lemmas(values["proof"])
    given = {name: Limit(lower=low, upper=up, at_hz=hz) for name, (low, up, hz) in limits.items()}
    return Certificate(**lacking | values | {"kind": KINDS[kind], "limits": given, "band_hz": (low, high)})


CERTIFICATE = table_of(Certificate, build=_read)
