"""Parameters from measured eigenfrequencies: weighted least squares with exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares, linear_sum_assignment

from morembs.base.errors import InputError, SolverError, nearest
from morembs.base.types import Floats, Ints
from morembs.base.units import in_hz
from morembs.parametric.model import ModelAt, ParametricModel
from morembs.parametric.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """Measured eigenfrequencies of k modes.

    ``modes`` (k,) number the elastic modes of the body at nominal values from 1; ``frequencies_hz`` and ``sigma_hz``
    (k,) in Hz. ``shapes`` (k, d) are motions of d measured degrees of freedom, ``basis`` (d, n) those of the body's
    coordinates there; modes are then paired with them, whatever their numbers.

    Raises:
        InputError: numbers that are not positive, a mode twice, or shapes that do not fit.
    """

    modes: Ints
    frequencies_hz: Floats
    sigma_hz: Floats
    shapes: Floats | None = None
    basis: Floats | None = None

    def __post_init__(self) -> None:
        modes, frequencies, sigma = self.modes, self.frequencies_hz, self.sigma_hz
        if not (len(modes) and len(modes) == len(frequencies) == len(sigma)):
            raise InputError(
                f"{len(modes)} modes, {len(frequencies)} frequencies and {len(sigma)} standard deviations were given; "
                "expected one or more, and as many of each",
                keyword="modes",
            )
        if len(set(modes.tolist())) < len(modes) or modes.min() < 1:
            raise InputError(
                f"modes {modes.tolist()} were measured; expected different ones, numbered from 1", keyword="modes"
            )
        for what, values in (("frequencies", frequencies), ("standard deviations", sigma)):
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise InputError(
                    f"{what} {values.tolist()} Hz were measured; expected positive numbers", keyword="frequencies_hz"
                )
        if self.shapes is not None and (self.basis is None or self.shapes.shape != (len(modes), len(self.basis))):
            raise InputError(
                f"shapes {self.shapes.shape} were given for {len(modes)} modes; expected one row for each",
                keyword="shapes",
            )

    @property
    def highest(self) -> int:
        """Number of the highest mode."""
        return int(self.modes.max())


@dataclass(frozen=True, kw_only=True, eq=False)
class Updated:
    """Parameters as the measurement has them.

    ``p`` (P,) the estimate, ``sigma`` (P,) its standard deviation, infinite where the data do not tell it, and
    ``covariance`` (P, P) of the determined directions; ``singular_values`` of the derivatives of frequencies over their
    standard deviation by parameters over their range, ``untold`` the directions that the frequencies do not tell, each
    as changes relative to the value (to the range, where the nominal value is zero). ``at_end`` names estimates at the
    end of their range. ``frequencies_hz`` (k,) are those of the body at ``p``, in the order measured; ``above`` numbers
    those above the band for which the body was made, where nothing says how wrong they are.
    """

    names: tuple[str, ...]
    p: Floats
    sigma: Floats
    covariance: Floats
    singular_values: Floats
    untold: tuple[Mapping[str, float], ...]
    at_end: tuple[str, ...]
    measured: Measured
    frequencies_hz: Floats
    above: tuple[int, ...]
    evaluations: int

    @property
    def correlation(self) -> Floats:
        """(P, P) of what the data tell."""
        spread = np.sqrt(np.diag(self.covariance))
        spread = np.where(spread > 0, spread, 1.0)
        return np.asarray(self.covariance / np.outer(spread, spread))

    @property
    def misfit(self) -> float:
        """Root mean square of the differences of frequencies over their standard deviations."""
        deviation = (self.frequencies_hz - self.measured.frequencies_hz) / self.measured.sigma_hz
        return float(np.sqrt(np.mean(deviation**2)))

    @property
    def values(self) -> dict[str, float]:
        """The estimate by names."""
        return dict(zip(self.names, self.p.tolist(), strict=True))


def update(
    model: ParametricModel, measured: Measured, *, fixed: Sequence[str] = (), prior: Mapping[str, float] | None = None
) -> Updated:
    """The parameters in the box whose frequencies come nearest to measured ones (Friswell and Mottershead 1995, ch. 8).

    Args:
        fixed: names of parameters that keep their nominal values.
        prior: standard deviations of parameters about their nominal values, by names.

    Raises:
        InputError: unknown names, nothing to update, or a mode that the body does not have.
        SolverError: the iteration does not converge.
    """
    return _Fit(model, measured, fixed, dict(prior or {})).run()


@dataclass
class _Fit:
    """Parameters over their ranges, from 0 to 1."""

    model: ParametricModel
    measured: Measured
    fixed: Sequence[str]
    prior: Mapping[str, float]
    free: Ints = field(init=False)

    def __post_init__(self) -> None:
        box = self.model.box
        for name in (*self.fixed, *self.prior):
            if name not in box.names:
                raise InputError(
                    f"parameter {name!r} was given; {nearest(name, box.names)}", kind="unknown", keyword=name
                )
        both = [name for name in self.prior if name in self.fixed]
        if both:
            raise InputError(
                f"parameter {both[0]} was fixed and given a prior; leave out one of them",
                kind="conflict",
                keyword="prior",
            )
        for name, sigma in self.prior.items():
            if not (np.isfinite(sigma) and sigma > 0):
                raise InputError(
                    f"the prior of {name} has the standard deviation {sigma:g}; expected a positive one",
                    keyword="prior",
                )
        self.free = np.array([k for k, name in enumerate(box.names) if name not in self.fixed], dtype=np.int64)
        if not len(self.free):
            raise InputError("every parameter is fixed; leave one or more free to be updated", keyword="fixed")
        self.span = box.high - box.low
        nominal = self.model.at(box.nominal)
        have = len(nominal.frequencies_hz)
        if self.measured.highest > have:
            raise InputError(
                f"mode {self.measured.highest} was measured, and the body has {have}; expected a body of more modes, "
                "or fewer measured ones",
                keyword="modes",
            )
        self.window = min(have, self.measured.highest + TOL.modes_beyond)
        self.nominal = nominal
        # Residuals and their derivatives are asked for at the same values.
        self._last: tuple[Floats, tuple[ModelAt, Ints]] | None = None

    def run(self) -> Updated:
        box = self.model.box
        start = ((box.nominal - box.low) / self.span)[self.free]
        # From the very end of a range the method would not leave it.
        start = np.clip(start, 1e-3, 1 - 1e-3)
        fit = least_squares(
            self.residuals,
            start,
            jac=self.jacobian,
            bounds=(0.0, 1.0),
            method="trf",
            xtol=TOL.fit_change,
            ftol=TOL.fit_change,
            gtol=TOL.fit_change,
        )
        if not fit.success:
            raise SolverError(
                f"the parameters do not converge in {fit.nfev} evaluations: {fit.message}; fix some of them, or "
                "measure more modes"
            )
        return self._result(fit.x, int(fit.nfev))

    def residuals(self, x: Floats) -> Floats:
        at, pairs = self._pair_modes(x)
        deviation = (at.frequencies_hz[pairs] - self.measured.frequencies_hz) / self.measured.sigma_hz
        return np.concatenate(
            [deviation, self._weights() * (self._values(x) - self.model.box.nominal)[self._known_parameters()]]
        )

    def jacobian(self, x: Floats) -> Floats:
        """Derivatives of the residuals by x."""
        at, pairs = self._pair_modes(x)
        slopes = at.sensitivity(self.window).frequencies_hz
        columns = np.array([slopes[name][pairs] for name in self.model.box.names]).T
        known = np.diag(self.span)[self._known_parameters()] * self._weights()[:, None]
        both = np.vstack([columns * self.span / self.measured.sigma_hz[:, None], known])
        return np.asarray(both[:, self.free])

    def _known_parameters(self) -> list[int]:
        return [self.model.box.names.index(name) for name in self.prior]

    def _weights(self) -> Floats:
        return 1 / np.array(list(self.prior.values()), dtype=float)

    def _values(self, x: Floats) -> Floats:
        box = self.model.box
        p = box.nominal.copy()
        p[self.free] = box.low[self.free] + x * self.span[self.free]
        return p

    def _pair_modes(self, x: Floats) -> tuple[ModelAt, Ints]:
        """The body at ``x``, and which of its elastic modes are the measured ones."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x.copy(), self._match_modes(x)
        return self._last[1]

    def _match_modes(self, x: Floats) -> tuple[ModelAt, Ints]:
        at, r = self.model.at(self._values(x)), self.nominal.rigid.shape[1]
        Y = at.Y[:, r : r + self.window]
        if self.measured.shapes is not None:
            wanted, here = self.measured.shapes.T, np.asarray(self.measured.basis) @ Y
            likeness = _mac(wanted, here)
        else:
            # Shapes at nominal values tell the modes apart where they cross.
            _, M = self.model.matrices(self.model.box.nominal)
            first = self.nominal.Y[:, r + self.measured.modes - 1]
            likeness = (first.T @ M @ Y) ** 2 / np.einsum("ij,ij->j", Y, M @ Y)
        _, pairs = linear_sum_assignment(-likeness)
        return at, pairs

    def _result(self, x: Floats, evaluations: int) -> Updated:
        box, p = self.model.box, self._values(x)
        at, pairs = self._pair_modes(x)
        _, s, Vt = np.linalg.svd(self.jacobian(x))
        s = np.concatenate([s, np.zeros(len(Vt) - len(s))])
        identified = s > TOL.told_direction * s[0]
        inner = Vt[identified].T / s[identified]
        covariance = np.zeros((len(box.names), len(box.names)))
        covariance[np.ix_(self.free, self.free)] = inner @ inner.T
        covariance *= np.outer(self.span, self.span)
        sigma, untold = np.sqrt(np.diag(covariance)), []
        for v in Vt[~identified]:
            part = np.zeros(len(box.names))
            part[self.free] = v
            sigma[np.abs(part) > TOL.named_part] = np.inf
            relative = part * self.span / np.where(box.nominal != 0, np.abs(box.nominal), self.span)
            relative /= relative[np.argmax(np.abs(relative))]
            untold.append({box.names[k]: float(relative[k]) for k in np.flatnonzero(np.abs(part) > TOL.named_part)})
        ends = np.minimum(p - box.low, box.high - p) < TOL.at_end * self.span
        frequencies = at.frequencies_hz[pairs]
        band = np.inf if self.model.bound is None else in_hz(self.model.bound.highest)
        return Updated(
            names=box.names,
            p=p,
            sigma=sigma,
            covariance=covariance,
            singular_values=s,
            untold=tuple(untold),
            at_end=tuple(box.names[k] for k in self.free if ends[k]),
            measured=self.measured,
            frequencies_hz=frequencies,
            above=tuple(self.measured.modes[frequencies > band].tolist()),
            evaluations=evaluations,
        )


def _mac(A: Floats, B: Floats) -> Floats:
    """Modal assurance criterion (k, l) of the columns of two sets of shapes."""
    squares = np.outer(np.einsum("ij,ij->j", A, A), np.einsum("ij,ij->j", B, B))
    return np.asarray((A.T @ B) ** 2 / np.maximum(squares, np.finfo(float).tiny))
