"""The Modelica package: compiled and simulated by Rumoca, against a matrix exponential and the simulator of morembs."""

import re

import numpy as np
import pytest

from morembs import elastic_body, make_part, read_body, state_space, write_body
from morembs.body.floating.frame import floating_frame
from morembs.dynamics.multibody import FlexibleBody, PointLoad, System, simulate
from morembs.exporters import export_body
from morembs.exporters.modelica import identifiers
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, Modal
from tests.support.exports import NO_RUMOCA, simulated_modelica
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal


def write_rod(folder, names=("left", "right"), couplings=("rigid", "average"), **options):
    model = steel(box("hex8", (4, 1, 1), (0.5, 0.02, 0.01)), young=1e8)
    faces = [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling=coupling)
        for name, x, coupling in zip(names, (0.0, 0.5), couplings, strict=True)
    ]
    with Problem(model, faces, damping=Damping(beta=1e-4)) as problem:
        reduced = CraigBampton(modes=2).reduce(problem, "cb")
        frame = floating_frame(problem, reduced, origin=(0.1, 0.0, 0.005), **options)
        body = elastic_body(problem, reduced, make_part(problem), floating=frame)
    return write_body(folder / "rod.h5", [body]), body


def test_small_motion(tmp_path):
    source, body = write_rod(tmp_path)
    text = export_body(source, "modelica").paths[0].read_text()
    assert text.startswith('package rod "') and text.endswith("end rod;\n")
    text += "model T rod.Linear b(right_force = {0, 0.2, 1, 0, 0, 0}, left_force = {0, 0, -1, 0, 0.5, 0}); end T;\n"
    motion = simulated_modelica(text, "T", 0.01, [f"b.right_motion[{i}]" for i in range(1, 7)])
    system = state_space(body, ["right:force:y+z", "left:force:z+ry"], ["right:displacement"]).discrete(0.01)
    wanted = (system.C @ system.B) @ [0.2, 1.0, -1.0, 0.5]
    assert motion == pytest.approx(wanted, rel=1e-6, abs=1e-7 * np.abs(wanted).max())
    assert np.abs(wanted[2]) > 1e-5


@pytest.mark.parametrize("options", [{}, {"kind": "tangent", "interfaces": ("left",)}], ids=["mean axes", "tangent"])
def test_large_rotations(tmp_path, options):
    """A spinning rod under gravity and a force at its end; a tangent frame has all couplings."""
    source, body = write_rod(tmp_path, **options)
    text = export_body(source, "modelica").paths[0].read_text()
    text += """model T
      rod.Floating b(g = {0, 0, -9.81}, w(start = {3, -2, 20}), v(start = {0.1, 0, 0}));
    equation
      b.right_f = transpose(b.R)*{0, 5, 10};
      b.right_t = transpose(b.R)*{0.05, 0, 0};
      b.left_f = zeros(3);
      b.left_t = zeros(3);
    end T;"""
    names = [f"b.{name}_r[{i}]" for name in ("left", "right") for i in (1, 2, 3)]
    positions = simulated_modelica(text, "T", 0.05, names)
    system = System(gravity=(0, 0, -9.81))
    rod = system.add(
        FlexibleBody(
            read_body(source).bodies["cb"].floating,
            name="rod",
            angular_velocity=(3.0, -2.0, 20.0),
            velocity=(0.1, 0.0, 0.0),
        )
    )
    system.add(PointLoad(rod.marker("right"), force=(0.0, 5.0, 10.0), moment=(0.05, 0.0, 0.0)))
    result = simulate(system, end=0.05, step=5e-5)
    wanted = np.concatenate([result.position(rod.marker(name))[-1] for name in ("left", "right")])
    assert positions == pytest.approx(wanted, abs=2e-6)
    # It turned by a radian and bent by millimetres.
    bent = body.floating.markers["right"].motion[:3] @ result.elastic(rod).T
    assert np.abs(bent).max() > 1.5e-3


def test_names_that_are_no_identifiers_are_mapped_and_listed(tmp_path):
    given = ["big end", "big_end", "2nd", "der", "Größe", "MultiBody"]
    known = identifiers(given, ["MultiBody"])
    assert known == {
        "big_end": "big_end",
        "der": "der_2",
        "MultiBody": "MultiBody_2",
        "big end": "big_end_2",
        "2nd": "n2nd",
        "Größe": "Gr__e",
    }
    source, _ = write_rod(tmp_path, names=("big end", "der"))
    done = export_body(source, "modelica", path=tmp_path / "my rod.mo")
    notes = "\n".join(done.notes)
    for name, ident in (("big end", "big_end"), ("der", "der_2"), ("my rod", "my_rod")):
        assert f"{name!r} is no Modelica identifier; it is {ident} in the file" in notes
    assert "rename it, or load it by its path" in notes
    text = done.paths[0].read_text()
    assert text.startswith("package my_rod ") and "big_end_force[6]" in text and "big end" not in text
    pytest.importorskip("rumoca", reason=NO_RUMOCA).format(text)


def test_names_of_interfaces_do_not_meet_those_of_the_models(tmp_path):
    """Nor those of each other: a force of one is no frame of another."""
    for names in (("q", "q_f"), ("B", "f"), ("w", "R")):
        (tmp_path / names[0]).mkdir()
        source, _ = write_rod(tmp_path / names[0], names=names)
        text = export_body(source, "modelica").paths[0].read_text()
        for model in re.findall(r"^  model .*?^  end", text, re.MULTILINE | re.DOTALL):
            pattern = r"^ +(?:(?:parameter|input|output) )?(?:Real|Integer|Modelica\S+) (\w+)"
            declared = re.findall(pattern, model, re.MULTILINE)
            assert len(set(declared)) == len(declared) > 5
        text += f"model T rod.Linear b({names[0]}_force = {{0, 0, 1, 0, 0, 0}}, {names[1]}_force = zeros(6)); end T;\n"
        assert simulated_modelica(text, "T", 0.01, [f"b.{names[0]}_motion[3]"])[0] > 0


def test_every_model_is_modelica(tmp_path):
    """The frames of the standard library need that library to run; their syntax needs none."""
    rumoca = pytest.importorskip("rumoca", reason=NO_RUMOCA)
    source, body = write_rod(tmp_path)
    text = export_body(source, "modelica").paths[0].read_text()
    assert re.findall(r"^  model (\w+)", text, re.MULTILINE) == ["Linear", "Floating", "MultiBody"]
    rumoca.format(text)
    with pytest.raises(Exception, match="unexpected"):
        rumoca.format(text.replace("  extends Floating(", "  extends Floating((", 1))
    # Every bit of the numbers is there.
    (line,) = re.findall(r"parameter Real Ke\[n, n\] = (.*);", text)
    assert np.array_equal(np.array(eval(line.replace("{", "[").replace("}", "]"))), body.floating.Ke)


def test_what_the_package_leaves_out_is_said(tmp_path):
    source, _ = write_rod(tmp_path, couplings=("rigid", "direct"))
    done = export_body(source, "modelica")
    assert "only the model Linear has right: the others need frames that turn" in done.notes
    model = steel(box("hex8", (3, 1, 1), (0.3, 0.02, 0.01)))
    with Problem(model) as problem:
        reduced = Modal(modes=2).reduce(problem, "cb")
        bare = write_body(tmp_path / "bare.h5", [elastic_body(problem, reduced, make_part(problem))])
    with refusal("missing", "", "cb"):
        export_body(bare, "modelica")
    assert not (tmp_path / "bare.mo").exists()
