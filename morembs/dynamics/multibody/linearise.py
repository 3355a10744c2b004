"""Small motion of a system about a state of rest: matrices, modes, growth and state space.

In the motions Z that the joints allow (B Z = 0), y'' + Z'C Z y' + Z'K Z y = Z' f with Z'M Z = I, where K has the
geometric stiffness of gravity and of all reactions (Bauchau 2011, ch. 12).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sl

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Complexes, Floats
from morembs.base.units import eigenvalue_in_hz, in_hz
from morembs.dynamics.multibody.component import Marker
from morembs.dynamics.multibody.steady_spin import SteadySpin
from morembs.dynamics.multibody.system import State
from morembs.dynamics.multibody.tangents import pulls, stiffness_and_damping
from morembs.dynamics.multibody.tolerances import TOL
from morembs.exporters.ports import UNITS
from morembs.exporters.state_space import StateSpace
from morembs.linalg.eigen import accurate_eigh

MOTIONS = ("displacement", "velocity", "acceleration")
WORDS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearization:
    """A system about a ``state`` of rest, or of steady spin in the frame that turns with it, in the M-orthonormal
    ``motions`` Z (k, r) that its joints allow.

    ``K`` and ``C`` (r, r) are the stiffness and the damping there, where the mass matrix is the identity;
    ``stiffness`` (k, k) is that of all coordinates.
    """

    state: State
    motions: Floats
    stiffness: Floats
    K: Floats
    C: Floats

    @cached_property
    def squares(self) -> Floats:
        """(r,) squares of the circular frequencies (rad/s)2 without damping, ascending; negative where a motion grows,
        zero where nothing resists it. Of a stiffness that is not symmetric (loads that follow) its symmetric part."""
        Z, whole = self.motions, self.stiffness
        values, Y = accurate_eigh(0.5 * (self.K + self.K.T), projected=lambda y: (Z @ y).T @ whole @ (Z @ y))
        z = np.abs(Z @ Y)
        size = np.einsum("ij,ij->j", z, np.abs(whole) @ z)
        least = np.maximum(TOL.difference_roundoff * size, TOL.no_square * np.abs(values).max(initial=0.0))
        return np.where(np.abs(values) <= least, 0.0, values)

    @property
    def frequencies_hz(self) -> Floats:
        """(r,) frequencies without damping in Hz, zero for motions that grow or that nothing resists; of a system that
        spins those of its ``eigenvalues``, with Coriolis forces and damping."""
        if self.state.v.any():
            imaginary = self.eigenvalues.imag
            return np.asarray(in_hz(np.sort(imaginary)[len(imaginary) // 2 :]))
        return np.asarray(eigenvalue_in_hz(self.squares))

    @cached_property
    def eigenvalues(self) -> Complexes:
        """(2 r,) eigenvalues s in 1/s of the motion with damping, by their imaginary parts."""
        r = len(self.K)
        if not self.C.any() and self._symmetric:
            roots = np.sqrt(-self.squares.astype(complex))
            values = np.concatenate((roots, -roots))
        else:
            values = sl.eigvals(np.block([[np.zeros((r, r)), np.eye(r)], [-self.K, -self.C]]))
        return np.asarray(values[np.lexsort((values.real, values.imag))])

    @property
    def _symmetric(self) -> bool:
        off = np.abs(self.K - self.K.T).max(initial=0.0)
        return bool(off <= TOL.difference_asymmetry * np.abs(self.K).max(initial=0.0))

    @property
    def growth(self) -> float:
        """Largest rate 1/s at which a small disturbance grows, zero where none does.

        Damping cannot make a motion grow that stiffness keeps (Thomson and Tait), so squares decide where the
        stiffness is symmetric and the damping takes energy.
        """
        damping = 0.5 * (self.C + self.C.T)
        takes = sl.eigvalsh(damping)[0] >= -TOL.difference_roundoff * np.abs(damping).max() if len(damping) else True
        if self._symmetric and takes and self.squares.min(initial=0.0) >= 0:
            return 0.0
        fastest = np.abs(self.eigenvalues).max(initial=0.0)
        rate = float(self.eigenvalues.real.max(initial=0.0))
        return rate if rate > (TOL.steady_double_growth if self.state.v.any() else TOL.steady_growth) * fastest else 0.0

    def state_space(self, inputs: Mapping[str, Marker], outputs: Mapping[str, tuple[Marker, str]]) -> StateSpace:
        """State space with forces and moments on the markers of ``inputs`` and motions of those of ``outputs``.

        Each input has six columns (N, Nm along the inertial axes), each output six rows; ``outputs`` has the marker
        and "displacement", "velocity" or "acceleration". States are y and y'.

        Raises:
            InputError: an unknown motion, or a marker of another system.

        >>> from morembs.dynamics.multibody import RevoluteJoint, RigidBody, System, equilibrium, ground
        >>> system = System(gravity=(0, 0, -9.81))
        >>> rod = system.add(RigidBody(2.0, (0.1, 0.1, 0.01), position=(0, 0, -0.5), markers={"end": (0, 0, 0.5)}))
        >>> joint = system.add(RevoluteJoint(ground.marker_at(), rod.marker("end"), axis=(0, 1, 0)))
        >>> tip = rod.marker_at((0, 0, -0.5))
        >>> space = equilibrium(system).linear.state_space({"tip": tip}, {"tip": (tip, "displacement")})
        >>> space.A.shape, space.names["inputs"][0], space.units["outputs"][0]
        ((2, 2), 'tip:force:x', 'm')
        """
        r = len(self.K)
        A = np.block([[np.zeros((r, r)), np.eye(r)], [-self.K, -self.C]])
        loads = [self._motion(marker).T for marker in inputs.values()]
        B = np.vstack((np.zeros((r, 6 * len(loads))), np.hstack([np.zeros((r, 0)), *loads])))
        C, D = [np.zeros((0, 2 * r))], [np.zeros((0, B.shape[1]))]
        for name, (marker, motion) in outputs.items():
            if motion not in MOTIONS:
                raise InputError(
                    f"outputs: {name!r} has {motion!r}; expected one of {', '.join(MOTIONS)}",
                    kind="unknown",
                    keyword="outputs",
                )
            J, nothing = self._motion(marker), np.zeros((6, r))
            rows = {"displacement": np.hstack((J, nothing)), "velocity": np.hstack((nothing, J))}
            C.append(rows[motion] if motion in rows else J @ A[r:])
            D.append(np.zeros((6, B.shape[1])) if motion in rows else J @ B[r:])
        names, units = _names(inputs, outputs, r)
        return StateSpace(A=A, B=B, C=np.vstack(C), D=np.vstack(D), names=names, units=units)

    def _motion(self, marker: Marker) -> Floats:
        """(6, r) displacement and rotation of a marker per motion."""
        assembly = self.state.assembly
        i = assembly.index(marker.component)
        if i is None:
            raise InputError(
                f"{marker.label} is not in the system; expected a marker of one of its bodies", kind="unknown"
            )
        return np.asarray(assembly.place(marker, self.state.x).jacobian @ self.motions[assembly.in_v[i]])


@checked
def linearize(state: State, spin: SteadySpin | None = None) -> Linearization:
    """The small motion about a ``state`` of rest, or of steady ``spin`` in the frame that turns with it.

    Args:
        state: of rest, or of steady spin.
        spin: None for a state of rest.

    Raises:
        InputError: a state that moves otherwise.
    """
    a = state.assembly
    if spin is None and state.v.any():
        raise InputError("the state moves; expected one of rest, such as that of an equilibrium", keyword="state")
    M, _, _, B = a.equations(state.time, state.x, state.v)
    L = np.linalg.cholesky(M)
    allowed = _null_space(sl.solve_triangular(L, B.T, lower=True).T)
    Z = sl.solve_triangular(L, allowed, lower=True, trans="T")
    if spin is None:
        rest = state.v, state.acceleration, state.multipliers
        K, C = stiffness_and_damping(a, state.time, state.x, *rest, known=pulls(a, state))
    else:
        K, C = spin.tangents(a, state.time, state.x, state.multipliers)
    return Linearization(state=state, motions=Z, stiffness=K, K=Z.T @ K @ Z, C=Z.T @ C @ Z)


def _null_space(B: Floats) -> Floats:
    """Orthonormal (k, r) with B times it zero, rows of B (m, k) equilibrated."""
    norms = np.linalg.norm(B, axis=1)
    _, s, Vt = np.linalg.svd(B / np.where(norms > 0, norms, 1.0)[:, None], full_matrices=True)
    rank = int((s > TOL.dependent_joints * s.max(initial=0.0)).sum())
    return np.asarray(Vt[rank:].T)


def _names(
    inputs: Mapping[str, Marker], outputs: Mapping[str, tuple[Marker, str]], r: int
) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """Names and units of states, inputs and outputs, as those of bodies have them."""
    signals = {"inputs": [(name, "force") for name in inputs], "outputs": [(n, m) for n, (_, m) in outputs.items()]}
    names = {key: tuple(f"{name}:{kind}:{word}" for name, kind in of for word in WORDS) for key, of in signals.items()}
    units = {key: tuple(UNITS[kind][k > 2] for _, kind in of for k in range(6)) for key, of in signals.items()}
    kinds = ("coordinate", "m kg1/2"), ("rate", "m kg1/2/s")
    names["states"] = tuple(f"{kind} {k + 1}" for kind, _ in kinds for k in range(r))
    units["states"] = tuple(unit for _, unit in kinds for _ in range(r))
    return names, units
