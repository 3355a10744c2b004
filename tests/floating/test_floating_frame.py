"""Floating-frame data against dense matrices, geometry and theory."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.body.floating.frame import floating_frame, frame_rows, why_not_floating
from morembs.body.floating.integrals import shape_integrals
from morembs.body.floating.ranking import ranked_terms
from morembs.body.floating.stiffening import Envelope
from morembs.fem import DofMap, FEModel, Nodes, rigid_motion, skew
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import BalancedTruncation, CraigBampton, Modal
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

KINDS = [("mean-axes", ()), ("tangent", ("l",)), ("tangent", ("r",)), ("chord", ("l", "r")), ("center-of-mass", ("l",))]
SIZE = (0.5, 0.05, 0.03)


@pytest.fixture(scope="module")
def beam():
    model = steel(box("hex20", (6, 2, 1), SIZE))
    interfaces = [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling=c)
        for n, x, c in (("l", 0.0, "rigid"), ("r", 0.5, "average"))
    ]
    with Problem(model, interfaces) as problem:
        yield problem


@pytest.fixture(scope="module")
def bodies(beam):
    return {"cb": CraigBampton(modes=8).reduce(beam), "modal": Modal(modes=8).reduce(beam)}


def shapes_of(problem, reduced, frame):
    """Elastic shapes (N, n) and positions (n_nodes, 3) from the origin of the frame."""
    return problem.coupling.T @ (reduced.V @ frame.elastic), problem.model.nodes.xyz - frame.origin


def test_a_box_has_its_mass_centre_and_inertia():
    model = steel(box("hex8", (5, 3, 2), SIZE))
    with Problem(model) as problem:
        frame = floating_frame(problem, Modal(modes=4).reduce(problem), origin=(0.1, -0.2, 0.3))
    integrals, m = frame.integrals, 7850 * np.prod(SIZE)
    assert abs(integrals.mass / m - 1) < 1e-14
    center = np.array(SIZE) / 2 - [0.1, -0.2, 0.3]
    assert np.abs(integrals.center - center).max() < 1e-14
    a, b, c = SIZE
    own = m / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    about = own + m * (center @ center * np.eye(3) - np.outer(center, center))
    assert np.abs(integrals.inertia - about).max() < 1e-14 * np.abs(about).max()


@pytest.mark.parametrize("name", ["cb", "modal"])
@pytest.mark.parametrize("kind, interfaces", KINDS)
def test_integrals_are_those_of_the_whole_mass_matrix(beam, bodies, name, kind, interfaces):
    reduced, M = bodies[name], beam.model.M.toarray()
    frame = floating_frame(beam, reduced, kind=kind, interfaces=interfaces, origin=(0.05, 0.01, -0.02))
    P, x = shapes_of(beam, reduced, frame)
    integrals = frame.integrals
    R = rigid_motion(np.repeat(x, 3, axis=0), np.tile(np.arange(3), len(x)))
    near = 1e-12 * np.sqrt(np.diag(P.T @ M @ P))
    assert (np.abs(P.T @ M @ P - integrals.Me) <= np.outer(near, near) * 1e12).all()
    assert np.abs(R.T @ M @ R - integrals.rigid).max() < 1e-12
    assert (np.abs(P.T @ M @ R - np.hstack([integrals.Ct, integrals.Cr])) <= near[:, None]).all()
    Ms, parts = M[::3, ::3], [P[a::3] for a in range(3)]
    for a in range(3):
        for b in range(3):
            assert (np.abs(x[:, a] @ Ms @ parts[b] - integrals.x_phi[a, b]) <= near).all()
            direct = parts[a].T @ Ms @ parts[b]
            assert (np.abs(direct - integrals.phi_phi[a, b]) <= 1e12 * np.outer(near, near)).all()
    # Rigid motions in reduced coordinates are rigid motions of all nodes.
    assert np.abs(beam.coupling.T @ (reduced.V @ frame.rigid) - R).max() < 1e-11


def test_coriolis_moments_are_those_of_the_mass_points(beam, bodies):
    """int x cross (2 w cross phi) dm = Gr w for each shape, point by point."""
    frame = floating_frame(beam, bodies["cb"], kind="tangent", interfaces=("l",), origin=(0.05, 0.01, -0.02))
    P, x = shapes_of(beam, bodies["cb"], frame)
    Ms, w = beam.model.M.toarray()[::3, ::3], np.array([0.3, -1.1, 0.7])
    size = max(np.abs(frame.integrals.Gr).max(), 1e-300)
    for shape, Gr in zip(P.T.reshape(-1, len(x), 3), frame.integrals.Gr, strict=True):
        moment = np.cross(x, Ms @ np.cross(2 * w, shape)).sum(axis=0)
        assert np.abs(moment - Gr @ w).max() < 1e-10 * size
    # A transposed Gr would differ.
    assert np.abs(frame.integrals.Gr - frame.integrals.Gr.transpose(0, 2, 1)).max() > 1e-3 * size


def test_a_chord_frame_turns_about_the_chord_as_its_first_interface(beam, bodies):
    """Start on the chord, end on it too, and no twist at the start; the end twists against it."""
    for names in (("l", "r"), ("r", "l")):
        frame = floating_frame(beam, bodies["cb"], kind="chord", interfaces=names)
        start, end = (frame.markers[name] for name in names)
        along = (end.point - start.point) / np.linalg.norm(end.point - start.point)
        size = np.abs(end.motion).max(axis=1)
        assert np.abs(start.motion[:3]).max() < 1e-11 * size[:3].max()
        assert np.abs(np.cross(along, end.motion[:3].T)).max() < 1e-11 * size[:3].max()
        assert np.abs(along @ start.motion[3:]).max() < 1e-11 * size[3:].max()
        assert np.abs(along @ end.motion[3:]).max() > 1e-2 * size[3:].max()


@pytest.mark.parametrize("kind, interfaces", KINDS)
def test_shapes_obey_the_conditions_of_their_frame(beam, bodies, kind, interfaces):
    frame = floating_frame(beam, bodies["cb"], kind=kind, interfaces=interfaces)
    V = bodies["cb"].V @ frame.elastic
    S = frame_rows(beam, kind, interfaces)
    assert np.abs(S.T @ V).max() < 1e-11 * np.abs(S).max() * np.abs(V).max()
    for name in interfaces if kind == "tangent" else ():
        assert np.abs(frame.markers[name].motion).max() < 1e-12 * np.abs(V).max()
    if kind == "mean-axes":
        scale = np.sqrt(frame.integrals.mass)
        assert np.abs(frame.integrals.Ct).max() < 1e-12 * scale
        assert np.abs(frame.integrals.Cr).max() < 1e-12 * scale


def test_markers_move_as_their_nodes(beam, bodies):
    frame = floating_frame(beam, bodies["cb"], kind="chord", interfaces=("l", "r"))
    P, x = shapes_of(beam, bodies["cb"], frame)
    nodes = where(beam.model, 0, 0.0)
    marker = frame.markers["l"]
    for q in range(frame.count):
        move, turn = marker.motion[:3, q], marker.motion[3:, q]
        expected = move + np.cross(turn, x[nodes] - marker.point)
        assert np.abs(P.reshape(len(x), 3, -1)[nodes, :, q] - expected).max() < 1e-12 * max(np.abs(P).max(), 1.0)


def test_the_free_frequencies_do_not_depend_on_the_frame(beam, bodies):
    for reduced in bodies.values():
        frequencies = []
        for kind, interfaces in KINDS:
            frame = floating_frame(beam, reduced, kind=kind, interfaces=interfaces)
            C = np.hstack([frame.integrals.Ct, frame.integrals.Cr])
            free = frame.integrals.Me - C @ np.linalg.solve(frame.integrals.rigid, C.T)
            frequencies.append(sl.eigh(frame.Ke, free, eigvals_only=True))
        expected = reduced.modes()[0][6:]
        assert np.abs(np.array(frequencies) / expected - 1).max() < 1e-9


def test_a_frame_can_be_changed_afterwards(beam, bodies):
    first = floating_frame(beam, bodies["cb"], kind="tangent", interfaces=("r",), origin=(0.5, 0.0, 0.0))
    later = first.in_frame("chord", ["l", "r"]).about([0.1, 0.2, 0.3])
    direct = floating_frame(beam, bodies["cb"], kind="chord", interfaces=("l", "r"), origin=(0.1, 0.2, 0.3))
    size = np.sqrt(np.diag(direct.integrals.Me))
    assert np.abs(later.elastic - direct.elastic).max() < 1e-10 * np.abs(direct.elastic).max()
    assert (np.abs(later.integrals.Me - direct.integrals.Me) < 1e-11 * np.outer(size, size)).all()
    assert (np.abs(later.integrals.x_phi - direct.integrals.x_phi) < 1e-11 * size).all()
    assert (np.abs(later.integrals.phi_phi - direct.integrals.phi_phi) < 1e-11 * np.outer(size, size)).all()
    assert np.abs(later.integrals.inertia - direct.integrals.inertia).max() < 1e-13
    assert np.abs(later.markers["r"].point - direct.markers["r"].point).max() < 1e-14
    assert np.abs(later.De - direct.De).max() <= 1e-12 * max(np.abs(direct.De).max(), 1.0)


def test_tables_obey_the_identities_of_the_theory(beam, bodies):
    integrals = floating_frame(beam, bodies["cb"], kind="tangent", interfaces=("l",)).integrals
    P, x = shapes_of(beam, bodies["cb"], floating_frame(beam, bodies["cb"], kind="tangent", interfaces=("l",)))
    Ms = beam.model.M.toarray()[::3, ::3]
    shape = P.reshape(len(x), 3, -1)
    # int x~ phi~ dm by products of skew matrices of the nodes.
    for mode in (0, 3):
        direct = np.einsum("iab,ij,jbc->ac", skew(x), Ms, skew(shape[:, :, mode]))
        assert np.abs(integrals.C4[mode] - direct).max() < 1e-12
        direct = np.einsum("iab,ij,jbc->ac", skew(shape[:, :, 1]), Ms, skew(shape[:, :, mode]))
        assert np.abs(integrals.C6[1, mode] - direct).max() < 1e-11
    skewed = integrals.Cr1.transpose(2, 0, 1)
    assert np.abs(skewed + skewed.transpose(0, 2, 1)).max() < 1e-12 * np.abs(skewed).max()
    pairs = [
        integrals.C4[:, a, b] + (integrals.C4[:, b, a] if a != b else 0)
        for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
    ]
    assert np.abs(integrals.Oe - np.array(pairs).T).max() == 0
    assert np.abs(np.einsum("laa->l", integrals.C4) + 2 * np.einsum("aal->l", integrals.x_phi)).max() < 1e-12
    # The inertia of the deformed body, integrated anew, is the quadratic polynomial of the tables.
    q = 1e-3 * np.cos(np.arange(integrals.count))
    moved = x + shape @ q
    S2 = moved.T @ Ms @ moved
    J = integrals.inertia + np.tensordot(q, integrals.J1, 1) - np.einsum("klab,k,l->ab", integrals.C6, q, q)
    assert np.abs(J - (np.trace(S2) * np.eye(3) - S2)).max() < 1e-13


def test_rotating_masses_keep_their_consistent_parts():
    """Nodes that turn: linear terms come from the whole mass matrix, and the rest is told to be approximate."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(5, 3))
    node, component = np.repeat(np.arange(5), 6), np.tile(np.arange(6), 5)
    # A lump beside each node: its offset couples the displacement of the node with its rotation.
    lumps = []
    for mass, arm in zip(rng.uniform(1, 2, 5), skew(0.1 * rng.normal(size=(5, 3))), strict=True):
        own = np.diag([0.1, 0.2, 0.25])
        lumps.append(np.block([[mass * np.eye(3), -mass * arm], [mass * arm, own - mass * arm @ arm]]))
    M = sl.block_diag(*lumps)
    R = rigid_motion(x[node], component)
    free = np.eye(30) - R @ np.linalg.pinv(R)
    K = free @ np.diag(rng.uniform(1e4, 1e5, 30)) @ free
    model = FEModel(
        K=sp.csr_array(0.5 * (K + K.T)),
        M=sp.csr_array(0.5 * (M + M.T)),
        nodes=Nodes(ids=np.arange(5), xyz=x),
        dofs=DofMap(node=node, component=component),
    )
    with Problem(model) as problem:
        reduced = Modal(modes=6).reduce(problem)
        frame = floating_frame(problem, reduced)
    P = reduced.V @ frame.elastic
    assert "mean translational mass" in frame.notes[0]
    assert np.abs(frame.integrals.Me - P.T @ M @ P).max() < 1e-11
    assert np.abs(np.hstack([frame.integrals.Ct, frame.integrals.Cr]) - P.T @ M @ R).max() < 1e-11
    assert np.abs(frame.integrals.inertia - (R.T @ M @ R)[3:, 3:]).max() < 1e-11
    # The lumps lie beside their nodes: first moment and centre are those of the lumps, from the origin of the frame.
    mass = np.array([lump[0, 0] for lump in lumps])
    arms = np.array([[lump[2, 4], lump[0, 5], lump[1, 3]] for lump in lumps]) / -mass[:, None]
    origin = np.array([0.7, -0.4, 1.1])
    with Problem(model) as problem:
        integrals, _ = shape_integrals(model, P, origin)
    assert integrals.mass == pytest.approx(mass.sum(), rel=1e-13)
    assert np.abs(integrals.first - mass @ (x + arms - origin)).max() < 1e-12
    assert np.abs(frame.integrals.first - mass @ (x + arms - frame.origin)).max() < 1e-12


def test_different_masses_along_the_axes_count_as_their_mean():
    """Terms of second order of nodes with masses (a, b, c) are those of nodes with (a + b + c) / 3."""
    rng = np.random.default_rng(4)
    x, masses = rng.normal(size=(6, 3)), rng.uniform(1, 2, (6, 3))
    R = rigid_motion(np.repeat(x, 3, axis=0), np.tile(np.arange(3), 6))
    free = np.eye(18) - R @ np.linalg.pinv(R)
    K = free @ np.diag(rng.uniform(1e4, 1e5, 18)) @ free
    model = FEModel(
        K=sp.csr_array(0.5 * (K + K.T)),
        M=sp.csr_array(np.diag(masses.ravel())),
        nodes=Nodes(ids=np.arange(6), xyz=x),
        dofs=DofMap(node=np.repeat(np.arange(6), 3), component=np.tile(np.arange(3), 6)),
    )
    with Problem(model) as problem:
        reduced = Modal(modes=5).reduce(problem)
        frame = floating_frame(problem, reduced)
    assert "not the same" in frame.notes[0]
    mean = masses.mean(axis=1)
    phi = (reduced.V @ frame.elastic).reshape(6, 3, -1)
    direct = np.einsum("i,iak,ibl->abkl", mean, phi, phi)
    assert np.abs(frame.integrals.phi_phi - direct).max() < 1e-12 * np.abs(direct).max()
    assert np.abs(np.einsum("aakl->kl", direct) - frame.integrals.Me).max() > 1e-3  # these are exact
    assert np.abs(frame.integrals.Me - np.einsum("ia,iak,ial->kl", masses, phi, phi)).max() < 1e-12


def test_bodies_without_a_frame_say_why(beam, bodies):
    held = dataclasses.replace(bodies["cb"], rigid_count=0)
    assert "free body" in why_not_floating(beam, held)
    with refusal("unsupported", "frame"):
        floating_frame(beam, held)
    two_sided = BalancedTruncation(order=4, variant="p", band_hz=[10.0, 2000.0]).reduce(beam)
    assert "two-sided" in why_not_floating(beam, two_sided)


@pytest.mark.parametrize(
    "kind, interfaces, words",
    [
        ("tangents", ("l",), ("unknown", "kind", "tangent")),
        ("tangent", (), ("value", "interfaces")),
        ("chord", ("l",), ("value", "interfaces")),
        ("chord", ("l", "l"), ("conflict", "interfaces")),
        ("tangent", ("x",), ("unknown", "interfaces", "x")),
    ],
)
def test_impossible_frames_are_refused(beam, bodies, kind, interfaces, words):
    with refusal(*words):
        floating_frame(beam, bodies["cb"], kind=kind, interfaces=interfaces)


def test_the_ranking_tells_which_terms_a_motion_excites(beam, bodies):
    frame = floating_frame(beam, bodies["cb"], kind="tangent", interfaces=("l",))
    spun = {term.name: term.share for term in ranked_terms(frame, Envelope(speed=50.0))}
    pushed = {term.name: term.share for term in ranked_terms(frame, Envelope(acceleration=50.0))}
    assert spun["Oe"] > 0.1 > pushed["Oe"] == 0
    # Without rotation nothing gyroscopic, and the elastic load is that of the frame's acceleration.
    assert pushed["Ct"] > 0.1 and all(pushed[name] == 0 for name in ("Gr", "Ge", "Oe", "Oe1"))
    shares = [term.share for term in ranked_terms(frame, Envelope(speed=50.0, acceleration=10.0))]
    assert shares == sorted(shares, reverse=True) and shares[-1] >= 0 and shares[0] <= 1
    # Terms of higher order in the deformation grow faster with the speed.
    slow, fast = ({t.name: t.share for t in ranked_terms(frame, Envelope(speed=w))} for w in (20.0, 200.0))
    assert fast["C6"] / slow["C6"] > fast["J1"] / slow["J1"] > 10
