"""What exporters write is read again before it gets its name: another body is refused, and no file is left."""

from dataclasses import replace

import numpy as np
import pytest

from morembs import read_body
from morembs.base.errors import OutputError
from morembs.exporters import EXPORTERS, Exported, make_exporter
from morembs.exporters.op4 import OP4Exporter
from morembs.reducers import CraigBampton
from morembs.storage.safefile import replacing
from tests.support.fmus import strip
from tests.support.refusals import refusal

# Target, its options and the end of the file.
WAYS = [
    ("matrix-market", {}, ""),
    ("op4", {}, ""),
    ("op4", {"text": True}, ""),
    ("dmig", {}, ""),
    ("abaqus", {}, ""),
    ("simscape", {}, ""),
    ("sid", {}, ""),
    ("sid", {"nodes": "all"}, ""),
    ("statespace", {}, ".npz"),
    ("statespace", {"held": ["left-end"], "outputs": ["left-end:reaction"], "inputs": ["tip:force"]}, ".mat"),
    ("statespace", {"step": 1e-5}, ".npz"),
]


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return strip(tmp_path_factory.mktemp("strip"), CraigBampton(modes=3))


def careless(to, options, change):
    """The exporter ``to``, which writes another body than it was given."""

    class Careless(EXPORTERS[to]):
        def _write(self, context):
            body = change(context.body)
            bodies = replace(context.source, bodies={body.name: body})
            return super()._write(replace(context, body=body, source=bodies))

    return Careless(**vars(make_exporter(to, options)))


def stiffer(body):
    factor = 1 + 1e-4
    return replace(
        body,
        stiffness_matrix=factor * body.stiffness_matrix,
        floating=replace(body.floating, Ke=factor * body.floating.Ke),
    )


def turned(body):
    """One motion of the tip with the other sign; the frame follows the other end."""
    B, frame = body.input_matrix.copy(), body.floating
    B[:, 8] *= -1
    motion = frame.markers["tip"].motion * np.array([1, 1, -1, 1, 1, 1])[:, None]
    markers = {**frame.markers, "tip": replace(frame.markers["tip"], motion=motion)}
    return replace(body, input_matrix=B, output_matrix=B.T, floating=replace(frame, markers=markers))


@pytest.mark.parametrize("change", [stiffer, turned])
@pytest.mark.parametrize(("to", "options", "ending"), WAYS)
def test_another_body_gets_no_name(source, tmp_path, to, options, ending, change):
    stored, path = read_body(source), tmp_path / f"out{ending}"
    body = stored.bodies["strip"]
    path.write_bytes(b"what was there")
    with refusal("output", "", path, "Hz", by=OutputError):
        careless(to, options, change).export(stored, body, path)
    assert [each.name for each in tmp_path.iterdir()] == [path.name] and path.read_bytes() == b"what was there"
    path.unlink()
    written = make_exporter(to, options).export(stored, body, path).paths
    assert set(tmp_path.iterdir()) == set(written)


class Broken(OP4Exporter):
    def _write(self, context):
        with replacing(context.path) as file:
            file.write(b"nothing of the kind")
        return Exported(paths=(context.path,))


def test_a_file_that_cannot_be_read_gets_no_name(source, tmp_path):
    stored = read_body(source)
    with refusal("output", by=OutputError):
        Broken().export(stored, stored.bodies["strip"], tmp_path / "o")
    assert not list(tmp_path.iterdir())
