"""A coupling kind of a user: one class and one line in the table, from the interface to the body file."""

import functools
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.body import elastic_body, make_part
from morembs.body.delivered import collect_delivered
from morembs.body.file import read_body, write_body
from morembs.dynamics.nonlinear.solid import NonlinearSolid
from morembs.fem import rigid_motion
from morembs.fem.interface import COUPLINGS, CouplingKind, make_interface
from morembs.problem import Problem
from morembs.reducers import CraigBampton
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal


@pytest.fixture
def translations(monkeypatch):
    """The kind of docs/reference/job/interfaces.md: nodes that move as one, without turning."""
    name = "translations"
    page = (Path(__file__).parents[2] / "docs" / "reference" / "job" / "interfaces.md").read_text()
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "CouplingKind" in block)
    # Taken out of the table again after the test.
    monkeypatch.setitem(COUPLINGS, name, None)
    exec(code, {"__name__": "docs"})
    return name


def bar_with_tied_end(coupling):
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.03)))
    tied = make_interface(model, name="tied", nodes=where(model, 0, 0.4), coupling=coupling)
    return model, [tied, make_interface(model, name="root", nodes=where(model, 0, 0.0), coupling="average")]


def test_a_kind_of_a_user_reduces_as_its_dense_elimination(translations):
    model, interfaces = bar_with_tied_end(translations)
    assert interfaces[0].components == (0, 1, 2)
    follow = (3 * interfaces[0].nodes[:, None] + np.arange(3)).ravel()
    kept = np.setdiff1d(np.arange(model.size), follow)
    T = np.zeros((model.size, len(kept) + 3))
    T[kept, np.arange(len(kept))] = 1
    T[follow, len(kept) + np.arange(len(follow)) % 3] = 1
    K, M = (T.T @ A.toarray() @ T for A in (model.K, model.M))
    with Problem(model, interfaces) as problem:
        assert problem.K.toarray() == pytest.approx(K, rel=1e-12, abs=1e-3)
        assert problem.B.toarray()[:, :3] == pytest.approx(np.eye(len(K))[:, len(kept) :])
        assert np.array_equal(problem.motion_scale, [1, 1, 1, 1, 1, 1, *[problem.length] * 3])
        # A face that cannot turn leaves three rigid motions, and only the other interface has a frame.
        assert problem.rigid.shape[1] == 3
        assert list(problem.coupling.frame_columns) == ["root"]
        reduced = CraigBampton(modes=len(K) - problem.B.shape[1]).reduce(problem)
    full, computed = (sl.eigh(*pair, eigvals_only=True)[3:] for pair in ((K, M), (reduced.K, reduced.M)))
    assert computed == pytest.approx(full, rel=1e-8)


def test_a_kind_of_a_user_goes_through_a_body_file(translations, tmp_path, monkeypatch):
    model, interfaces = bar_with_tied_end(translations)
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=3).reduce(problem)
        part = make_part(problem)
        body = elastic_body(problem, reduced, part)
    path = write_body(tmp_path / "tied.h5", [body])
    stored = read_body(path)
    assert stored.interfaces["tied"].coupling == translations
    assert list(stored.input_component[:3]) == [0, 1, 2] and (stored.input_node_id == -1).all()
    again = collect_delivered(next(iter(stored.bodies.values())), stored)
    assert list(again.markers) == list(collect_delivered(body, part).markers) == ["root"]
    monkeypatch.delitem(COUPLINGS, translations)
    with refusal("value", "", "translations"):
        read_body(path)


def test_a_kind_is_named_where_it_is_meant_or_does_not_fit(translations):
    model, interfaces = bar_with_tied_end(translations)
    with refusal("unknown", "coupling", "translations"):
        bar_with_tied_end("Translation")
    with refusal("unsupported", "coupling", "tied", "translations"):
        NonlinearSolid(model, interfaces)


@pytest.mark.parametrize("coupling", ["rigid", "average"])
def test_a_frame_tells_its_rotation_from_dofs_of_its_nodes(coupling):
    model = steel(box("hex20", (3, 1, 1), (0.3, 0.1, 0.1)))
    face = make_interface(model, name="face", nodes=where(model, 0, 0.3), coupling=coupling, point=(0.5, 0.0, 0.2))
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    # As the kind does it, and as one that says nothing of it.
    for rotation in (face.kind.rotation, functools.partial(CouplingKind.rotation, face.kind)):
        theta, dofs = rotation(model, face)
        assert theta @ R[dofs] == pytest.approx(np.eye(6)[3:], abs=1e-12)
    forces = CouplingKind.nodal_forces(face.kind, model, face)
    assert (forces is None) == (coupling == "rigid")
    if forces is not None:
        at_point = rigid_motion(
            np.repeat(model.nodes.xyz[face.nodes] - face.point, 3, axis=0), np.tile(range(3), len(face.nodes))
        )
        assert at_point.T @ forces == pytest.approx(np.eye(6), abs=1e-12)
