"""Reduced bodies as state space: forces and the motion of supports in, motions and reactions out.

With C_b q = x_b for the degrees of freedom that supports prescribe, q = X x_b + N e, C_b X = 1, C_b N = 0. The equation
of motion tested with W, B_b' W = 0, is that of e; tested with Y, B_b' Y = 1, it gives the reactions. X and Y are static
or, where the supports just hold the body, rigid. No large mass is added, which would cost digits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.body.stored import StoredBodies, choose_body
from morembs.exporters.ports import Port, parts_of, ports_of_body, ports_of_file, refuse_loose
from morembs.exporters.reduced import held_and_free
from morembs.exporters.tolerances import TOL
from morembs.linalg.dense import symmetric
from morembs.linalg.eigen import accurate_eigh
from morembs.linalg.massless import CURE, split_massless
from morembs.problem.damping import frequency_domain_only
from morembs.reducers.base import ReducedModel

# Quantity and row of each degree of freedom that was named.
Named = Sequence[tuple[str, int]]
INPUTS, OUTPUTS = ("force", "acceleration", "displacement"), ("displacement", "velocity", "acceleration", "reaction")


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class StateSpace:
    """x' = A x + B u, y = C x + D u; with a step ``dt`` in s x(t + dt) instead of x'.

    ``A`` (n, n), ``B`` (n, m), ``C`` (p, n), ``D`` (p, m). ``names`` and ``units`` have a text for each of "states",
    "inputs" and "outputs".

    >>> body_space = state_space(body, ["LEFT:acceleration:z"], ["RIGHT:acceleration:z"], held=["LEFT"])
    >>> body_space.names["outputs"], body_space.units["outputs"]
    (('RIGHT:acceleration:z',), ('m/s2',))
    """

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    names: Mapping[str, tuple[str, ...]]
    units: Mapping[str, tuple[str, ...]]
    dt: float = 0.0

    def _facts(self) -> dict[str, object]:
        return {
            "states": len(self.A),
            "inputs": list(self.names["inputs"]),
            "outputs": list(self.names["outputs"]),
            "step": f"{self.dt:g} s" if self.dt else None,
        }

    def discrete(self, step: float) -> StateSpace:
        """The same at multiples of ``step`` in s, exact for inputs that are constant between them (zero-order hold).

        Raises:
            InputError: a step that is not positive, or a system that has one already.
        """
        if not (np.isfinite(step) and step > 0) or self.dt:
            raise InputError(
                f"step = {step} s was given; expected a positive one, of a system in continuous time", keyword="step"
            )
        # Not at the top: it takes longer than most exports.
        from scipy.signal import cont2discrete

        A, B, C, D, _ = cont2discrete((self.A, self.B, self.C, self.D), step, "zoh")
        return StateSpace(A=A, B=B, C=C, D=D, names=self.names, units=self.units, dt=float(step))

    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A (n,), in rad/s, by size; with a step those of x(t + dt) from x(t)."""
        values = np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)
        return values[np.lexsort((values.imag, np.abs(values)))]

    def dc_gain(self) -> Floats | None:
        """Outputs (p, m) under constant unit inputs at rest; None for a system that integrates."""
        still = np.eye(len(self.A)) if self.dt else 0.0
        try:
            with np.errstate(all="raise"):
                return np.asarray(self.D + self.C @ np.linalg.solve(still - self.A, self.B))
        except (np.linalg.LinAlgError, FloatingPointError):
            return None


def state_space(
    body: Body | StoredBodies,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    held: Sequence[str] = (),
    name: str | None = None,
) -> StateSpace:
    """State space of a body, in SI units.

    Args:
        body: an elastic body, or what ``read_body`` gave, and then the ``name`` of one where there are several.
        inputs: such as "tip:force" or "base:acceleration:z": interface, quantity and, unless all are meant, components
            (x, y, z, rx, ry, rz, names of generalised forces) with + between them. The interface of "acceleration" and
            "displacement" is a support with prescribed motion. A displacement is three inputs: ``x``, ``v`` and ``a``
            are the displacement and its derivatives, which no state space of finite order can take from it.
        outputs: likewise, "displacement", "velocity", "acceleration", and "reaction", the force of a support on the
            body.
        held: interfaces, or "base:x+y" some of their components, that stay at rest.

    Raises:
        InputError: a name that there is not, supports that leave a rigid-body motion or depend on each other, a
            support that is loaded, the reaction of what is none, or a body with structural damping.

    >>> state_space(body, ["RIGHT:force"], ["RIGHT:displacement", "LEFT:reaction"], held=["LEFT"])
    StateSpace: states 24; inputs 6 of them; outputs 12 of them
    """
    if isinstance(body, Body):
        reduced, recipe, ports = body.reduced, body.recipe, ports_of_body(body)
    else:
        stored = choose_body(body, name)
        reduced, recipe, ports = stored.reduced, stored.recipe, ports_of_file(body)
    if reduced.symmetric and split_massless(reduced.K, reduced.M) is not None:
        raise InputError(
            f"some coordinates of body {reduced.name!r} have no mass, and x' = A x + B u needs mass on each; {CURE}",
            kind="unsupported",
            keyword="mass",
        )
    reason = frequency_domain_only(recipe)
    if reason:
        raise InputError(f"body {reduced.name!r}: {reason}", kind="unsupported")
    return state_space_of(reduced, ports, inputs, outputs, held)


def state_space_of(
    reduced: ReducedModel, ports: Sequence[Port], inputs: Sequence[str], outputs: Sequence[str], held: Sequence[str]
) -> StateSpace:
    """``state_space`` of a reduced model with mass on each coordinate.

    Raises:
        InputError: as there.
    """
    wanted, supports = signals(ports, inputs, outputs, held)
    if supports and reduced.rigid_count:
        refuse_loose(ports, sorted(supports), reduced.C @ reduced.modes()[1][:, : reduced.rigid_count])
    return _assemble(reduced, ports, wanted, supports)


def signals(
    ports: Sequence[Port], inputs: Sequence[str], outputs: Sequence[str], held: Sequence[str]
) -> tuple[dict[str, Named], dict[int, str]]:
    """What ``inputs`` and ``outputs`` name, and the motion of each degree of freedom that does not move freely.

    Raises:
        InputError: as ``state_space``.
    """
    if isinstance(held, str):
        raise InputError(f'held = {held!r} was given; expected a list such as ["base"]', keyword="held")
    wanted = {"inputs": _choose(ports, inputs, INPUTS, "input"), "outputs": _choose(ports, outputs, OUTPUTS, "output")}
    return wanted, _supports(ports, wanted, [row for text in held for row in parts_of(ports, text, ("",), "held")[1]])


def _choose(ports: Sequence[Port], texts: Sequence[str], known: tuple[str, ...], what: str) -> Named:
    """Quantity and row of each degree of freedom that ``texts`` name."""
    if isinstance(texts, str) or not texts:
        raise InputError(f'{what}s = {texts!r} was given; expected a list such as ["tip:{known[0]}"]', keyword="s")
    parts = [parts_of(ports, text, known, what) for text in texts]
    chosen = [(quantity, row) for quantity, rows in parts for row in rows]
    for quantity, row in chosen:
        if chosen.count((quantity, row)) > 1:
            raise InputError(
                f"{ports[row].name(quantity)} was given twice as {what}; give it once", kind="conflict", keyword=what
            )
    return chosen


def _supports(ports: Sequence[Port], wanted: Mapping[str, Named], held: Sequence[int]) -> dict[int, str]:
    """Row of each degree of freedom that does not move freely -> what its motion is: held, displacement, acceleration.

    Raises:
        InputError: two motions of one, a load on one, or the reaction of another.
    """
    supports: dict[int, str] = dict.fromkeys(held, "held")
    for quantity, row in wanted["inputs"]:
        if quantity != "force":
            if row in supports:
                first, second = ports[row].name(supports[row]), ports[row].name(quantity)
                if supports[row] != "held":
                    raise InputError(
                        f"{first} and {second} were given; a support has one motion, take one of them",
                        kind="conflict",
                        keyword="inputs",
                    )
            supports[row] = quantity
    for quantity, row in wanted["inputs"]:
        if quantity == "force" and row in supports:
            raise InputError(
                f"{ports[row].name('force')} was given, but a support prescribes that motion; leave the force out, or "
                "the component out of the support",
                kind="conflict",
                keyword="inputs",
            )
    for quantity, row in wanted["outputs"]:
        if quantity == "reaction" and row not in supports:
            raise InputError(
                f"{ports[row].name('reaction')} was given, but nothing holds it; name its motion as an input, "
                f"{ports[row].name('acceleration')}, or the interface in held",
                keyword="outputs",
            )
    return supports


@dataclass(frozen=True, kw_only=True, eq=False)
class _Held:
    """Prescribed and free motions of a body, and what the equations of both are tested with."""

    X: Floats
    N: Floats
    W: Floats
    Y: Floats
    mass: Floats
    stiffness: Floats
    KX: Floats

    @classmethod
    def of(cls, reduced: ReducedModel, rows: Sequence[int]) -> _Held:
        K, M, same = reduced.K, reduced.M, reduced.symmetric and np.array_equal(reduced.C, reduced.B.T)
        if not rows:
            X = Y = np.zeros((len(K), 0))
            N = W = np.eye(len(K))
        else:
            X, N, _ = held_and_free(reduced.C[rows], reduced.name)
            Y, W, _ = (X, N, True) if same else held_and_free(reduced.B[:, rows].T, reduced.name)
        if same:
            values, modes = accurate_eigh(symmetric(N.T @ K @ N), symmetric(N.T @ M @ N))
            values[: 0 if rows else reduced.rigid_count] = 0.0
            N = W = N @ modes
            mass, stiffness = np.eye(len(values)), np.diag(values)
            if rows:
                X = Y = X - N @ ((N.T @ K @ X) / values[:, None])
        else:
            mass, stiffness = W.T @ M @ N, W.T @ K @ N
            if rows:
                X = X - N @ np.linalg.solve(stiffness, W.T @ K @ X)
        # As many supports as rigid-body motions strain nothing: that is known without round-off.
        KX = np.zeros_like(X) if len(rows) == reduced.rigid_count else K @ X
        return cls(X=X, N=N, W=W, Y=Y, mass=mass, stiffness=stiffness, KX=KX)


def _assemble(
    reduced: ReducedModel, ports: Sequence[Port], wanted: Mapping[str, Named], supports: Mapping[int, str]
) -> StateSpace:
    """Every signal is a row over [states; inputs]; states are those of moving supports, then of the free motion."""
    rows = sorted(supports)
    body = _Held.of(reduced, rows)
    X, N, W, Y = body.X, body.N, body.W, body.Y
    M, K, D, B, C = reduced.M, reduced.K, reduced.D, reduced.B, reduced.C
    moving = [row for row in rows if supports[row] == "acceleration"]
    inputs, n, k = _input_names(ports, wanted["inputs"]), N.shape[1], len(moving)
    states = 2 * (k + n)
    signal = np.eye(states + len(inputs))
    column = {key: states + at for at, (key, *_) in enumerate(inputs)}
    x, v, a = (np.zeros((len(rows), states + len(inputs))) for _ in range(3))
    for at, row in enumerate(rows):
        if supports[row] == "acceleration":
            place = moving.index(row)
            x[at], v[at], a[at] = signal[place], signal[k + place], signal[column["acceleration", row]]
        elif supports[row] == "displacement":
            x[at], v[at], a[at] = (signal[column[key, row]] for key in ("x", "v", "a"))
    loaded = [row for quantity, row in wanted["inputs"] if quantity == "force"]
    F = B[:, loaded] @ signal[[column["force", row] for row in loaded]]
    e, de = signal[2 * k : 2 * k + n], signal[2 * k + n : states]
    DX = _without_round_off(D, X)
    # X is static, so that its stiffness couples to no free motion of a symmetric body.
    load = F - M @ X @ a - DX @ v
    dde = np.linalg.solve(body.mass, W.T @ load - W.T @ D @ N @ de - body.stiffness @ e)
    reaction = Y.T @ (M @ (N @ dde) + D @ (N @ de) + K @ (N @ e) + body.KX @ x - load)
    q, dq, ddq = X @ x + N @ e, X @ v + N @ de, X @ a + N @ dde
    motion = {"displacement": C @ q, "velocity": C @ dq, "acceleration": C @ ddq}
    output = np.array(
        [
            reaction[rows.index(row)] if quantity == "reaction" else motion[quantity][row]
            for quantity, row in wanted["outputs"]
        ]
    )
    derivative = np.vstack([signal[k : 2 * k], a[[rows.index(row) for row in moving]], de, dde])
    pairs = [(ports[row], quantity) for quantity in ("displacement", "velocity") for row in moving]
    state_names = [(port.name(quantity), port.unit(quantity)) for port, quantity in pairs]
    state_names += [(f"{mark}q{i + 1}", "") for mark in ("", "d") for i in range(n)]
    kept = _observe(derivative, output, k)
    return StateSpace(
        A=derivative[np.ix_(kept, kept)],
        B=derivative[kept, states:],
        C=output[:, kept],
        D=output[:, states:],
        names={
            "states": tuple(state_names[i][0] for i in kept),
            "inputs": tuple(name for _, name, _ in inputs),
            "outputs": tuple(ports[row].name(quantity) for quantity, row in wanted["outputs"]),
        },
        units={
            "states": tuple(state_names[i][1] for i in kept),
            "inputs": tuple(unit for *_, unit in inputs),
            "outputs": tuple(ports[row].unit(quantity) for quantity, row in wanted["outputs"]),
        },
    )


def _input_names(ports: Sequence[Port], wanted: Named) -> list[tuple[tuple[str, int], str, str]]:
    """Key, name and unit of each input; a displacement has three."""
    result = []
    for quantity, row in wanted:
        if quantity == "displacement":
            for key, word in (("x", "displacement"), ("v", "velocity"), ("a", "acceleration")):
                result.append(((key, row), ports[row].name(word), ports[row].unit(word)))
        else:
            result.append(((quantity, row), ports[row].name(quantity), ports[row].unit(quantity)))
    return result


def _without_round_off(D: Floats, X: Floats) -> Floats:
    """D X, nothing where rigid motion is damped by round-off only."""
    DX = D @ X
    terms = (np.abs(D) @ np.abs(X)).max(axis=0, initial=0.0)
    DX[:, np.abs(DX).max(axis=0, initial=0.0) <= TOL.rigid_damping * terms] = 0.0
    return np.asarray(DX)


def _observe(derivative: Floats, output: Floats, moving: int) -> list[int]:
    """States without the places, then the velocities, of supports that nothing depends on."""
    states = len(derivative)
    kept = list(range(states))
    for at in range(2 * moving):
        others = [row for row in kept if row != at]
        if not derivative[others, at].any() and not output[:, at].any():
            kept = others
    return kept
