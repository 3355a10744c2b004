"""Craig and Bampton 1968: V = [constraint modes, fixed-interface modes].

Both kinds are K-orthogonal, so K_r = blockdiag(condensed stiffness, eigenvalues) is known exactly and
its six zeros are not blurred by projecting. With an average coupling the boundary is z = T u, which
constrains the patch only in the mean.

With ``inertia_modes`` the deformation under the inertia of the constraint modes, K_ii^-1 M psi, joins the
basis (quasi-static mode compensation, Shyu, Ma and Hulbert 1997): what the cut fixed-interface modes
would have contributed at low frequency. It usually lowers the errors by orders of magnitude.

With many interface dofs, characteristic modes take the place of the constraint modes (``interface_modes``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import InputError
from morembs.base.limits import Count, PositiveHertz
from morembs.problem import Problem
from morembs.reducers.base import Basis, add_residual_modes
from morembs.reducers.families import OfModes, square_frequency
from morembs.reducers.interface_modes import FixedInterfaceBody, interface_modes, static_error
from morembs.reducers.problem_summary import ProblemSummary


@dataclass(frozen=True, kw_only=True)
class CraigBampton(OfModes):
    """Interface dofs stay coordinates, fixed-interface modes are the internal ones.

    Args:
        modes: number of internal coordinates; this or ``up_to_hz``.
        up_to_hz: all fixed-interface modes up to this frequency, two to three times the band of interest.
        inertia_modes: add one inertia mode for each interface degree of freedom. ``modes`` includes them, ``up_to_hz``
            does not. Their kind is "attachment".
        interface_modes: number of elastic characteristic modes of the interfaces. They replace the constraint modes,
            together with the rigid-body modes; ``inertia_modes`` then adds one mode for each of these. Statics at the
            interfaces are then approximate; the recipe states the error.
        interface_up_to_hz: use all characteristic modes up to this frequency, in place of ``interface_modes``.

    Raises:
        InputError: both limits of the interfaces were given, or one out of range.

    >>> CraigBampton(modes=6).reduce(problem).order                 # and 12 coordinates of the two interfaces
    18
    """

    method: ClassVar[str] = "craig-bampton"
    inertia_modes: bool = False
    interface_modes: Count | None = None
    interface_up_to_hz: PositiveHertz | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.interface_modes is not None and self.interface_up_to_hz is not None:
            raise InputError(
                "interface_modes and interface_up_to_hz were both given; choose one",
                kind="conflict",
                keyword="interface_modes",
            )

    @property
    def reduces_interfaces(self) -> bool:
        """True if characteristic modes replace the constraint modes."""
        return self.interface_modes is not None or self.interface_up_to_hz is not None

    @property
    def takes_unsymmetric(self) -> bool:
        return True

    def why_not(self, facts: ProblemSummary) -> str:
        reason = super().why_not(facts)
        if not reason and (self.interface_modes or 0) > facts.inputs:
            return (
                f"interface_modes = {self.interface_modes} was given, but there are only {facts.inputs} interface "
                "degrees of freedom; ask for fewer"
            )
        if not reason and not self.reduces_interfaces:
            return self._why_not_inertia(facts.inputs, "interface dof")
        return reason

    def _basis(self, problem: Problem) -> Basis:
        if self.reduces_interfaces:
            return self._on_few(problem)
        below, inputs = self.below, problem.B.shape[1]
        count = self._beside_inertia(inputs, "interface dof")
        fixed = problem.fixed_modes(count=count, below=below)
        constraint, condensed = problem.constraint_modes()
        V = problem.space.hstack(constraint, fixed.vectors)
        constraint = V[:, :inputs]
        problem.keep_constraint_modes(constraint, condensed)
        basis = Basis(
            V=V,
            kinds=("constraint",) * inputs + ("fixed-interface",) * len(fixed.eigenvalues),
            K=sl.block_diag(condensed, np.diag(fixed.eigenvalues)),
            # Rigid motion is that of the interfaces, without any internal coordinate.
            rigid=np.vstack([problem.B.T @ problem.rigid, np.zeros((fixed.vectors.shape[1], problem.rigid.shape[1]))]),
            holds_interfaces=True,
        )
        # All that moves inside is there already where no mode is left out.
        if not self.inertia_modes or np.isinf(fixed.verified_below):
            return basis
        deformation = problem.fixed_interface.deformation(problem.M @ constraint, problem.M)
        return add_residual_modes(problem, basis, deformation, fixed.vectors)

    def _on_few(self, problem: Problem) -> Basis:
        """Rigid-body, characteristic and fixed-interface modes: all K-orthogonal."""
        r = problem.rigid.shape[1]
        with FixedInterfaceBody(problem) as fixed_body:
            interface_shapes = interface_modes(
                problem, fixed_body, count=self.interface_modes, below=square_frequency(self.interface_up_to_hz)
            )
            k = r + len(interface_shapes.eigenvalues)
            count = self._beside_inertia(k, "rigid-body and characteristic mode")
            fixed = fixed_body.modes(count, self.below)
            m = len(fixed.eigenvalues)
            notes: dict[str, object] = {"interface_motions": problem.B.shape[1], "characteristic_modes": k - r}
            if interface_shapes.next_hz is not None:
                lost = static_error(problem, fixed_body, interface_shapes)
                notes["next_characteristic_hz"] = interface_shapes.next_hz
                notes["interface_static_error"] = lost
                notes["statics"] = (
                    f"not exact at the interfaces: up to {lost:.1e} of the compliance under resultant loads is "
                    "missing, and more under loads that vary within an interface"
                )
            basis = Basis(
                V=problem.space.hstack(problem.rigid, interface_shapes.vectors, fixed.vectors),
                kinds=("rigid",) * r + ("characteristic",) * (k - r) + ("fixed-interface",) * m,
                K=np.diag(np.concatenate([np.zeros(r), interface_shapes.eigenvalues, fixed.eigenvalues])),
                rigid=np.eye(k + m, r),
                notes=notes,
            )
            if not self.inertia_modes:
                return basis
            deformation = fixed_body.flexibility(problem.M @ basis.V[:, :k])
            return replace(add_residual_modes(problem, basis, deformation, fixed.vectors), notes=notes)

    def _beside_inertia(self, inertia: int, what: str) -> int | None:
        """How many of ``modes`` are left for fixed-interface modes."""
        if not self.inertia_modes or self.modes is None:
            return self.modes
        reason = self._why_not_inertia(inertia, what)
        if reason:
            raise InputError(reason, keyword="modes")
        return self.modes - inertia

    def _why_not_inertia(self, inertia: int, what: str) -> str:
        """Why ``modes`` have no room for ``inertia`` of them."""
        if not self.inertia_modes or self.modes is None or self.modes >= inertia:
            return ""
        return f"modes = {self.modes} was given with inertia_modes; expected at least {inertia}, one for each {what}"
