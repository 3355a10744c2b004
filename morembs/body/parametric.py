"""A body file with parameters, evaluated: bodies at other values, with their frames, derivatives and bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Complexes, Floats
from morembs.body.body import MISSING, Body
from morembs.body.parametric_parts import ParametricParts
from morembs.body.stored import ByName, StoredBodies
from morembs.body.tolerances import TOL
from morembs.parametric.model import ModelAt, Sensitivity
from morembs.storage.lemma import Lemma

if TYPE_CHECKING:
    from morembs.body.floating.frame import FloatingFrame
    from morembs.parametric.update import Measured, Updated


class ParametricBody:
    """A body of a file with parameters.

    Raises:
        InputError: its matrices at nominal values are not those of the body.

    >>> body = morembs.read_body("bracket.h5").bodies["parametric"].parametric
    >>> at = body.at(E_arm=2.0e11, t=1.5)
    >>> at.frequencies_hz[:2]
    """

    def __init__(self, path: Path, source: StoredBodies, body: Body, parts: ParametricParts) -> None:
        self.path, self.source, self.stored, self.parts = path, source, body, parts
        self.model = replace(parts.model, B=body.input_matrix)
        nominal = self.model.at(self.model.box.nominal)
        for name, found, held in (("K", nominal.K, body.stiffness_matrix), ("M", nominal.M, body.mass_matrix)):
            allowed = TOL.nominal_difference * np.abs(held).max()
            if held.shape != found.shape or not np.abs(found - held).max() <= allowed:
                raise InputError(
                    f"{path}: {name} of the parameters of body {body.name!r} is not that of the body at nominal "
                    "values; the file was damaged or changed after it was written, write it again",
                    kind="file",
                    keyword=path.name,
                )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.model.box.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return self.model.box.units

    @property
    def box(self) -> tuple[Floats, Floats]:
        """Least and largest values (P,) of the parameters."""
        return self.model.box.low, self.model.box.high

    @property
    def nominal(self) -> Floats:
        """Nominal values (P,)."""
        return self.model.box.nominal

    @property
    def box_bound(self) -> float:
        """Largest relative bound of the error over the band of all values that were sampled: no more than that."""
        return self.model.box_bound

    @property
    def proof(self) -> tuple[Lemma, ...]:
        """The lemmas that bounds of the error rest on at all values; none without bounds."""
        return self.model.proof

    def at(self, **values: float) -> Evaluation:
        """The body at named values; the others are nominal.

        Raises:
            InputError: an unknown name, or a value outside its range.
        """
        at = self.model.at(self.model.box.point(values))
        return Evaluation(parent=self, **{field.name: getattr(at, field.name) for field in fields(at)})

    def sensitivity(self, **values: float) -> Sensitivity:
        """Derivatives of the matrices, frequencies and responses at named values, exact for the reduced body.

        Raises:
            InputError: as ``at``.
        """
        return self.at(**values).sensitivity()

    def update(
        self, measured: Measured, *, fixed: Sequence[str] = (), prior: Mapping[str, float] | None = None
    ) -> Updated:
        """The parameters whose frequencies come nearest to measured ones: see ``morembs.parametric.update.update``."""
        from morembs.parametric.update import update

        return update(self.model, measured, fixed=fixed, prior=prior)

    def response(self, frequencies_hz: Floats, **values: float) -> tuple[Complexes, Floats]:
        """Elastic part of H (nf, m, m), and bounds (nf,) of its error: see ``ModelAt.bound``.

        Raises:
            InputError: as ``at``.
        """
        at = self.at(**values)
        return at.response(frequencies_hz), at.bound(frequencies_hz)

    def frequencies_hz(self, table: Floats, count: int = 6) -> Floats:
        """The first elastic eigenfrequencies (k, ``count``) at each row of ``table`` (k, P), in the order of ``names``.

        Raises:
            InputError: a value outside its range, or more frequencies than the body has.
        """
        return self.model.frequencies_hz(table, count)


def _frame_of(known: FloatingFrame) -> dict[str, Any]:
    return {"kind": known.kind, "interfaces": known.interfaces, "origin": known.origin.tolist()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation(ModelAt):
    """A parametric body evaluated at one value: the reduced model there, and the ``body`` that is made of it."""

    parent: ParametricBody

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters by name."""
        return dict(zip(self.parent.names, self.p.tolist(), strict=True))

    @cached_property
    def bodies(self) -> StoredBodies:
        """What the body file of these values holds, of which exporters take the ``body``."""
        source, body, terms = self.parent.source, self.parent.stored, self.parent.parts.frame
        changed: dict[str, Any] = {}
        floating, interfaces = None, source.interfaces
        if terms is not None and body.floating is not None:
            known = body.floating
            floating = terms.frame(self, **_frame_of(known))
            about = floating.integrals.center
            changed = {
                "mass": floating.integrals.mass,
                "center_of_mass": floating.origin + about,
                "inertia": floating.integrals.about(about).inertia,
            }
            places = {name: replace(i, point=terms.point(name, self)) for name, i in interfaces.items()}
            interfaces = ByName("interface", places)
        rigid = np.zeros(self.rigid.shape[1])
        nominal: dict[str, Any] = dict.fromkeys(MISSING)
        here = replace(
            body,
            mass_matrix=self.M,
            stiffness_matrix=self.K,
            damping_matrix=self.D,
            frequencies_hz=np.concatenate([rigid, self.frequencies_hz]),
            full_frequencies_hz=None,
            damping_ratios=None,
            certificate=None,
            floating=floating,
            ranking=(),
            **nominal,
            recipe={**body.recipe, "at": self.values},
        )
        return replace(
            source,
            coordinates=self._coordinates(),
            interfaces=interfaces,
            bodies=ByName("body", {body.name: here}),
            **changed,
        )

    def frame_derivatives(self) -> dict[str, FloatingFrame]:
        """Derivatives of the floating frame of ``body`` by each parameter, in the fields of a frame, per unit of the
        parameter; the shapes of the elastic coordinates stay those of the modes at these values.

        Raises:
            InputError: a body without a floating frame, modal damping.
        """
        terms, known = self.parent.parts.frame, self.parent.stored.floating
        if terms is None or known is None:
            raise InputError(
                f"body {self.parent.stored.name} has no floating frame, whose derivatives were asked for",
                kind="unsupported",
            )
        return terms.derivatives(self, **_frame_of(known))

    @property
    def body(self) -> Body:
        """The body of these values."""
        return self.bodies.bodies[self.parent.stored.name]

    def _coordinates(self) -> Floats:
        """Places (N, 3) of the kept nodes."""
        box, coordinates = self.model.box, self.parent.source.coordinates
        for number in box.morphs:
            t = self.p[number] - box.nominal[number]
            coordinates = coordinates + t * self.parent.parts.displacement[box.names[number]]
        return coordinates

    def write(self, path: str | Path) -> Path:
        """Write an ordinary body file of these values, which every exporter and simulator takes.

        Raises:
            OutputError: the file cannot be written.
        """
        # Not at the top: what evaluates does not write as a rule.
        from morembs.body.write import write_stored

        return write_stored(path, self.bodies, self.body, self.parent.path)
