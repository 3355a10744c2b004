#!/usr/bin/env python3
"""A flexible arm that follows a planned turn: feedforward from the moments of a reduced body (Gorius).

The transfer function from the moment at the hub to the angle of the tip is 1 / (s2 (a0 + a1 s2 + a2 s4 + ...)); the
moment that moves the tip along y is a0 y'' + a1 y'''' + ..., of which a Krylov body about 0 Hz gives as many terms as
it matches moments. Draws feedforward.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from common import Curve, Floats, Panel, draw, parse
from numpy.polynomial import Polynomial
from scipy.signal import lsim

import morembs
from morembs.fem import DofMap, FEModel, Nodes

LENGTH, WIDTH, HEIGHT, HUB = 1.0, 0.04, 0.004, 0.05  # m, m, m, kg m2
YOUNG, DENSITY, DAMPING = 7e10, 2700.0, 0.005
TURN, DURATION = 1.0, 1.0  # rad, s
SMOOTH = 10  # derivatives that vanish at both ends of the turn


def arm(elements: int) -> FEModel:
    """Beam elements in a plane from a hub, where it only turns; displacement y and rotation z at each node."""
    h, EI, mass = LENGTH / elements, YOUNG * WIDTH * HEIGHT**3 / 12, DENSITY * WIDTH * HEIGHT
    k = (
        EI
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h * h, -6 * h, 4 * h * h],
            ]
        )
    )
    m = (
        mass
        * h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
            ]
        )
    )
    K, M = (np.zeros((2 * elements + 2,) * 2) for _ in range(2))
    for e in range(elements):
        at = slice(2 * e, 2 * e + 4)
        K[at, at] += k
        M[at, at] += m
    M[1, 1] += HUB
    xyz = np.column_stack([np.linspace(0, LENGTH, elements + 1), *np.zeros((2, elements + 1))])
    keep = np.arange(1, 2 * elements + 2)
    return FEModel(
        K=sp.csr_array(K[1:, 1:]),
        M=sp.csr_array(M[1:, 1:]),
        nodes=Nodes(ids=np.arange(1, elements + 2), xyz=xyz),
        dofs=DofMap(node=keep // 2, component=np.where(keep % 2, 5, 1)),
    )


def coefficients(body: morembs.ReducedModel, terms: int) -> Floats:
    """a (terms,) of 1 / (s2 H) = a0 + a1 s2 + ... for the first input and the second output of a body."""
    squares, shapes = body.modes()
    gains = np.prod(body.B.T[:2] @ shapes, axis=0)
    rigid, (w2, g) = gains[: body.rigid_count].sum(), (a[body.rigid_count :] for a in (squares, gains))
    # s2 H = rigid + s2 sum g / (w2 + s2), as a series in s2.
    series = np.array([rigid, *(-((-1.0) ** k) * (g / w2**k).sum() for k in range(1, terms))])
    a = np.zeros(terms)
    for k in range(terms):
        a[k] = (float(k == 0) - series[1 : k + 1] @ a[:k][::-1]) / series[0]
    return a


def planned() -> Polynomial:
    """The turn over time, a polynomial whose derivatives up to ``SMOOTH`` vanish at both ends."""
    rate = Polynomial([0, 1]) ** SMOOTH * Polynomial([1, -1]) ** SMOOTH
    turn = rate.integ()
    return (turn * (TURN / turn(1.0)))(Polynomial([0, 1 / DURATION]))


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    model = arm(8)
    hub = morembs.make_interface(model, name="hub", nodes=np.array([0]), coupling="direct")
    tip = morembs.make_interface(model, name="tip", nodes=np.array([8]), coupling="direct", components=[1])
    with morembs.Problem(model, [hub, tip], damping=morembs.Damping(modal=DAMPING)) as problem:
        short = morembs.Krylov(shifts_hz=[0.0], moments=2, inputs=["hub"]).reduce(problem)
        all_modes = morembs.Modal(modes=model.size - 1).reduce(problem)
        full = morembs.elastic_body(problem, all_modes, morembs.make_part(problem, nodes="interfaces"))
        exact = coefficients(full.reduced, 4)
        motion = morembs.state_space(full, ["hub:force"], ["tip:displacement"])
        print(
            "first frequencies: "
            + ", ".join(f"{f:.4f}" for f in np.sqrt(full.reduced.modes()[0][1:3]) / 2 / np.pi)
            + " Hz"
        )
    a, turn = coefficients(short, 4), planned()
    print(f"Krylov body of order {len(short.M)}: " + "  ".join(f"a{k} = {value:.6g}" for k, value in enumerate(a)))
    print(f"largest difference from the moments of all {model.size} dofs: {np.abs(a / exact - 1).max():.1e}")
    time = np.linspace(0, 1.5 * DURATION, 1501 if options.quick else 6001)
    moving = time <= DURATION
    wanted = np.where(moving, turn(time), TURN)
    errors, torques = [], []
    for terms in range(1, 5):
        rates = [np.where(moving, turn.deriv(2 + 2 * k)(time), 0.0) for k in range(terms)]
        torques.append(a[:terms] @ np.array(rates))
        _, y, _ = lsim((motion.A, motion.B, motion.C, motion.D), torques[-1], time)
        errors.append(np.ravel(y) / LENGTH - wanted)
        print(f"terms up to the derivative {2 * terms:2d}: largest error of the tip {np.abs(errors[-1]).max():.4g} rad")
    words = [f"{2 * k + 2} derivatives" for k in range(4)]
    panels = [
        Panel("Moment at the hub", "time, s", "Nm", [Curve(time, torques[k], words[k], f"C{k}") for k in (0, 3)]),
        Panel(
            "Error of the tip",
            "time, s",
            "rad",
            [Curve(time, np.maximum(np.abs(errors[k]), 1e-8), words[k], f"C{k}") for k in range(4)],
            logarithmic=True,
        ),
    ]
    draw(options.folder / "feedforward.png", "Feedforward of a flexible arm", panels)
    return 0


if __name__ == "__main__":
    sys.exit(main())
