"""The superelement file for OpenFAST, read as its documentation says; a tower foundation against the full model."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from morembs import DofMap, FEModel, elastic_body, make_part, write_body
from morembs.exporters import export_body
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, Krylov, Modal
from tests.support.exports import extptfm_file
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal


def foundation(path, held=True, second=False, reducer=None):
    """A post of 20 m, of which the foot is held, with an interface at its top."""
    model = steel(box("hex8", (1, 1, 6), (2.0, 2.0, 20.0)))
    if held:
        keep = np.setdiff1d(np.arange(model.size), model.dofs.of_nodes(where(model, 2, 0.0)).ravel())
        K, M = (sp.csc_array(A)[keep][:, keep] for A in (model.K, model.M))
        dofs = DofMap(node=model.dofs.node[keep], component=model.dofs.component[keep])
        model = FEModel(K=K, M=M, nodes=model.nodes, dofs=dofs, source="post")
    top = [make_interface(model, name="tower", nodes=where(model, 2, 20.0))]
    if second:
        top.append(make_interface(model, name="boat", nodes=where(model, 2, 10.0), coupling="average"))
    with Problem(model, top, damping=Damping(beta=1e-3)) as problem:
        reduced = (reducer or CraigBampton(modes=5)).reduce(problem, "cb")
        body = elastic_body(problem, reduced, make_part(problem))
    return model, body, write_body(path / "post.h5", [body])


def test_the_file_is_the_foundation(tmp_path):
    model, body, source = foundation(tmp_path)
    done = export_body(source, "extptfm")
    assert done.paths == (tmp_path / "post.extptfm.dat",)
    header, matrices = extptfm_file(done.paths[0])
    n = body.reduced.order
    assert list(header.values()) == [n, 10000.0, 10000.0] and n == 11
    M, K, D = (matrices[f"{key} matrix"] for key in ("mass", "stiffness", "damping"))
    assert M.shape == K.shape == D.shape == (n, n)
    assert matrices["loads"].shape == (2, n + 2) and not matrices["loads"][:, 1:].any()
    # Craig and Bampton: no static coupling, modes of unit mass, and the frequencies of the body.
    assert not K[:6, 6:].any() and M[6:, 6:] == pytest.approx(np.eye(n - 6), abs=1e-12)
    hertz = np.sqrt(sl.eigvalsh(K, M)) / (2 * np.pi)
    assert hertz == pytest.approx(body.frequencies_hz, rel=1e-9)
    assert pytest.approx(1e-3 * K, rel=1e-9, abs=1e-9 * np.abs(D).max()) == D
    # Static: the top, moved by one metre, needs what the full model needs.
    rows = model.dofs.of_nodes(where(model, 2, 20.0))[:, 0]
    load = np.zeros(model.size)
    load[rows] = 0.25
    pushed = np.linalg.solve(K[:6, :6], np.eye(6)[0])[0]
    assert pushed == pytest.approx(load @ spl.spsolve(sp.csc_array(model.K), load), rel=0.02)
    notes = "\n".join(done.notes)
    assert "5 modes with tower at rest" in notes and "loads in the file are zero" in notes
    assert "nothing holds the body" not in notes


def test_one_of_several_interfaces_carries_the_tower(tmp_path):
    _, body, source = foundation(tmp_path, second=True)
    (first,) = [note for note in export_body(source, "extptfm").notes if "stands on" in note]
    assert first == "the tower stands on tower, nothing can be attached to boat"
    done = export_body(source, "extptfm", options={"interface": "boat", "duration": 600.0})
    header, matrices = extptfm_file(done.paths[0])
    K, M = matrices["stiffness matrix"], matrices["mass matrix"]
    assert header["!total simulation time in file:"] == 600.0 and matrices["loads"][-1, 0] == 600.0
    assert np.sqrt(sl.eigvalsh(K, M)) / (2 * np.pi) == pytest.approx(body.frequencies_hz, rel=1e-9)
    assert any("nothing can be attached to tower" in note for note in done.notes)
    with refusal("unknown", "interface", "boat"):
        export_body(source, "extptfm", options={"interface": "boot"})
    with refusal("value", "duration"):
        export_body(source, "extptfm", options={"interface": "boat", "duration": 0.0})


def test_what_is_no_foundation(tmp_path):
    _, _, free = foundation(tmp_path, held=False)
    assert any("6 rigid-body motions; hold its foot" in note for note in export_body(free, "extptfm").notes)
    (tmp_path / "post.extptfm.dat").unlink()
    *_, two_sided = foundation(
        tmp_path, second=True, reducer=Krylov(shifts_hz=[5.0], two_sided=True, inputs=["tower"], outputs=["boat"])
    )
    with refusal("unsupported", "", "FAST"):
        export_body(two_sided, "extptfm")
    *_, few = foundation(tmp_path, reducer=Modal(modes=3))
    with refusal("model", "modes"):
        export_body(few, "extptfm")
    assert {path.name for path in tmp_path.iterdir()} == {"post.h5"}
