"""The MBDyn file: read back by its grammar, its invariants against sums over the nodes of the full model."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.body.floating.frame import floating_frame
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.exporters import export_body
from morembs.fem import skew
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton
from tests.support.exports import mbdyn_groups
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal


def make(path, names=("left", "right"), damping=None, stiff=False):
    model = steel(box("hex8", (5, 2, 1), (0.5, 0.06, 0.03), warp=lambda x: x - [0.1, 0.03, 0.0]))
    faces = [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling=c)
        for n, x, c in zip(names, (-0.1, 0.4), ("rigid", "average"), strict=True)
    ]
    with Problem(model, faces, **({} if damping is None else {"damping": damping})) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "cb")
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=(names[0],), origin=(-0.1, 0.0, 0.01))
        if stiff:
            frame = replace(frame, stiffening=geometric_stiffening(problem, reduced, frame))
        write_body(path, [elastic_body(problem, reduced, make_part(problem), floating=frame)])
    return model


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mbdyn")
    model = make(folder / "beam.h5", damping=Damping(beta=1e-6))
    done = export_body(folder / "beam.h5", "mbdyn")
    assert done.paths == (folder / "beam.fem",)
    return model, read_body(folder / "beam.h5"), mbdyn_groups(done.paths[0])


def array(words, *shape):
    return np.array(words, dtype=float).reshape(shape)


def test_header_and_nodes(beam):
    _, source, records = beam
    frame = source.bodies["cb"].floating
    n = frame.count
    assert records[1] == ["REV0", "2", str(n), "0", "0", "0"] and records[2] == ["left", "right"]
    assert sorted(k for k in records if k != "modes") == [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 13, 14, 15, 16, 17, 18]
    assert not array(records[3], n).any() and not array(records[4], n).any()
    points = np.array([array(records[k], 2) for k in (5, 6, 7)]).T
    assert points == pytest.approx(np.array([[0.0, 0.0, 0.005], [0.5, 0.0, 0.005]]), abs=1e-12)
    modes = array(records[8], n, 2, 6)
    assert records["modes"] == n
    for k, name in enumerate(("left", "right")):
        assert np.array_equal(modes[:, k].T, frame.markers[name].motion)
    # The frame follows the left interface, so that it does not move in it.
    assert np.abs(modes[:, 0]).max() <= 1e-9 * np.abs(modes[:, 1]).max()


def test_matrices_and_inertia(beam):
    model, source, records = beam
    frame = source.bodies["cb"].floating
    n = frame.count
    for group, matrix in ((9, frame.integrals.Me), (10, frame.Ke), (13, frame.De)):
        assert array(records[group], n, n) == pytest.approx(matrix, rel=1e-12, abs=1e-14 * np.abs(matrix).max())
    inertia = array(records[12], 13)
    X = model.nodes.xyz
    Ms = model.M[::3][:, ::3]
    m = Ms @ np.ones(len(X))
    center = m @ X / m.sum()
    assert inertia[0] == pytest.approx(m.sum(), rel=1e-12)
    assert inertia[1:4] == pytest.approx(center - frame.origin, rel=1e-10, abs=1e-13)
    S2 = (X - center).T @ (Ms @ (X - center))
    assert inertia[4:].reshape(3, 3) == pytest.approx(np.trace(S2) * np.eye(3) - S2, abs=1e-12)


def test_invariants_are_integrals_over_the_mass(beam):
    """With a mass matrix of one scalar per pair of nodes every integral is a double sum over nodes."""
    model, source, records = beam
    body = source.bodies["cb"]
    frame, n = body.floating, body.floating.count
    X = model.nodes.xyz - frame.origin
    Ms = model.M[::3][:, ::3].toarray()
    phi = (body.basis() @ frame.elastic).reshape(len(X), 3, n)
    first = np.einsum("pq,qal->al", Ms, phi)
    both = np.einsum("pq,pa,qbl->abl", Ms, X, phi)
    pairs = np.einsum("pq,paj,qbk->abjk", Ms, phi, phi, optimize=True)
    near = {"rel": 1e-8, "abs": 1e-11 * np.abs(pairs).max()}
    assert array(records[14], 3, n) == pytest.approx(first, **near)
    cross = np.array([[np.cross(np.eye(3)[a], np.eye(3)[b]) for b in range(3)] for a in range(3)])
    assert array(records[15], 3, n) == pytest.approx(np.einsum("abc,abl->cl", cross, both), **near)
    # x~ phi~ = sum over products of x_a and phi_b of (e_a)~ (e_b)~.
    tilde = skew(np.eye(3))
    products = np.einsum("axy,byz->abxz", tilde, tilde)
    inv8 = array(records[16], 3, n, 3).transpose(1, 0, 2)
    assert inv8 == pytest.approx(-np.einsum("abl,abxz->lxz", both, products), **near)
    inv5 = array(records[17], 3, n, n)
    assert inv5 == pytest.approx(np.einsum("abc,abjk->cjk", cross, pairs), **near)
    inv9 = array(records[18], 3, n, n, 3).transpose(1, 2, 0, 3)
    assert inv9 == pytest.approx(np.einsum("abjk,abxz->jkxz", pairs, products), **near)


def test_inertia_of_the_deformed_body(beam):
    """Group 12, 16 and 18 together give the inertia of the deformed body about the frame's origin."""
    model, source, records = beam
    body = source.bodies["cb"]
    frame, n = body.floating, body.floating.count
    q = np.linspace(-1, 1, n) * 1e-3
    x = model.nodes.xyz - frame.origin + (body.basis() @ (frame.elastic @ q)).reshape(-1, 3)
    Ms = model.M[::3][:, ::3]
    S2 = x.T @ (Ms @ x)
    inv8 = np.einsum("xlz,l->xz", array(records[16], 3, n, 3), q)
    inv9 = np.einsum("xjkz,j,k->xz", array(records[18], 3, n, n, 3), q, q)
    J = frame.integrals.inertia + inv8 + inv8.T - inv9
    expected = np.trace(S2) * np.eye(3) - S2
    assert pytest.approx(expected, rel=1e-9, abs=1e-12) == J
    assert sl.eigvalsh(J)[0] > 0


def test_names_that_the_grammar_cannot_hold(tmp_path):
    make(tmp_path / "a.h5", names=("left end", "right"))
    with refusal("value", "name"):
        export_body(tmp_path / "a.h5", "mbdyn")
    assert not (tmp_path / "a.fem").exists()


def test_what_stays_behind_is_said(tmp_path):
    make(tmp_path / "a.h5")
    notes = " ".join(export_body(tmp_path / "a.h5", "mbdyn").notes)
    assert "record groups 14 to 18" in notes
    assert 13 not in mbdyn_groups(tmp_path / "a.fem")


def test_geometric_stiffness_of_any_loads_from_group_19(tmp_path):
    """As MBDyn sums it: by number, each with its product of velocities, acceleration or force along the modal node."""
    make(tmp_path / "a.h5", stiff=True)
    notes = " ".join(export_body(tmp_path / "a.h5", "mbdyn").notes)
    assert "automatic differentiation" in notes and "in this order: left, right" in notes
    frame = read_body(tmp_path / "a.h5").bodies["cb"].floating
    n, words = frame.count, mbdyn_groups(tmp_path / "a.fem")[19]
    size = n * n + 1
    assert len(words) == 1 + int(words[0]) * size
    terms = {int(words[k]): array(words[k + 1 : k + size], n, n) for k in range(1, len(words), size)}
    rng = np.random.default_rng(0)
    w, turning, acceleration = rng.standard_normal((3, 3))
    right = rng.standard_normal(6)
    factors = dict(enumerate((*w**2, w[0] * w[1], w[1] * w[2], w[2] * w[0], *turning, *acceleration), 1))
    factors |= dict(enumerate(np.concatenate((np.zeros(6), right)), 13))
    total = sum(factors[number] * G for number, G in terms.items())
    expected = frame.stiffening.matrix(
        velocity=w, angular_acceleration=turning, acceleration=acceleration, wrench={"right": right}
    )
    assert total == pytest.approx(expected, rel=1e-12, abs=1e-13 * np.abs(expected).max())
    assert np.linalg.eigvalsh(terms[3]).max() > 0 and {3, 10, 19} <= set(terms)
