"""Bodies that spin steadily: against rotors of four dofs, spinning Timoshenko shafts and beam theory of blades."""

import json

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.body import elastic_body, make_part
from morembs.body.floating.spin import campbell, whirl_of
from morembs.body.floating.spinning import Rotation, assemble_spin
from morembs.body.floating.spinning_modes import modes_over_speed, spinning_modes, with_spin
from morembs.dynamics.multibody.rotations import rotation
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton
from tests.support.meshes import STEEL, box, steel, where
from tests.support.refusals import refusal
from tests.support.rotors import DISC, SHAFT, rotor

ABOUT_X = Rotation(axis=(1, 0, 0), held=("clamp",))
FOUND = {
    0: (204.89, 204.89, 1460.4, 1460.4),
    300: (72.69, 482.54, 1469.1, 1519.8),
    1200: (914.51, 1325.81, 1837.3, 2020.7),
}


@pytest.fixture(scope="module")
def overhung():
    model, interfaces = rotor()
    with Problem(model, interfaces) as problem:
        yield problem, assemble_spin(problem, ABOUT_X)


def bending(modes, problem, spin, speed):
    """Frequencies of the modes that bend, with their whirl: all but torsion and stretching."""
    whirl = whirl_of(modes.eigenvalues, modes.vectors, spin.C, spin.S, problem.M, speed)
    x = np.abs(problem.coupling.B[:, problem.coupling.columns["disc"]].T @ modes.vectors) * [[1]] * 3 + [[0.1]] * 3
    across = x[1:3].max(axis=0) > 10 * np.maximum(x[0], SHAFT * x[3])
    return modes.frequencies[across], whirl.inertial[across]


def rigid_rotor(problem, speed):
    """Rotor of four dofs on the flexibility of the shaft at the centre of the disc, in the frame at rest: whirl speeds.

    The disc is much stiffer than the shaft, so that its static motion is rigid.
    """
    m, h = 7850 * 0.2 * 0.2 * DISC, 0.2
    across, along = m * (h * h + DISC**2) / 12, m * h * h / 6
    U, _ = problem.fixed_interface.solve_constraint_modes()
    disc = problem.coupling.columns["disc"]
    C = np.asarray((problem.coupling.B.T @ U)[:, disc])
    K = (U.T @ (problem.K @ U))[disc, disc]
    assert C.shape[1] == 6
    # From the far face to the centre: y, z, turns about y and z.
    shift = np.eye(6)
    shift[1, 5], shift[2, 4] = DISC / 2, -DISC / 2
    K = (shift.T @ K @ shift)[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])]
    M = np.diag([m, m, across, across])
    G = np.zeros((4, 4))
    G[2, 3], G[3, 2] = speed * along, -speed * along
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-np.linalg.solve(M, K), -np.linalg.solve(M, G)]])
    values, X = sl.eig(A)
    up = values.imag > 0
    # y + i z of a circle: exp(i w t) or exp(-i w t).
    forward = np.abs(X[0, up] + 1j * X[1, up]) > np.abs(X[0, up] - 1j * X[1, up])
    return np.sort(np.where(forward, 1, -1) * values[up].imag)


@pytest.mark.parametrize("speed", FOUND)
def test_an_overhung_rotor_whirls_as_a_rigid_disc_on_its_shaft(overhung, speed):
    problem, spin = overhung
    modes = spinning_modes(problem, spin, speed, 6)
    rotating = modes.frequencies[np.argsort(modes.frequencies)]
    near = [rotating[np.abs(rotating - w).argmin()] for w in FOUND[speed]]
    assert near == pytest.approx(FOUND[speed], rel=3e-4)
    assert (modes.eigenvalues.real == 0).all()
    if speed:
        whirl = whirl_of(modes.eigenvalues, modes.vectors, spin.C, spin.S, problem.M, speed)
        circles = np.isfinite(whirl.inertial)
        assert circles.sum() == 4
        assert np.sort(whirl.inertial[circles]) == pytest.approx(rigid_rotor(problem, speed), rel=3e-4)


def test_the_whirl_of_an_observer_at_rest(overhung):
    problem, spin = overhung
    modes = spinning_modes(problem, spin, 300, 6)
    whirl = whirl_of(modes.eigenvalues, modes.vectors, spin.C, spin.S, problem.M, 300)
    circles = np.sort(whirl.inertial[np.isfinite(whirl.inertial)])
    assert circles == pytest.approx([-1219.8, -182.54, 227.31, 1769.1], rel=3e-4)
    # Torsion and stretching have no direction.
    assert whirl.whirl.count("mixed") == 2


def test_spin_about_the_other_way_turns_whirls_round(overhung):
    problem, spin = overhung
    back = assemble_spin(problem, Rotation(axis=(-1, 0, 0), held=("clamp",)))
    whirls = []
    for one in (spin, back):
        modes = spinning_modes(problem, one, 300, 6)
        whirls.append(whirl_of(modes.eigenvalues, modes.vectors, one.C, one.S, problem.M, 300).inertial)
    assert whirls[0] == pytest.approx(whirls[1], rel=1e-9, nan_ok=True)


def test_without_the_centrifugal_stress_the_disc_tilts_wrongly_and_a_warning_says_so(overhung):
    problem, _ = overhung
    spin = assemble_spin(problem, Rotation(axis=(1, 0, 0), held=("clamp",), stress=False))
    assert "stress = false" in spin.warnings[0]
    wrong = spinning_modes(problem, spin, 300, 2).frequencies[0]
    assert wrong / FOUND[300][0] - 1 == pytest.approx(0.22, abs=0.01)


def timoshenko_shaft(speed, length=0.5, side=0.1):
    """First pair of a simply supported shaft that spins, in the frame that turns: rad/s."""
    E, nu, rho = STEEL["young"], STEEL["poisson"], STEEL["density"]
    A, I = side**2, side**4 / 12  # noqa: E741
    shear, k = 10 * (1 + nu) / (12 + 11 * nu) * E / (2 * (1 + nu)) * A, np.pi / length
    # u = y + i z and the tilt in the frame at rest, exp(i w t).
    K = np.array([[shear * k * k, -shear * k], [-shear * k, E * I * k * k + shear]])
    M, G = np.diag([rho * A, rho * I]), np.diag([0, 2 * rho * I * speed])
    whirl = sl.eig(np.block([[np.zeros((2, 2)), np.eye(2)], [np.linalg.solve(M, K), np.linalg.solve(M, G)]]))[0].real
    slow = whirl[np.argsort(np.abs(whirl))[:2]]
    return np.sort(np.abs(slow - speed))


def test_a_stout_shaft_spins_as_timoshenko_says():
    model = steel(box("hex20", (10, 2, 2), (0.5, 0.1, 0.1), lambda x: x - [0, 0.05, 0.05]))
    ends = np.concatenate([where(model, 0, 0.0), where(model, 0, 0.5)])
    centre = np.array([int(np.argmin(np.linalg.norm(model.nodes.xyz - [0.25, 0, 0], axis=1)))])
    interfaces = [
        make_interface(model, name="ends", nodes=ends, coupling="direct", components=[1, 2]),
        make_interface(model, name="centre", nodes=centre, coupling="direct", components=[0]),
    ]
    exact = {1000: (4570.1, 6516.9), 2000: (3596.8, 7490.5), 4000: (1650.4, 9437.8)}
    with Problem(model, interfaces) as problem:
        spin = assemble_spin(problem, Rotation(axis=(1, 0, 0), held=("ends", "centre")))
        for speed, pair in exact.items():
            assert timoshenko_shaft(speed) == pytest.approx(pair, rel=1e-4)
            modes = spinning_modes(problem, spin, speed, 2)
            assert modes.frequencies == pytest.approx(pair, rel=5e-3)
            assert modes.verified_below > modes.frequencies[-1]


def round_shaft(turn=None, shift=(0.0, 0.0, 0.0), cells=(12, 4, 4)):
    """A shaft of 0.5 m with a diameter of 0.1 m along x, turned and moved; held at the points of both ends."""
    turn = np.eye(3) if turn is None else turn

    def warp(x):
        y, z = 20 * x[..., 1] - 1, 20 * x[..., 2] - 1
        y, z = 0.05 * y * np.sqrt(1 - z * z / 2), 0.05 * z * np.sqrt(1 - y * y / 2)
        return np.stack((x[..., 0], y, z), axis=-1) @ turn.T + shift

    mesh = box("hex20", cells, (0.5, 0.1, 0.1), warp)
    model = steel(mesh)
    along = (model.nodes.xyz - shift) @ turn[:, 0]
    interfaces = [
        make_interface(
            model,
            name=name,
            nodes=np.flatnonzero(np.abs(along - x) < 1e-9),
            coupling="rigid",
            point=turn[:, 0] * x + shift,
        )
        for name, x in (("left", 0.0), ("right", 0.5))
    ]
    return model, interfaces


def test_a_round_shaft_whirls_as_in_ross():
    """ROSS 2.3.0, 40 Timoshenko elements with gyroscopic moments, bearings of 1e13 N/m at both ends, rad/s."""
    # Backward whirls are negative.
    ross = {0: [4877.36, 4877.36, 17465.18, 17465.18], 2000: [-4835.36, 4919.63, -17349.58, 17580.78]}
    model, _ = round_shaft()
    ends = np.concatenate([where(model, 0, 0.0), where(model, 0, 0.5)])
    centre = np.array([int(np.argmin(np.linalg.norm(model.nodes.xyz - [0.25, 0, 0], axis=1)))])
    held = [
        make_interface(model, name="ends", nodes=ends, coupling="direct", components=[1, 2]),
        make_interface(model, name="centre", nodes=centre, coupling="direct", components=[0]),
    ]
    with Problem(model, held) as problem:
        spin = assemble_spin(problem, Rotation(axis=(1, 0, 0), held=("ends", "centre")))
        rest = spinning_modes(problem, spin, 0, 6).frequencies
        modes = spinning_modes(problem, spin, 2000, 6)
    assert rest[[0, 1, 3, 4]] == pytest.approx(ross[0], rel=5e-3)
    whirls = whirl_of(modes.eigenvalues, modes.vectors, spin.C, spin.S, problem.M, 2000).inertial
    whirls = sorted(whirls[np.isfinite(whirls)], key=abs)
    assert whirls == pytest.approx(ross[2000], rel=5e-3)
    # What gyroscopic moments split, which the stiffness of the elements hardly touches.
    splits = [(ahead + back) / (ahead - back) for back, ahead in (whirls[:2], whirls[2:])]
    exact = [(ahead + back) / (ahead - back) for back, ahead in (ross[2000][:2], ross[2000][2:])]
    assert splits == pytest.approx(exact, rel=1.5e-2)


@pytest.mark.parametrize("along, through", [((1, 0, 0), (0, 0, 0)), ((0.2, 1.0, -0.4), (0.1, 0.25, -0.3))])
def test_modes_do_not_depend_on_the_axes_of_the_model(along, through):
    """Turned and moved, the axis of any length through any of its points and, with a negative speed, the other way."""
    turn, shift = rotation((1, -2, 0.7), 1.1), np.array([0.7, -0.4, 1.3])
    axis, point = np.array(along, dtype=float), np.array(through, dtype=float)
    spins = []
    for R, d, factor, slide in ((np.eye(3), 0 * shift, 1.0, 0.0), (turn, shift, -7.3, 0.9)):
        model, interfaces = round_shaft(R, d, (4, 2, 2))
        with Problem(model, interfaces) as problem:
            about = Rotation(axis=factor * (R @ axis), point=R @ (point + slide * axis) + d, held=("left",))
            spin = assemble_spin(problem, about)
            sign = np.sign(factor)
            full = modes_over_speed(problem, spin, [sign * 300.0, 0.0, sign * 900.0], 6)
            reduced, small = with_spin(problem, CraigBampton(modes=6).reduce(problem), spin, full)
            whirl = campbell(_Body(reduced, small), [sign * 300.0, 0.0, sign * 900.0], 6)
            moved = (problem.coupling.T @ spin.elongation).reshape(-1, 3)
            spins.append((full, whirl, np.sort(np.linalg.norm(moved, axis=1))))
    (full, whirl, stretch), (other, turned, again) = spins
    assert again == pytest.approx(stretch, abs=1e-8 * stretch.max())
    for speed in full:
        assert other[sign * speed].frequencies == pytest.approx(full[speed].frequencies, rel=1e-7)
    for here, there in zip(whirl, turned, strict=True):
        assert np.abs(here.eigenvalues) == pytest.approx(full[here.speed].frequencies, rel=2e-6)
        assert np.abs(there.eigenvalues) == pytest.approx(np.abs(here.eigenvalues), rel=1e-7)
        assert there.inertial * sign == pytest.approx(here.inertial, rel=1e-6, nan_ok=True)


def blade():
    model = steel(box("hex20", (40, 1, 2), (1.0, 0.03, 0.01), lambda x: x - [0, 0.015, 0.005]))
    return model, [make_interface(model, name="root", nodes=where(model, 0, 0.0), point=[0, 0, 0])]


def test_a_blade_stiffens_as_southwell_says_and_stretches_as_a_rod():
    model, interfaces = blade()
    with Problem(model, interfaces) as problem:
        spin = assemble_spin(problem, Rotation(axis=(0, 0, 1), held=("root",)))
        rest = spinning_modes(problem, spin, 0.0, 2).frequencies
        for part in (0.1, 0.4, 0.8):
            speed = part * rest[0]
            modes = spinning_modes(problem, spin, speed, 2)
            assert (modes.frequencies**2 - rest**2) / speed**2 == pytest.approx([1.193, 0.193], rel=1e-2)
        tip = problem.coupling.T @ spin.elongation
        stretch = tip.reshape(-1, 3)[where(model, 0, 1.0), 0]
        # rho W^2 L^3 / 3 E of a rod.
        assert stretch.mean() == pytest.approx(STEEL["density"] / 3 / STEEL["young"], rel=2e-3)


def test_one_body_has_the_modes_of_all_speeds(overhung, tmp_path):
    problem, spin = overhung
    reduced = CraigBampton(modes=4).reduce(problem)
    full = modes_over_speed(problem, spin, [0, 300, 600, 900, 1200], 6)
    body, small = with_spin(problem, reduced, spin, full)
    assert np.array_equal(small.C, -small.C.T)
    deviations = body.recipe["spin_mode_deviation"]
    assert body.recipe["spin_modes_from"] == [0, 600, 1200]
    assert max(deviations.values()) < 2e-6
    # The static modes of both interfaces stay where they were.
    assert np.array_equal(body.K[:12, :12], reduced.K[:12, :12])
    assert np.allclose(body.C, problem.B.T @ body.V, rtol=0, atol=1e-9)
    json.dumps(body.recipe["spin_mode_deviation"])


def test_the_basis_with_spin_projects_damping_too():
    model, interfaces = blade()
    with Problem(model, interfaces, damping=Damping(beta=1e-3)) as problem:
        spin = assemble_spin(problem, Rotation(axis=(0, 0, 1), held=("root",)))
        full = modes_over_speed(problem, spin, [40.0], 3)
        reduced = CraigBampton(modes=2).reduce(problem)
        body, small = with_spin(problem, reduced, spin, full)
        (whirl,) = campbell(_Body(body, small), [40.0], 3)
        assert whirl.eigenvalues == pytest.approx(full[40.0].eigenvalues, rel=1e-6)
        assert (whirl.eigenvalues.real < -0.5 * 1e-3 * 52.0**2 * 0.9).all()
        assert "damping" in full[40.0].no_count


class _Body:
    """The matrices of a reduced model with its spin, as campbell takes them."""

    def __init__(self, reduced, spin):
        self.name, self.spin, self.matrices = reduced.name, spin, (reduced.M, reduced.K, reduced.D)


def test_a_body_without_spin_says_what_is_missing(overhung):
    problem, _ = overhung
    body = elastic_body(problem, CraigBampton(modes=4).reduce(problem), make_part(problem))
    with refusal("missing", "spin"):
        campbell(body, [0.0])


def test_what_cannot_spin_is_refused(overhung):
    problem, spin = overhung
    with refusal("value", "axis"):
        Rotation(axis=(0, 0, 0))
    with refusal("unknown", "", "clmp", "clamp"):
        assemble_spin(problem, Rotation(axis=(1, 0, 0), held=("clmp",)))
    free = assemble_spin(problem, Rotation(axis=(1, 0, 0)))
    with refusal("model", "held", "6"):
        spinning_modes(problem, free, 10.0, 2)
    with refusal("value", "count", "2000"):
        spinning_modes(problem, spin, 10.0, 2000)


def test_matrices_spin_where_their_nodes_have_all_translations():
    model, _ = blade()
    bare = FEModel(K=model.K, M=model.M, nodes=model.nodes, dofs=model.dofs)
    interfaces = [make_interface(bare, name="root", nodes=where(bare, 0, 0.0), point=[0, 0, 0])]
    with Problem(bare, interfaces) as problem:
        spin = assemble_spin(problem, Rotation(axis=(0, 0, 1), held=("root",)))
        assert "matrices only" in spin.warnings[0]
        rest, lag = (spinning_modes(problem, spin, W, 2).frequencies[1] for W in (0.0, 40.0))
        # Without stress the lag mode loses the whole softening.
        assert (lag**2 - rest**2) / 40.0**2 == pytest.approx(-1.0, rel=2e-2)
    three = [np.eye(k) for k in (2, 2)]
    flat = FEModel(
        K=three[0],
        M=three[1],
        nodes=Nodes(ids=np.array([1]), xyz=np.zeros((1, 3))),
        dofs=DofMap(node=np.zeros(2, int), component=np.array([0, 1])),
    )
    with Problem(flat) as problem, refusal("unsupported", "spin"):
        assemble_spin(problem, Rotation(axis=(0, 0, 1)))
