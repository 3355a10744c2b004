"""Solids at large displacements against the elastica, linear finite elements and uniform strain."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from morembs.base.errors import SolverError
from morembs.dynamics.nonlinear.continuation import follow_equilibrium
from morembs.dynamics.nonlinear.solid import NonlinearSolid
from morembs.fem import DofMap, FEModel
from morembs.fem.assembly import assemble
from morembs.fem.interface import make_interface
from morembs.fem.material import orthotropic
from tests.support.elastica import tip_of_elastica
from tests.support.meshes import box, heavy, steel, where
from tests.support.refusals import refusal

SOFT = {"young": 1.0, "density": 2.0}
KINDS = ("hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15")


def ends(model, *couplings):
    """Interfaces on the end faces along x, called root and tip."""
    length = np.ptp(model.nodes.xyz[:, 0])
    faces = zip(("root", "tip"), (0.0, length), couplings, strict=False)
    return [make_interface(model, name=n, nodes=where(model, 0, x), coupling=c) for n, x, c in faces]


def crooked(solid, amplitude=0.03, seed=0):
    x = solid.reference + amplitude * np.random.default_rng(seed).standard_normal(solid.size)
    for name in ("root", "tip"):
        if len(solid.frames.get(name, ())) == 6:
            x[solid.frames[name][3:]] += [0.3, 0.5, -0.7] if name == "tip" else [-0.2, 0.4, 0.1]
    return x


@pytest.mark.parametrize("kind", KINDS)
def test_without_load_the_tangent_is_the_linear_stiffness(kind):
    model = steel(box(kind, (2, 2, 1), (3.0, 1.0, 0.8), lambda x: x + np.sin(x[..., [1, 2, 0]]) * [0, 0.1, 0.1]))
    solid = NonlinearSolid(model)
    assert abs(solid.tangent(solid.reference) - model.K).max() < 1e-12 * abs(model.K).max()
    assert abs(solid.M - model.M).max() == 0
    framed = NonlinearSolid(model, ends(model, "rigid", "rigid"))
    G = framed.motion(framed.reference)
    linear = G.T @ model.K @ G
    assert abs(framed.tangent(framed.reference) - linear).max() < 1e-12 * abs(linear).max()


@pytest.mark.parametrize("kind", ["hex8", "hex20", "tet10"])
def test_forces_and_tangent_are_derivatives_of_the_energy(kind):
    model = steel(box(kind, (2, 1, 1), (3.0, 1.0, 1.0)), **SOFT)
    solid = NonlinearSolid(model, ends(model, "rigid", "rigid"))
    x, d, h = crooked(solid), np.random.default_rng(3).standard_normal(solid.size), 1e-5
    slope = (solid.energy(x + h * d) - solid.energy(x - h * d)) / (2 * h)
    assert slope == pytest.approx(solid.force(x) @ d, rel=1e-6)
    change = (solid.force(x + h * d) - solid.force(x - h * d)) / (2 * h)
    K = solid.tangent(x)
    assert np.abs(K @ d - change).max() < 1e-6 * np.abs(change).max()
    assert abs(K - K.T).max() < 1e-14 * abs(K).max()
    # The same tangent with its own stress in place; and stress after a step is stress to first order.
    assert abs(solid.tangent(x, solid.resultants_after(x, 0 * d)) - K).max() < 1e-14 * abs(K).max()
    stress = (solid.resultants_after(x + h * d, 0 * d) - solid.resultants_after(x - h * d, 0 * d)) / (2 * h)
    assert np.allclose(solid.resultants_after(x, d) - solid.resultants_after(x, 0 * d), stress, atol=1e-6)


def test_pieces_of_many_elements_are_those_of_two_blocks():
    models = [steel(mesh, **SOFT) for mesh in heavy()]
    whole, parts = (NonlinearSolid(model, ends(model, "rigid", "average")) for model in models)
    x, d = crooked(whole, 0.003), np.random.default_rng(3).standard_normal(whole.size)
    assert parts.energy(x) == pytest.approx(whole.energy(x), rel=1e-13)
    force, stress = whole.force(x), whole.resultants_after(x, d)
    assert np.abs(parts.force(x) - force).max() < 1e-13 * np.abs(force).max()
    assert np.abs(parts.resultants_after(x, d) - stress).max() < 1e-13 * np.abs(stress).max()
    tangent = whole.tangent(x, stress)
    assert abs(parts.tangent(x, stress) - tangent).max() < 1e-13 * abs(tangent).max()


@pytest.mark.parametrize("kind", ["hex8", "hex20", "tet10"])
def test_rigid_motions_change_no_energy_and_turn_the_forces(kind):
    axes = Rotation.from_rotvec([0.3, -0.4, 0.9]).as_matrix()
    material = orthotropic(
        set="all", young=(3.0, 2.0, 1.0), poisson=(0.1, 0.2, 0.3), shear=(0.5, 0.6, 0.7), density=1.0, axes=axes
    )
    model = assemble(box(kind, (2, 1, 1), (3.0, 1.0, 1.0)), [material])
    solid = NonlinearSolid(model)
    x = crooked(solid, 0.05)
    Q = Rotation.from_rotvec([1.0, -2.0, 0.5])
    y = (Q.apply(x.reshape(-1, 3)) + np.array([5.0, -3.0, 1.0])).ravel()
    assert solid.energy(y) == pytest.approx(solid.energy(x), rel=1e-10)
    turned = Q.apply(solid.force(x).reshape(-1, 3)).ravel()
    assert np.abs(solid.force(y) - turned).max() < 1e-10 * np.abs(turned).max()
    # A rigid motion alone strains nothing.
    rigid = (Q.apply(solid.reference.reshape(-1, 3)) + np.array([5.0, -3.0, 1.0])).ravel()
    assert solid.energy(rigid) < 1e-26 and np.abs(solid.force(rigid)).max() < 1e-13


@pytest.mark.parametrize("kind", ["hex8", "hex20", "tet10"])
def test_uniform_strain_has_the_energy_and_stress_of_the_law(kind):
    """W = (lambda tr(E)^2 / 2 + mu E : E) V and the traction F S n for an affine motion of a box."""
    young, poisson = 3.0, 0.25
    model = steel(box(kind, (2, 2, 2), (2.0, 1.0, 0.5)), young=young, poisson=poisson)
    solid = NonlinearSolid(model)
    F = np.array([[1.3, 0.2, -0.1], [0.0, 0.9, 0.3], [0.1, -0.2, 1.1]])
    x = (model.nodes.xyz @ F.T).ravel()
    lam, mu = young * poisson / (1 + poisson) / (1 - 2 * poisson), young / 2 / (1 + poisson)
    E = (F.T @ F - np.eye(3)) / 2
    assert solid.energy(x) == pytest.approx(lam * np.trace(E) ** 2 / 2 + mu * np.sum(E * E), rel=1e-12)
    S = lam * np.trace(E) * np.eye(3) + 2 * mu * E
    face = solid.force(x).reshape(-1, 3)[where(model, 0, 2.0)].sum(axis=0)
    inside = np.setdiff1d(np.arange(len(model.nodes)), np.flatnonzero(outer(model.nodes.xyz, (2.0, 1.0, 0.5))))
    assert np.abs(solid.force(x).reshape(-1, 3)[inside]).max(initial=0.0) < 1e-13
    # Faces across y and z pull at the edges of the end face, too, but opposite ones with opposite forces.
    assert np.allclose(face, 0.5 * (F @ S)[:, 0], atol=1e-12)


def outer(xyz, size):
    return (np.isclose(xyz, 0) | np.isclose(xyz, size)).any(axis=1)


def test_a_slender_cantilever_converges_to_the_elastica():
    thickness, errors, load = 0.02, [], 10.0
    along, across, angle = tip_of_elastica(load)
    for n in (8, 16):
        model = steel(box("hex20", (n, 1, 1), (1.0, thickness, thickness)), poisson=0.0)
        solid = NonlinearSolid(model, ends(model, "rigid", "rigid"))
        force = (0, load * 2.1e11 * thickness**4 / 12, 0)
        path = follow_equilibrium(solid, held=solid.frames["root"], load=solid.wrench("tip", force=force), steps=4)
        point, R = solid.frame(path.x, "tip")
        tip = np.array([point[0] - along, point[1] - thickness / 2 - across, np.arctan2(R[1, 0], R[0, 0]) - angle])
        errors.append(np.abs(tip).max())
        assert point[2] == pytest.approx(thickness / 2, abs=1e-9)
        assert np.abs(path.reaction[:3] + force).max() < 1e-6 * force[1]
    assert errors[1] < 0.01 and errors[1] < 0.2 * errors[0]


@pytest.mark.parametrize("coupling", ["rigid", "average"])
def test_the_work_of_forces_and_moments_is_that_on_their_frame(coupling):
    model = steel(box("hex20", (2, 1, 1), (3.0, 1.0, 1.0)), **SOFT)
    point, face = (3.3, 0.2, 0.6), where(model, 0, 3.0)
    tip = make_interface(model, name="tip", nodes=face, coupling=coupling, point=point)
    solid = NonlinearSolid(model, [*ends(model, "rigid"), tip])
    x, d, h = crooked(solid), np.random.default_rng(3).standard_normal(solid.size), 1e-5
    force, moment = np.array([1.0, 2.0, 3.0]), np.array([-2.0, 0.5, 0.3])
    (ahead, R1), (behind, R0) = solid.frame(x + h * d, "tip"), solid.frame(x - h * d, "tip")
    spin = Rotation.from_matrix(R1 @ R0.T).as_rotvec() / (2 * h)
    work = force @ (ahead - behind) / (2 * h) + moment @ spin
    assert solid.wrench("tip", force=force, moment=moment)(x) @ d == pytest.approx(work, rel=1e-6)
    here, R = solid.frame(solid.reference, "tip")
    assert np.allclose(here, point) and np.allclose(R, np.eye(3))


def test_spread_forces_add_up():
    model = steel(box("hex20", (2, 1, 1), (3.0, 1.0, 1.0)), **SOFT)
    solid = NonlinearSolid(model, ends(model, "rigid", "average"))
    x, force, moment = crooked(solid), np.array([1.0, 2.0, 3.0]), np.array([-2.0, 0.5, 0.3])
    spread = solid.wrench("tip", force=force, moment=moment)(x)[:-6].reshape(-1, 3)
    free = np.setdiff1d(np.arange(len(model.nodes)), where(model, 0, 0.0))
    arms = solid.positions(x)[free] - solid.frame(x, "tip")[0]
    assert np.allclose(spread.sum(axis=0), force) and np.allclose(np.cross(arms, spread).sum(axis=0), moment)


def test_an_average_and_a_rigid_end_bend_a_slender_beam_alike():
    model = steel(box("hex20", (12, 1, 1), (1.0, 0.02, 0.02)), poisson=0.0)
    force, tips = (0.0, 2 * 2.1e11 * 0.02**4 / 12, 0.0), []
    for coupling in ("rigid", "average"):
        solid = NonlinearSolid(model, ends(model, "rigid", coupling))
        path = follow_equilibrium(solid, held=solid.frames["root"], load=solid.wrench("tip", force=force), steps=2)
        tips.append(solid.frame(path.x, "tip")[0])
    assert np.abs(tips[0] - tips[1]).max() < 1e-4


def test_a_turned_end_has_the_moment_of_the_circle():
    """Frames at both ends, one of them turned by 1.2 rad and free to move: EI angle / L."""
    model = steel(box("hex20", (20, 1, 1), (1.0, 0.02, 0.02)), poisson=0.0)
    solid = NonlinearSolid(model, ends(model, "rigid", "rigid"))
    held = np.concatenate((solid.frames["root"], solid.frames["tip"][3:]))
    motion = np.zeros(9)
    motion[8] = 1.2
    path = follow_equilibrium(solid, held=held, motion=motion, steps=2)
    EI = 2.1e11 * 0.02**4 / 12
    assert path.reaction[8] == pytest.approx(1.2 * EI, rel=2e-3)
    assert path.x[solid.frames["tip"][0]] == pytest.approx(np.sin(1.2) / 1.2, abs=1e-3)
    assert solid.energy(path.x) == pytest.approx(0.5 * 1.2**2 * EI, rel=2e-3)


def test_a_strut_beyond_buckling_is_refused_with_the_share_reached():
    model = steel(box("hex20", (10, 1, 1), (1.0, 0.02, 0.02)), poisson=0.0)
    solid = NonlinearSolid(model, ends(model, "rigid", "rigid"))
    euler = np.pi**2 / 4 * 2.1e11 * 0.02**4 / 12
    follow_equilibrium(solid, held=solid.frames["root"], load=solid.wrench("tip", force=(-0.99 * euler, 0, 0)), steps=1)
    with refusal("result", "", "0.91"):
        load = solid.wrench("tip", force=(-1.1 * euler, 0, 0))
        follow_equilibrium(solid, held=solid.frames["root"], load=load, steps=10)


def test_crushed_elements_are_refused():
    model = steel(box("hex8", (2, 1, 1), (1.0, 1.0, 1.0)), poisson=0.0)
    solid = NonlinearSolid(model, ends(model, "rigid", "rigid"))
    x = solid.reference
    x[solid.frames["tip"][0]] = -0.5
    with refusal("result", "elements", by=SolverError):
        solid.examine(x)


def test_bad_input_is_named():
    model = steel(box("hex8", (2, 1, 1), (2.0, 1.0, 1.0)))
    matrices = FEModel(K=model.K, M=model.M, nodes=model.nodes, dofs=DofMap.translations(len(model.nodes)))
    with refusal("unsupported", "model"):
        NonlinearSolid(matrices)
    root, tip = ends(model, "rigid", "direct")
    with refusal("conflict", "interfaces"):
        NonlinearSolid(model, [root, root])
    again = make_interface(model, name="again", nodes=where(model, 0, 0.0), coupling="rigid")
    with refusal("conflict", "interfaces"):
        NonlinearSolid(model, [root, again])
    solid = NonlinearSolid(model, [root, tip])
    assert len(solid.frames["tip"]) == 3 * len(tip.nodes)
    with refusal("unknown", "", "tip"):
        solid.frame(solid.reference, "tip")
    with refusal("value", "force"):
        solid.wrench("root", force=(1.0, 2.0))
