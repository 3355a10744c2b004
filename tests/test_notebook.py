"""A session of a notebook, cell by cell: what the last line of a cell shows is short, and says what matters."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import morembs
from morembs.base.optional import optional
from tests.support.refusals import refusal

MESH = Path(__file__).parents[1] / "data" / "small_meshes" / "beam.msh"
# The last line of each is shown; then what it has to say, in its text and in its table.
CELLS = (
    (
        """
import numpy as np
import morembs as mo
mesh = mo.read_mesh(MESH)
mesh""",
        ("Mesh: nodes", "hex"),
    ),
    (
        """
model = mo.assemble(mesh, [mo.isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)])
model""",
        ("FEModel: dofs", "matrices K, M"),
    ),
    (
        """
low, high = (np.flatnonzero(np.isclose(mesh.nodes.xyz[:, 0], f(mesh.nodes.xyz[:, 0]))) for f in (np.min, np.max))
ends = [mo.make_interface(model, name=name, nodes=rows) for name, rows in (("left", low), ("right", high))]
ends[0]""",
        ("Interface: name left", "rigid"),
    ),
    (
        """
problem = mo.Problem(model, ends, damping=mo.Damping(modal=0.01))
problem""",
        ("Problem: model", "left, right"),
    ),
    (
        """
reduced = mo.CraigBampton(modes=8).reduce(problem)
reduced""",
        ("ReducedModel: name craig-bampton; order 20", "Hz"),
    ),
    (
        """
certificate, = mo.certify(problem, [reduced], [0.0, 1000.0])
certificate""",
        ("Certificate: error at most", "proven"),
    ),
    (
        """
body = mo.elastic_body(problem, reduced, mo.make_part(problem), certificate=certificate)
body""",
        ("Body: name craig-bampton; order 20; elastic frequencies", "at most", "Hz"),
    ),
    (
        """
stored = mo.read_body(mo.write_body("beam.h5", [body]))
stored.bodies["craig-bampton"]""",
        ("Body: name craig-bampton; order 20; elastic frequencies", "at most", "Hz"),
    ),
)


def shown(cell: str, names: dict[str, Any]) -> Any:
    """Run a cell; what its last line is, as a notebook shows it."""
    *before, last = ast.parse(cell).body
    exec(compile(ast.Module(before, []), "cell", "exec"), names)
    assert isinstance(last, ast.Expr)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)


def test_eight_cells_show_what_matters_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"MESH": str(MESH)}
    for cell, expected in CELLS:
        value = shown(cell, names)
        text, (table, frame, picture) = repr(value), value._repr_html_().partition("<iframe")
        flat = " ".join(text.split())
        assert all(words in flat for words in expected), text
        lines = text.splitlines()
        assert len(lines) <= 2 and max(map(len, lines)) <= 100
        assert len(table) < 1500 and table.count("<tr>") <= 8
        # Bodies and models are seen too, in a frame that needs nothing of the notebook.
        assert bool(frame) == isinstance(value, morembs.FEModel | morembs.Body)
        assert not frame or picture.rpartition(">")[0].endswith("trust the notebook.</iframe")
        assert not frame or ("srcdoc=" in picture and "<script" not in picture and len(picture) < 300_000)
        # The table shows all that the text begins to say.
        for fact in flat.partition(": ")[2].removesuffix(" ...").split("; ")[:3]:
            assert fact.split()[0] in table and fact.split()[-1] in table
    body = names["body"]
    stored = names["stored"].bodies[body.name]
    for drawn in (body, stored):
        _check_drawings(drawn, body)
    # Files keep shapes in single precision.
    ours, theirs = (each.view(3).motion for each in (body, stored))
    signs = np.sign((ours * theirs).sum(axis=(1, 2)))[:, None, None]
    assert theirs == pytest.approx(signs * ours, abs=1e-6 * np.abs(ours).max())
    with refusal("value", "modes"):
        stored.plot(0)
    _check_other_packages(names)


def _check_drawings(drawn: Any, body: Any) -> None:
    figure = drawn.plot(2)
    titles = [panel.get_title() for panel in figure.axes]
    first = body.frequencies_hz[6]
    assert f"mode 1: {first:,.1f} Hz" in titles and sum(title.startswith("mode") for title in titles) == 2
    assert {text.get_text() for panel in figure.axes for text in panel.texts} == {"left", "right"}
    if importlib.util.find_spec("pyvista"):
        grid = drawn.to_pyvista(modes=2)
        # VTK's own volume of the cells is that of the part.
        assert grid.volume == pytest.approx(body.part.mass / 7850.0, rel=1e-9)
        assert grid.point_data["mode 1"].shape == (len(body.part.nodes), 3)
        assert grid.field_data["frequencies_hz"] == pytest.approx(body.frequencies_hz[6:8])


def _check_other_packages(names: dict[str, Any]) -> None:
    problem, reduced, certificate = names["problem"], names["reduced"], names["certificate"]
    if importlib.util.find_spec("xarray"):
        curves = certificate.to_xarray()
        assert float(curves.error.max()) == certificate.error.max()
        hz = np.array([50.0, 400.0])
        H = morembs.reduced_response(reduced, 2 * np.pi * hz)
        held = morembs.to_xarray(H, hz, problem.interfaces)
        assert complex(held.sel(frequency_hz=400.0, motion="right y", load="left rotation z")) == H[1, 7, 5]
        with refusal("value", "H", "12"):
            morembs.to_xarray(H, hz[:1], problem.interfaces)


@pytest.mark.skipif(not importlib.util.find_spec("pymor"), reason="pyMOR is not installed")
def test_a_body_that_pymor_reduced_is_certified_here() -> None:
    """pyMOR's own transfer function of the full and of the reduced model are those of this package."""
    from pymor.core.logger import set_log_levels
    from pymor.reductors.basic import SOLTIPGReductor
    from pymor.reductors.interpolation import SOBHIReductor

    set_log_levels({"pymor": "ERROR"})
    names: dict[str, Any] = {}
    exec("\n".join(re.findall(r"(?m)^>>> (.*)$", morembs.__doc__ or "")), names)
    held = names["held"]
    full = morembs.to_pymor(held)
    hz = np.array([20.0, 900.0])
    own = morembs.direct_response(held, 2 * np.pi * hz)
    for f, H in zip(hz, own, strict=True):
        assert full.transfer_function.eval_tf(2j * np.pi * f) == pytest.approx(H, rel=1e-8, abs=1e-10 * abs(H).max())
    interpolating, count = SOBHIReductor(full), held.B.shape[1]
    s = 2j * np.pi * np.array([100.0, -100.0, 800.0, -800.0])
    interpolating.reduce(np.repeat(s, count), np.tile(np.eye(count), (4, 1)), np.tile(np.eye(count), (4, 1)))
    for W in (interpolating.V, interpolating.W):
        rom = SOLTIPGReductor(full, W, interpolating.V).reduce()
        galerkin = W is interpolating.V
        reduced = morembs.from_pymor(
            rom, name="interpolated", V=interpolating.V.to_numpy(), W=None if galerkin else W.to_numpy()
        )
        assert reduced.symmetric == galerkin
        (at,), (H,) = (
            respond(model, 2 * np.pi * np.array([800.0]))
            for respond, model in ((morembs.reduced_response, reduced), (morembs.direct_response, held))
        )
        theirs = rom.transfer_function.eval_tf(2j * np.pi * 800.0)
        assert at == pytest.approx(theirs, rel=1e-8, abs=1e-10 * abs(H).max())
        assert at == pytest.approx(H, rel=1e-6, abs=1e-8 * abs(H).max())
        if galerkin:
            (certificate,) = morembs.certify(held, [reduced], [100.0, 800.0])
            assert certificate.limit.upper < 0.1


def test_a_package_that_is_missing_is_named_with_the_line_that_gets_it() -> None:
    with refusal("program", "nowhere"):
        optional("nowhere.inner", "plotting")


def test_matrices_of_scikit_fem_are_a_model() -> None:
    """A bar by scikit-fem's own forms and its CSR matrices; the first bending frequency is that of Euler-Bernoulli."""
    import scipy.sparse as sp
    from skfem import Basis, BilinearForm, ElementHex2, ElementVector, MeshHex, asm
    from skfem.helpers import dot
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    fem = MeshHex.init_tensor(np.linspace(0, 0.5, 9), np.linspace(0, 0.02, 2), np.linspace(0, 0.02, 2))
    basis = Basis(fem, ElementVector(ElementHex2()))
    K = asm(linear_elasticity(*lame_parameters(2.1e11, 0.3)), basis)
    M = asm(BilinearForm(lambda u, v, w: 7850.0 * dot(u, v)), basis)
    assert isinstance(K, sp.csr_matrix)
    places, node = np.unique(np.round(basis.doflocs.T, 9), axis=0, return_inverse=True)
    order = np.argsort(node, kind="stable")
    # scikit-fem numbers the components of a node one after the other.
    component = np.empty(len(node), dtype=int)
    component[order] = np.tile(np.arange(3), len(places))
    model = morembs.FEModel(
        K=K,
        M=M,
        nodes=morembs.Nodes(ids=np.arange(len(places)), xyz=places),
        dofs=morembs.DofMap(node=node.ravel(), component=component),
        source="scikit-fem",
    )
    ends = [
        morembs.make_interface(model, name=name, nodes=np.flatnonzero(np.isclose(places[:, 0], x)), coupling="average")
        for name, x in (("left", 0.0), ("right", 0.5))
    ]
    with morembs.Problem(model, ends) as problem:
        reduced = morembs.Modal(modes=4).reduce(problem)
        assert problem.rigid.shape[1] == 6
    first = np.sqrt(reduced.modes()[0][6]) / (2 * np.pi)
    beam = 4.7300407**2 / (2 * np.pi * 0.5**2) * np.sqrt(2.1e11 * 0.02**2 / 12 / 7850.0)
    assert first == pytest.approx(beam, rel=0.01)
