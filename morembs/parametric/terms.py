"""The coupled problem of a model with parameters: the affine terms in coupled dofs, and problems at other values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.fem import FEModel, skew
from morembs.fem.assembly import mass_matrix
from morembs.fem.interface import Interface, couple
from morembs.linalg.congruence import congruence
from morembs.linalg.dense import symmetric
from morembs.parametric.added import with_springs
from morembs.parametric.law import Law
from morembs.parametric.parameter import DAMPING
from morembs.parametric.tolerances import TOL
from morembs.parametric.varied import VariedModel, varied_model
from morembs.problem import Problem
from morembs.problem.damping import Damping


class AffineProblem(Problem):
    """The coupled problem at nominal values of parameters, with the terms of which all others of its box are sums.

    ``K_terms``, ``M_terms`` (Nc, Nc) and ``law_K``, ``law_M`` give K(p) and M(p); B and the coupling are one for all.
    Beside ``output``, the body file that is to be written, searches keep their steps. ``rigid_terms`` (Nc, 6, 1 +
    morphs): the geometric rigid motions are R0 + sum_i t_i R_i, about a fixed pole.

    >>> with AffineProblem(varied, interfaces) as problem:
    ...     problem.at(problem.box.point({"E": 2e11})).K.shape
    (48, 48)
    """

    def __init__(
        self,
        varied: VariedModel,
        interfaces: Sequence[Interface] = (),
        *,
        damping: Damping | None = None,
        model: FEModel | None = None,
        output: Path | None = None,
        **options: Any,
    ) -> None:
        nominal = varied.box.nominal
        bare, varied = varied, with_springs(varied, interfaces)
        model = varied.model(nominal) if model is None or varied is not bare else model
        self.output = output
        self.varied, self.box, self.parameters = varied, varied.box, varied.parameters
        _refuse_bent(varied, interfaces)
        for parameter in self.parameters if damping is not None and damping.is_modal else ():
            if parameter.kind in DAMPING:
                raise InputError(
                    f"parameter {parameter.name} ({parameter.kind}) was given beside modal damping; expected rayleigh "
                    "or structural in [damping], or no such parameter",
                    kind="conflict",
                )
        given = self.box.damping(damping or Damping(), nominal)
        super().__init__(model, interfaces, damping=given, **options)
        self._bare = bare
        if "spring" in self.box.kinds:
            self._refuse_lost()

    @property
    def law_K(self) -> Law:
        """Coefficients a_q(p) of the stiffness."""
        return self.varied.law_K

    @property
    def law_M(self) -> Law:
        """Coefficients b_j(p) of the mass."""
        return self.varied.mass.law

    @cached_property
    def K_terms(self) -> tuple[sp.csr_array, ...]:
        """The terms K_q (Nc, Nc), each on the pattern of its own elements."""
        return tuple(self.stiffness_sum(theta) for theta in np.eye(len(self.law_K.factors)))

    @cached_property
    def M_terms(self) -> tuple[sp.csr_array, ...]:
        """The terms M_j (Nc, Nc)."""
        return tuple(self.mass_sum(theta) for theta in np.eye(len(self.varied.mass)))

    def stiffness_sum(self, theta: Floats) -> sp.csr_array:
        """sum_q theta_q K_q (Nc, Nc) for any coefficients (Q,)."""
        with self.budget.in_use():
            return self._couple_terms(self.varied.stiffness_sum(theta))

    def mass_sum(self, theta: Floats) -> sp.csr_array:
        """sum_j theta_j M_j (Nc, Nc) for any coefficients (J,)."""
        with self.budget.in_use():
            return self._couple_terms(mass_matrix(self.varied.graph, self.varied.mass.combine(theta)))

    def _couple_terms(self, A: sp.csr_array) -> sp.csr_array:
        A.eliminate_zeros()
        T = self.coupling.T
        return A if T.shape[0] == T.shape[1] else congruence(T, A)

    @property
    def eps(self) -> float:
        """(1 - eps) x'Kx <= x'K~x <= (1 + eps) x'Kx for the assembled K and the sum K~ of the terms, at all values."""
        return self.varied.eps

    @property
    def morphs(self) -> tuple[int, ...]:
        """Numbers of the parameters that are morphs."""
        return self.box.morphs

    @cached_property
    def rigid_terms(self) -> Floats:
        """(Nc, 6, 1 + morphs): R(p) = R0 + sum_i t_i R_i over the morphs i in the order of the parameters.

        Geometric rigid motions as of ``coupling.R``, with rotations about the pole of nominal values at all of them.
        """
        nominal, terms = self.box.nominal, []
        for number in self.morphs:
            p = nominal.copy()
            p[number] = self.box.high[number] if nominal[number] < self.box.high[number] else self.box.low[number]
            moved = couple(self.varied.outline(p), self.interfaces_at(p))
            shift = np.eye(6)
            shift[:3, 3:] = skew(self.coupling.pole - moved.pole)
            terms.append((moved.R @ shift - self.coupling.R) / (p[number] - nominal[number]))
        constant = self.coupling.R - sum(nominal[i] * R for i, R in zip(self.morphs, terms, strict=True))
        return np.stack([constant, *terms], axis=-1)

    def _refuse_lost(self) -> None:
        """Refuse springs that are too soft beside the elements, whose strain by rigid motion is round-off, not zero.

        Raises:
            InputError: in these cases.
        """
        theta, own = self.law_K(self.box.low), len(self.varied.stiffness)
        added = np.arange(len(theta)) >= own
        elements, springs = (self.stiffness_sum(np.where(chosen, theta, 0.0)) for chosen in (~added, added))
        # A morph moves nodes: rigid motion is that of the geometry of these values.
        R = self.rigid_at(self.box.low)
        R = R / np.sqrt(np.einsum("ij,ij->j", R, self.M @ R))
        values, Z = sl.eigh(symmetric(R.T @ (springs @ R)), symmetric(R.T @ (self.M @ R)))
        free = self.rigid.shape[1]
        Z = R @ Z[:, free:] / np.sqrt(values[free:])
        lost = float(np.abs(np.linalg.eigvalsh(symmetric(Z.T @ (elements @ Z)))).max(initial=0.0))
        # What is taken for free although a spring holds it.
        if (values[:free] > TOL.same_place * (np.abs(R).T @ (abs(springs) @ np.abs(R))).max()).any():
            lost = 1.0
        if not lost <= TOL.lost_hold:
            raise InputError(
                f"springs hold the body so softly that round-off of the stiffness of its elements is {lost:.1e} of "
                f"theirs; expected {TOL.lost_hold:.0e} at most: make them stiffer, or leave them out, and the body is "
                "free",
                kind="model",
                keyword="stiffness",
            )

    @cached_property
    def loose(self) -> Problem | None:
        """The body without its springs, where these alone hold it and a morph changes what its rigid motions are.

        Rigid motion of other values strains the elements of nominal ones, far more than soft springs do.
        """
        if not (self.morphs and "spring" in self.box.kinds) or self.rigid.shape[1]:
            return None
        with self.budget.in_use():
            free = Problem(self._bare.model(self.box.nominal), self.interfaces, solver=self.solver)
        if free.rigid.shape[1] == 6:
            return free
        free.close()
        return None

    def close(self) -> None:
        if self.__dict__.get("loose") is not None:
            self.__dict__.pop("loose").close()
        super().close()

    def rigid_at(self, p: Floats) -> Floats:
        """R(p) (Nc, 6) of ``rigid_terms``."""
        return self.box.affine(self.rigid_terms, p)

    def damping_at(self, p: Floats) -> Damping:
        """The damping at ``p`` (P,)."""
        return self.box.damping(self.damping, p)

    def at(self, p: Floats, *, assembled: bool = False) -> Problem:
        """The problem at ``p`` (P,), K and M being sums of the terms, or ``assembled`` by direct integration."""
        with self.budget.in_use():
            model = (self.varied.assemble_at if assembled else self.varied.model)(p)
            return Problem(model, self.interfaces_at(p), solver=self.solver, damping=self.damping_at(p))

    def interfaces_at(self, p: Floats) -> tuple[Interface, ...]:
        """The interfaces at ``p`` (P,), which a morph moves along."""
        away = self.varied.morph.positions(p) - self.varied.morph.positions(self.box.nominal)
        return tuple(replace(each, point=each.point + away[each.nodes[0]]) for each in self.interfaces)


def _refuse_bent(varied: VariedModel, interfaces: Sequence[Interface]) -> None:
    """Refuse morphs that do not move an interface by one translation.

    Raises:
        InputError: in these cases.
    """
    morph = varied.morph
    size = float(np.ptp(morph.mesh.nodes.xyz, axis=0).max())
    for number, d in zip(morph.which, morph.displacements, strict=True):
        parameter = varied.parameters[number]
        largest = max(abs(parameter.low), abs(parameter.high))
        for interface in interfaces:
            spread = float(np.linalg.norm(np.ptp(d[interface.nodes], axis=0))) * largest
            if spread > TOL.same_place * size:
                raise InputError(
                    f"parameter {parameter.name} moves the nodes of interface {interface.name} by different "
                    f"displacements (up to {1e3 * spread:.3g} mm apart); a morph may only translate an interface",
                    kind="unsupported",
                    keyword="displacement",
                )


__all__ = ["AffineProblem", "VariedModel", "varied_model"]
