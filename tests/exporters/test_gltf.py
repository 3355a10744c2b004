"""glTF: what the validator of Khronos says of the file, and what VTK draws from it."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from morembs import read_body
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.body.shapes import shapes_on
from morembs.exporters import export_body, make_exporter
from tests.support import decks
from tests.support.node import NODE, evaluated, fetched
from tests.support.refusals import refusal

# The names that a user may give are in the file as they are.
NAME = 'lef"t <ü>'


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gltf")
    tables = {
        "interface": f"name = '{NAME}'\nnodes = \"set:LEFT\"",
        "interface2": 'name = "right"\nnodes = "set:RIGHT"',
    }
    run_job(load_job(decks.folder(folder, tables, decks.deck(decks.BEAM))))
    return folder / "part.h5"


@pytest.fixture(scope="module")
def exported(body):
    return export_body(body, "gltf").paths[0]


def parts_of(path):
    """The document and the buffer of a file, by the standard."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    rest, other = struct.unpack_from("<I4s", content, 20 + size)
    assert (kind, other) == (b"JSON", b"BIN\0") and 28 + size + rest == len(content)
    return json.loads(content[20 : 20 + size]), content[28 + size :]


@pytest.mark.skipif(NODE is None, reason="npm is not installed")
def test_the_validator_of_khronos_finds_nothing(exported, tmp_path):
    package = fetched("gltf-validator@2.0.0-dev.3.10", tmp_path)
    report = evaluated(
        "require(process.argv[1]).validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[2])))"
        ".then(report => console.log(JSON.stringify(report)))",
        package,
        exported,
    )
    assert report["issues"]["messages"] == []
    assert report["info"]["animationCount"] == 10 and report["info"]["hasMorphTargets"]
    assert report["info"]["totalVertexCount"] == 7 * 3 * 3 - 5


@pytest.mark.parametrize("mode", [0, 2])
def test_vtk_draws_each_mode_a_quarter_of_a_period_later(body, exported, mode):
    vtk = pytest.importorskip("vtk", reason="VTK is not installed: pip install vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    reader = vtk.vtkGLTFReader()
    reader.SetFileName(str(exported))
    reader.ApplyDeformationsToGeometryOn()
    reader.UpdateInformation()
    shapes = shapes_on(read_body(body).bodies["cb"].view(12))
    assert reader.GetNumberOfAnimations() == len(shapes.motion) == 10
    assert reader.GetAnimationName(mode) == f"mode {mode + 1}: {shapes.frequencies_hz[mode]:,.6g} Hz"
    assert reader.GetAnimationDuration(mode) == 2.0
    reader.EnableAnimation(mode)
    reader.SetFrameRate(60)
    drawn = {}
    for time in (0.0, 0.5):
        reader.GetOutputInformation(0).Set(vtk.vtkStreamingDemandDrivenPipeline.UPDATE_TIME_STEP(), time)
        reader.Update()
        block = reader.GetOutput()
        while not block.IsA("vtkPolyData"):
            block = block.GetBlock(0)
        drawn[time] = vtk_to_numpy(block.GetPoints().GetData()).astype(float)
    np.testing.assert_allclose(drawn[0.0], shapes.points, atol=1e-8)
    moved, motion = drawn[0.5] - drawn[0.0], shapes.motion[mode]
    wanted = motion * 0.07 * 0.06 / np.linalg.norm(motion, axis=1).max()
    np.testing.assert_allclose(moved, wanted, atol=1e-5 * 0.06)


def test_interfaces_are_empty_nodes_with_their_frames(body, tmp_path):
    stored = read_body(body)
    turned = replace(stored.interfaces["right"], axes=Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix())
    stored = replace(stored, interfaces={**stored.interfaces, "right": turned})
    done = make_exporter("gltf").export(stored, stored.bodies["cb"], tmp_path / "turned.glb", body)
    document, _ = parts_of(done.paths[0])
    nodes = {node["name"]: node for node in document["nodes"]}
    assert [document["nodes"][k]["name"] for k in document["nodes"][0]["children"]] == ["cb skin", NAME, "right"]
    for name, interface in stored.interfaces.items():
        assert "mesh" not in nodes[name] and nodes[name]["translation"] == interface.point.tolist()
        # A node takes its own axes, the rows of a frame, to those of its parent.
        axes = Rotation.from_quat(nodes[name]["rotation"]).apply(np.eye(3))
        np.testing.assert_allclose(axes, interface.axes, atol=1e-12)


def test_frequencies_are_in_the_extras_and_targets_are_the_modes(body, exported):
    document, data = parts_of(exported)
    modes = read_body(body).bodies["cb"]
    wanted = modes.frequencies_hz[6:].tolist()
    [mesh] = document["meshes"]
    assert document["extras"]["frequencies_hz"] == mesh["extras"]["frequencies_hz"] == wanted
    assert [animation["extras"]["frequency_hz"] for animation in document["animations"]] == wanted
    assert [len(mesh["extras"]["targetNames"]), len(document["nodes"][1]["weights"])] == [10, 10]
    shapes = shapes_on(modes.view(12))
    for number, target in enumerate(mesh["primitives"][0]["targets"]):
        accessor = document["accessors"][target["POSITION"]]
        view = document["bufferViews"][accessor["bufferView"]]
        stored = np.frombuffer(data, "<f4", 3 * accessor["count"], view["byteOffset"]).reshape(-1, 3)
        shape = stored / mesh["extras"]["scale"][number]
        np.testing.assert_allclose(shape, shapes.motion[number], atol=1e-6 * np.abs(shapes.motion[number]).max())


def test_options_and_the_same_bytes(body, tmp_path):
    options = {"modes": 2, "largest": 0.2, "seconds": 5.0}
    first, again = (
        export_body(body, "gltf", path=tmp_path / name, options=options).paths[0] for name in ("a.glb", "b.glb")
    )
    assert first.read_bytes() == again.read_bytes()
    document, _ = parts_of(first)
    assert len(document["animations"]) == 2
    accessor = document["accessors"][document["animations"][0]["samplers"][0]["input"]]
    assert accessor["max"] == [5.0]
    targets = [document["accessors"][each["POSITION"]] for each in document["meshes"][0]["primitives"][0]["targets"]]
    for accessor in targets:
        assert max(np.abs([accessor["min"], accessor["max"]]).max(axis=1)) <= 0.2 * 0.06 * (1 + 1e-6)


def test_a_mode_that_leaves_the_skin_at_rest_is_a_target_at_rest(body, tmp_path, monkeypatch):
    """As one of a mass on a spring within has; numbers beyond those of 32 bits are refused."""
    stored = read_body(body)
    own = type(stored.bodies["cb"]).view
    for scale, name in (([0.0, 1.0], "still.glb"), ([1.0, np.inf], "far.glb")):
        factor = np.array(scale)[:, None, None]
        with monkeypatch.context() as patch, np.errstate(invalid="ignore"):
            patch.setattr(
                type(stored.bodies["cb"]),
                "view",
                lambda self, modes, factor=factor: replace(own(self, 2), motion=own(self, 2).motion * factor),
            )
            if name == "still.glb":
                path = export_body(body, "gltf", path=tmp_path / name).paths[0]
                continue
            with refusal("value", "units", "32"):
                export_body(body, "gltf", path=tmp_path / name)
    document, _ = parts_of(path)
    targets = [document["accessors"][each["POSITION"]] for each in document["meshes"][0]["primitives"][0]["targets"]]
    assert [max(each["max"]) > 0 for each in targets] == [False, True] and not (tmp_path / "far.glb").exists()


def test_a_body_without_a_skin_is_refused(tmp_path):
    decks.folder(tmp_path, {"output": 'path = "part.h5"\nnodes = "interfaces"'})
    run_job(load_job(tmp_path / "job.toml"))
    with refusal("unsupported", "nodes", "skin"):
        export_body(tmp_path / "part.h5", "gltf")
    assert not (tmp_path / "part.glb").exists()
    with refusal("unknown", "to", "gltf"):
        make_exporter("blender")
