"""Geometric stiffness and stiffening terms against analytic values, nonlinear energy and dense solutions."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.base.budget import Budget
from morembs.body.floating.frame import floating_frame, frame_rows
from morembs.body.floating.link_stiffness import Links
from morembs.body.floating.stiffening import Envelope
from morembs.body.floating.stiffening_terms import geometric_stiffening, why_no_stiffening
from morembs.fem import FEModel, Mesh, skew
from morembs.fem.assembly import assemble
from morembs.fem.elements import TYPES
from morembs.fem.geometric_stiffness import StressedMesh, geometric_stiffness
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic, orthotropic
from morembs.problem import Problem
from morembs.reducers import CraigBampton, FreeInterface, Krylov, Modal
from tests.support.meshes import STEEL, box, steel, where
from tests.support.refusals import refusal

WOOD = {"young": (1.1e10, 5e8, 8e8), "poisson": (0.4, 0.35, 0.3), "shear": (6e8, 7e8, 4e7), "density": 500.0}
LENGTH, SIDE = 1.0, 0.02
EI = STEEL["young"] * SIDE**4 / 12
LINE_MASS = STEEL["density"] * SIDE**2
AXIS = (0.0, SIDE / 2, SIDE / 2)


def beam(n=12, poisson=0.0):
    """Slender square beam along x with an interface at each end."""
    model = steel(box("hex20", (n, 1, 1), (LENGTH, SIDE, SIDE)), poisson=poisson)
    return model, ends(model, LENGTH, "rigid")


def ends(model, length, coupling, off=0.0):
    """Interfaces on both end faces, their points ``off`` outwards."""
    _, width, height = np.ptp(model.nodes.xyz, axis=0)
    return [
        make_interface(
            model, name=name, nodes=where(model, 0, x), coupling=coupling, point=[x + d, width / 2, height / 2]
        )
        for name, x, d in (("root", 0.0, -off), ("tip", length, off))
    ]


@pytest.fixture(scope="module")
def slender():
    """The beam reduced, with its frames: kind -> (frame, terms)."""
    model, interfaces = beam()
    bodies = {}
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=14).reduce(problem)
        for kind, names in (("tangent", ["root"]), ("chord", ["root", "tip"]), ("mean-axes", [])):
            frame = floating_frame(problem, reduced, kind=kind, interfaces=names, origin=AXIS)
            bodies[kind] = frame, geometric_stiffening(problem, reduced, frame)
    return bodies


def critical(G, Ke):
    """Smallest positive factor p for which Ke + p G is singular."""
    return 1 / sl.eigh(-G, Ke, eigvals_only=True)[-1]


def warped(x):
    y = x / np.array([0.5, 0.2, 0.3])
    return x + 0.02 * np.sin(2 * y[..., [1, 2, 0]]) + 0.01 * y[..., [2, 0, 1]]


def green_energy(model, elasticity, w):
    """Strain energy of St Venant and Kirchhoff under displacements w (3 n,), element by element, by hand."""
    u, energy = w.reshape(-1, 3), 0.0
    for block in model.mesh.blocks:
        kind = TYPES[block.type]
        rule = kind.rule(kind.stiffness_order)
        for nodes in block.nodes:
            for dN, weight in zip(rule.dN, rule.weights, strict=True):
                J = model.nodes.xyz[nodes].T @ dN
                H = u[nodes].T @ dN @ np.linalg.inv(J)
                E = 0.5 * (H + H.T + H.T @ H)
                strain = np.array([E[0, 0], E[1, 1], E[2, 2], 2 * E[1, 2], 2 * E[2, 0], 2 * E[0, 1]])
                energy += 0.5 * weight * np.linalg.det(J) * strain @ elasticity @ strain
    return energy


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8", "hex20", "wedge15"])
def test_it_is_the_cubic_part_of_the_nonlinear_strain_energy(kind):
    wood = orthotropic(set="all", **WOOD)
    mesh = box(kind, (1, 1, 2), (0.5, 0.2, 0.3), warp=warped)
    model = assemble(mesh, [wood])
    rng = np.random.default_rng(3)
    fields = 0.05 * rng.standard_normal((3, model.size))
    # The third derivative of the energy in three directions, exact as the energy is of fourth degree.
    third = (
        sum(
            s[0] * s[1] * s[2] * green_energy(model, wood.stiffness, np.array(s) @ fields)
            for s in itertools.product((1, -1), repeat=3)
        )
        / 8
    )

    def term(a, b, u):
        kg = geometric_stiffness(mesh, [wood], u)
        return np.sum(a.reshape(-1, 3) * (kg @ b.reshape(-1, 3)))

    a, b, c = fields
    assert term(a, b, c) + term(b, c, a) + term(c, a, b) == pytest.approx(third, rel=1e-9)


@pytest.mark.parametrize("kind", ["tet10", "hex20", "wedge6"])
def test_rigid_rotation_turns_the_nodal_forces_of_the_stress(kind):
    mesh = box(kind, (2, 1, 1), (0.5, 0.2, 0.3), warp=warped)
    model = steel(mesh)
    u = np.random.default_rng(4).standard_normal(model.size) * 1e-3
    kg = geometric_stiffness(mesh, model.materials, u)
    forces = (model.K @ u).reshape(-1, 3)
    size = np.abs(forces).max()
    for axis in np.eye(3):
        turned = kg @ np.cross(axis, model.nodes.xyz)
        assert turned == pytest.approx(np.cross(axis, forces), abs=1e-10 * size)
    assert np.abs(kg @ np.ones(len(forces))).max() < 1e-12 * np.abs(kg).max()


def test_several_fields_and_several_materials_are_each_their_own():
    mesh = box("hex8", (4, 1, 1), (0.4, 0.1, 0.1))
    middle = mesh.nodes.xyz[mesh.blocks[0].nodes].mean(axis=1)[:, 0]
    halves = {"soft": (np.flatnonzero(middle < 0.2),), "stiff": (np.flatnonzero(middle > 0.2),)}
    mesh = Mesh(nodes=mesh.nodes, blocks=mesh.blocks, element_sets=halves)
    materials = [
        isotropic(set=name, young=young, poisson=0.0, density=1.0) for name, young in (("soft", 1e6), ("stiff", 3e6))
    ]
    stretched = np.zeros((len(mesh.nodes), 3))
    stretched[:, 0] = 1e-3 * mesh.nodes.xyz[:, 0]
    U = np.column_stack([stretched.ravel(), -2 * stretched.ravel()])
    once, twice = StressedMesh.of(mesh, materials).stiffness(U)
    # A slope s across the tension sigma stores sigma s^2 V / 2.
    slope = mesh.nodes.xyz[:, 0]
    assert slope @ (once @ slope) == pytest.approx(1e-3 * (1e6 + 3e6) * 0.2 * 0.01, rel=1e-12)
    assert slope @ (twice @ slope) == pytest.approx(-2e-3 * (1e6 + 3e6) * 0.2 * 0.01, rel=1e-12)


def test_southwell_coefficients_of_a_clamped_rotating_beam(slender):
    frame, terms = slender["tangent"]
    speed, Me, Oe1 = 20.0, frame.integrals.Me, frame.integrals.Oe1[:, 2]
    at_rest = sl.eigh(frame.Ke, Me, eigvals_only=True)
    stiff = terms.matrix(velocity=(0, 0, speed))

    def coefficients(extra):
        return (sl.eigh(frame.Ke + speed**2 * Oe1 + extra, Me, eigvals_only=True) - at_rest)[:2] / speed**2

    # Lead-lag comes first: the centrifugal force of its own displacement softens it by one.
    assert coefficients(stiff) == pytest.approx([0.193, 1.193], abs=0.004)
    assert coefficients(0 * stiff) == pytest.approx([-1.0, 0.0], abs=0.001)


def test_columns_buckle_at_the_loads_of_euler(slender):
    euler = np.pi**2 * EI / LENGTH**2
    frame, terms = slender["tangent"]
    assert critical(terms.matrix(wrench={"tip": (-1, 0, 0, 0, 0, 0)}), frame.Ke) == pytest.approx(euler / 4, rel=2e-3)
    pressed = {"root": (1, 0, 0, 0, 0, 0), "tip": (-1, 0, 0, 0, 0, 0)}
    frame, terms = slender["chord"]
    assert critical(terms.matrix(wrench=pressed), frame.Ke) == pytest.approx(euler, rel=3e-3)
    frame, terms = slender["mean-axes"]
    assert critical(terms.matrix(wrench=pressed), frame.Ke) == pytest.approx(euler, rel=3e-3)


def test_columns_buckle_under_their_own_weight(slender):
    # Clamped below (Greenhill 1881) and pinned at both ends (Timoshenko and Gere 1961): weight times L^2 / EI.
    for kind, factor in (("tangent", 7.837), ("chord", 18.57)):
        frame, terms = slender[kind]
        gravity = critical(terms.matrix(acceleration=(1, 0, 0)), frame.Ke)
        assert gravity * LINE_MASS * LENGTH == pytest.approx(factor * EI / LENGTH**2, rel=4e-3)


def test_a_hanging_beam_in_strong_gravity_swings_like_a_chain(slender):
    frame, terms = slender["tangent"]
    g = 4e6
    hung = terms.matrix(acceleration=(-g, 0, 0))
    # EI w'''' - (T w')' = m omega^2 w with T = m g (L - x), clamped above, by a Ritz series for reference.
    x, weight = np.polynomial.legendre.leggauss(80)
    x, weight = 0.5 * (x + 1), 0.5 * weight
    powers = [
        np.polynomial.Legendre.basis(k, domain=[0, 1])
        * np.polynomial.Polynomial([0, 0, 1]).convert(kind=np.polynomial.Legendre, domain=[0, 1])
        for k in range(14)
    ]
    w, slope, bend = (np.array([p.deriv(d)(x) if d else p(x) for p in powers]) for d in range(3))
    K = EI * (bend * weight) @ bend.T + LINE_MASS * g * (slope * weight * (1 - x)) @ slope.T
    ritz = np.sqrt(sl.eigh(K, LINE_MASS * (w * weight) @ w.T, eigvals_only=True)[0])
    omega = np.sqrt(sl.eigh(frame.Ke + hung, frame.integrals.Me, eigvals_only=True)[0])
    chain = 0.5 * 2.404826 * np.sqrt(g / LENGTH)
    assert omega == pytest.approx(ritz, rel=0.01)
    assert chain < omega < 1.25 * chain


LOADS = [
    ("rigid", "tangent", ["root"]),
    ("average", "chord", ["root", "tip"]),
    ("average", "mean-axes", []),
    ("rigid", "mean-axes", []),
    ("rigid", "center-of-mass", ["tip"]),
]


@pytest.mark.parametrize(
    ("coupling", "kind", "names", "reducer"),
    [(*load, CraigBampton(modes=4) if number % 2 else FreeInterface(modes=6)) for number, load in enumerate(LOADS)],
)
def test_every_term_is_that_of_a_dense_solution(coupling, kind, names, reducer):
    model = steel(box("hex20", (3, 1, 1), (0.5, 0.06, 0.1)))
    origin = np.array([0.1, -0.2, 0.3])
    with Problem(model, ends(model, 0.5, coupling, 0.2)) as problem:
        reduced = reducer.reduce(problem)
        frame = floating_frame(problem, reduced, kind=kind, interfaces=names, origin=origin)
        terms = geometric_stiffening(problem, reduced, frame)
        S, K, T = frame_rows(problem, kind, names), problem.K.toarray(), problem.coupling.T.toarray()
        wrenches = problem.coupling.frames.toarray()
        R = problem.coupling.R
    M, x = model.M.toarray(), (model.nodes.xyz - origin).ravel()
    turn = [np.kron(np.eye(len(x) // 3), skew(axis)) for axis in np.eye(3)]
    along = [np.tile(axis, len(x) // 3) for axis in np.eye(3)]
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
    spin = [turn[a] @ turn[b] @ x + (turn[b] @ turn[a] @ x if a != b else 0) for a, b in pairs]
    fields = np.column_stack(along + [A @ x for A in turn] + spin + [np.zeros((len(x), wrenches.shape[1]))])
    F = -T.T @ (M @ fields)
    F[:, 12:] = wrenches
    size = np.abs(K).max()
    held = np.block([[K, size * S], [size * S.T, np.zeros((6, 6))]])
    both = np.linalg.solve(held, np.vstack([F, np.zeros((6, F.shape[1]))]))
    U = T @ both[: len(K)]
    # What is not inertia comes through the interfaces; the reaction of the frame is inertia where it follows the mass.
    mass = {"mean-axes": slice(0, 6), "center-of-mass": slice(0, 3)}.get(kind, slice(0, 0))
    passed = model.K @ U + M @ (fields + T @ R[:, mass] @ both[len(K) :][mass] * size)
    Phi = T @ reduced.V @ frame.elastic
    stiffnesses = [geometric_stiffness(model.mesh, model.materials, u) for u in U.T]
    wanted = np.array([Phi.T @ np.kron(kg.toarray(), np.eye(3)) @ Phi for kg in stiffnesses])
    E = skew(np.eye(3))
    for name, end in (("root", 0.0), ("tip", 0.5)):
        nodes = where(model, 0, end)
        arms = model.nodes.xyz[nodes] - frame.markers[name].point - origin
        r = passed.reshape(-1, 3, F.shape[1])[nodes]
        A = 0.5 * np.einsum("sal,iab,jbc,sc->lij", r, E, E, arms)
        turned = frame.markers[name].motion[3:]
        wanted += np.einsum("ik,lij,jm->lkm", turned, A + A.transpose(0, 2, 1), turned)
    delivered = np.concatenate([terms.acceleration, terms.angular_acceleration, terms.rotation, *terms.wrench.values()])
    for part in (slice(0, 3), slice(3, 6), slice(6, 12), slice(12, 24)):
        if (part.start < 6 and kind == "mean-axes") or (part.start < 3 and kind == "center-of-mass"):
            # The frame balances these by itself.
            assert not delivered[part].any() and np.abs(wanted[part]).max() < 1e-8 * np.abs(delivered).max()
        else:
            assert delivered[part] == pytest.approx(wanted[part], rel=1e-6, abs=1e-8 * np.abs(wanted[part]).max())


def dead_loads(frame, terms, wrenches):
    """Matrices (6 + n, 6 + n) of small motions under wrenches that keep their direction in space."""
    n, parts = frame.count, frame.integrals
    inertial = np.hstack([parts.Ct, parts.Cr])
    M = np.block([[parts.rigid, inertial.T], [inertial, parts.Me]])
    K = np.zeros((6 + n, 6 + n))
    K[6:, 6:] = frame.Ke + terms.matrix(wrench=wrenches)
    for name, (f, m) in ((name, np.split(np.asarray(wrench), 2)) for name, wrench in wrenches.items()):
        # - f . A (x + u) to second order in the small rotation of the frame and u, and moments on rotation vectors.
        x, Phi, turned = frame.markers[name].point, frame.markers[name].motion[:3], frame.markers[name].motion[3:]
        K[3:6, 3:6] -= 0.5 * (np.outer(x, f) + np.outer(f, x)) - (f @ x) * np.eye(3)
        K[3:6, 6:] += skew(f) @ Phi + 0.5 * skew(m) @ turned
    K[6:, 3:6] = K[3:6, 6:].T
    return M, K


@pytest.mark.parametrize("coupling", ["rigid", "average"])
@pytest.mark.parametrize(("offset", "bent"), [(0.0, 0.0), (0.15, 0.0), (0.15, 1.0)])
def test_dead_loads_move_a_pressed_free_body_the_same_in_all_frames(coupling, offset, bent):
    model = steel(box("hex20", (6, 1, 1), (LENGTH, SIDE, SIDE)), poisson=0.0)
    P = 0.3 * np.pi**2 * EI / LENGTH**2
    moment = np.array([0.02, 0.1, 0.0]) * P * bent
    force = {"root": [P, 0, 0, *moment], "tip": [-P, 0, 0, *-moment]}
    displacements = []
    with Problem(model, ends(model, LENGTH, coupling, offset)) as problem:
        reduced = CraigBampton(modes=8).reduce(problem)
        for kind, names in (
            ("mean-axes", []),
            ("tangent", ["root"]),
            ("chord", ["tip", "root"]),
            ("center-of-mass", ["tip"]),
        ):
            frame = floating_frame(problem, reduced, kind=kind, interfaces=names)
            M, K = dead_loads(frame, geometric_stiffening(problem, reduced, frame), force)
            displacements.append(sl.eigh(K, M, eigvals_only=True))
            free = sl.eigh(frame.Ke, M[6:, 6:] - M[6:, :6] @ np.linalg.solve(M[:6, :6], M[:6, 6:]), eigvals_only=True)
    for other in displacements[1:]:
        assert other[:12] == pytest.approx(displacements[0][:12], rel=1e-6, abs=1e-8 * displacements[0][8])
    # Three translations stay free, and the rotation about the line of the forces alone; the load matters.
    assert np.sum(np.abs(displacements[0]) < 1e-8 * displacements[0][8]) == (3 if bent else 4)
    assert np.abs(displacements[0][6] / free[0] - 1) > 0.05


def test_another_origin_follows_from_the_terms_and_is_what_a_new_calculation_gives():
    model, interfaces = beam(n=4)
    with Problem(model, interfaces) as problem:
        reduced = Modal(modes=12).reduce(problem)
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=["root"])
        d = np.array([0.3, -0.2, 0.5])
        moved = geometric_stiffening(problem, reduced, frame).about(d)
        again = geometric_stiffening(problem, reduced, frame.about(d))
    for name in ("acceleration", "angular_acceleration", "rotation"):
        wanted = getattr(again, name)
        # Moments about the old origin cancel in most entries, whose round-off is that of the largest.
        assert np.abs(getattr(moved, name) - wanted).max() < 1e-8 * np.abs(wanted).max()


def test_a_frame_takes_its_stiffening_to_another_origin():
    """``FloatingFrame.about`` moves all it has: the stiffening is that of a calculation with the new origin."""
    model, interfaces = beam(n=4)
    with Problem(model, interfaces) as problem:
        reduced = Modal(modes=12).reduce(problem)
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=["root"])
        d = frame.origin + np.array([0.3, -0.2, 0.5])
        moved = replace(frame, stiffening=geometric_stiffening(problem, reduced, frame)).about(d).stiffening
        again = geometric_stiffening(problem, reduced, frame.about(d))
        still = geometric_stiffening(problem, reduced, frame)
    for name in ("angular_acceleration", "rotation"):
        wanted = getattr(again, name)
        # Moments about the old origin cancel in most entries, whose round-off is that of the largest.
        assert np.abs(getattr(moved, name) - wanted).max() < 1e-8 * np.abs(wanted).max()
        assert np.abs(getattr(still, name) - wanted).max() > 1e-3 * np.abs(wanted).max()


def test_a_rigid_interface_passes_what_an_average_one_on_its_nodes_does_not():
    """Balance of each shared node: stress and inertia less the direct share of the average interface.

    The forces of an average interface are written down here: of all forces on the nodes with the given resultants,
    the least in the norm of the weights.
    """
    model = steel(box("hex8", (3, 1, 1), (0.3, 0.1, 0.08)))
    face = where(model, 0, 0.3)
    rigid = make_interface(model, name="rigid", nodes=face, coupling="rigid", point=[0.34, 0.05, 0.03])
    loose = make_interface(model, name="loose", nodes=np.r_[where(model, 0, 0.2), face], coupling="average")
    rng = np.random.default_rng(2)
    with Problem(model, [rigid, loose]) as problem:
        links = Links(problem)
        U, inertial = 1e-6 * rng.normal(size=(model.size, 2)), rng.normal(size=(len(links.dofs), 2))
        wrench = 1e3 * rng.normal(size=(12, 2))
        moments = links.turning(U, inertial, wrench)["rigid"]
    arms = model.nodes.xyz[loose.nodes] - loose.point
    to_load = np.hstack([np.vstack([np.eye(3), skew(a)]) for a in arms])
    spread = np.repeat(loose.weights, 3)[:, None] * to_load.T
    forces = np.zeros((model.size, 2))
    dofs = model.dofs.of_nodes(loose.nodes).ravel()
    forces[dofs] = spread @ np.linalg.solve(to_load @ spread, wrench[links.columns["loose"]])
    face_dofs = model.dofs.of_nodes(face).ravel()
    r = (model.K @ U - forces)[face_dofs] + inertial[links.places["rigid"]]
    assert np.abs(forces[face_dofs]).max() > 1e-2 * np.abs(r).max()
    for k in range(2):
        virial = r[:, k].reshape(-1, 3).T @ (model.nodes.xyz[face] - rigid.point)
        wanted = 0.5 * (virial + virial.T) - np.trace(virial) * np.eye(3)
        assert np.abs(moments[k] - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_terms_below_their_share_are_dropped_and_named():
    model, interfaces = beam(n=4)
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=4).reduce(problem)
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=["root"], origin=AXIS)
        full = geometric_stiffening(problem, reduced, frame)
        used = Envelope(acceleration=10.0, angular_acceleration=50.0, speed=30.0, force=500.0, share=0.01)
        lean = geometric_stiffening(problem, reduced, frame, used)
    assert full.dropped == () and full.least_share == 0
    for name, G, kept in (
        ("rotation zz", full.rotation[2], lean.rotation[2]),
        ("acceleration x", full.acceleration[0], lean.acceleration[0]),
        ("tip force x", full.wrench["tip"][0], lean.wrench["tip"][0]),
        ("tip moment z", full.wrench["tip"][5], lean.wrench["tip"][5]),
    ):
        limit = {"rotation zz": 900.0, "acceleration x": 10.0, "tip force x": 500.0, "tip moment z": 1.0}[name]
        root = sl.sqrtm(np.linalg.inv(frame.Ke)).real
        share = limit * np.abs(np.linalg.eigvalsh(root @ G @ root)).max()
        assert lean.share[name] == pytest.approx(share, rel=1e-6)
        drop = share < 0.01 and name != "tip moment z"
        assert (name in lean.dropped) == drop
        assert np.array_equal(kept, 0 * G if drop else G)
    assert "acceleration x" in lean.dropped and "rotation zz" not in lean.dropped
    # What the frame balances by itself is zero without being dropped.
    assert lean.share["root force x"] == 0 and not lean.wrench["root"].any() and "root force x" not in lean.dropped


def test_a_body_without_interfaces_has_the_terms_of_its_rotation():
    model, _ = beam(n=6)
    with Problem(model) as problem:
        reduced = Modal(modes=14).reduce(problem)
        frame = floating_frame(problem, reduced)
        terms = geometric_stiffening(problem, reduced, frame)
    assert not terms.wrench and not terms.acceleration.any() and not terms.angular_acceleration.any()
    # A free beam spun about its middle, tension m w^2 (L^2/4 - s^2) / 2: Rayleigh with the first mode of the beam.
    beta = 4.730041
    s = np.linspace(-0.5, 0.5, 20001)
    shape = np.cos(beta * s) / np.cos(beta / 2) + np.cosh(beta * s) / np.cosh(beta / 2)
    slope = np.gradient(shape, s)
    wanted = np.trapezoid((0.25 - s**2) / 2 * slope**2, s) / np.trapezoid(shape**2, s)
    flap = np.linalg.eigvalsh(terms.rotation[2][:2, :2])
    assert flap == pytest.approx([wanted, wanted], rel=5e-3)


def test_blocks_and_groups_change_nothing(tmp_path):
    model, interfaces = beam(n=6)
    matrices = []
    # All loads at once; and one by one with few columns, as there is no memory left.
    for memory in (None, 1):
        with Budget(None, tmp_path, in_memory=1 << 30), Problem(model, interfaces) as problem:
            reduced = Krylov(shifts_hz=[0.0, 200.0]).reduce(problem)
            frame = floating_frame(problem, reduced, kind="tangent", interfaces=["root"])
            problem.budget.memory = memory
            matrices.append(geometric_stiffening(problem, reduced, frame))
    whole, in_blocks = (terms.rotation for terms in matrices)
    assert in_blocks == pytest.approx(whole, rel=1e-6, abs=1e-9 * np.abs(whole).max())


def test_what_has_no_stress_or_no_frame_is_refused_with_a_reason():
    model, interfaces = beam(n=2)
    bare = FEModel(K=model.K, M=model.M, nodes=model.nodes, dofs=model.dofs)
    assert why_no_stiffening(model) == "" and "matrices only" in why_no_stiffening(bare)
    with Problem(bare, interfaces) as problem:
        reduced = CraigBampton(modes=2).reduce(problem)
        frame = floating_frame(problem, reduced)
        with refusal("unsupported", "mesh"):
            geometric_stiffening(problem, reduced, frame)
    with Problem(model, interfaces) as problem:
        other = CraigBampton(modes=3).reduce(problem)
        with refusal("conflict", "frame"):
            geometric_stiffening(problem, other, frame)
    with refusal("value", "speed", "-1"):
        Envelope(speed=-1.0)
    with refusal("value", "speed", "1e+200", "1e+60"):
        Envelope(speed=1e200)
    with refusal("value", "displacements"):
        StressedMesh.of(model.mesh, model.materials).stiffness(np.zeros((4, 1)))
