"""glTF 2.0 in one binary file (.glb): the skin of a body with its modes as animations, for viewers of pictures.

ISO/IEC 12113:2022. Lengths are in m and axes those of the model; glTF calls y up, which models do not know.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.limits import Positive, PositiveCount
from morembs.body.shapes import Shapes, shapes_on
from morembs.body.tolerances import TOL as BODY
from morembs.exporters.base import ExportContext, Exported, Exporter
from morembs.exporters.reduced import refuse_two_sided
from morembs.exporters.simscape import quaternion
from morembs.exporters.tolerances import TOL
from morembs.storage.safefile import replacing


class Code(IntEnum):
    """Numbers of glTF 2.0, those of OpenGL: types of components, and purposes of pieces of the buffer."""

    UNSIGNED_SHORT = 5123
    UNSIGNED_INT = 5125
    FLOAT = 5126
    ARRAY_BUFFER = 34962
    ELEMENT_ARRAY_BUFFER = 34963


class Container:
    """The binary container: magic word, version, and its two chunks, each padded to four bytes."""

    MAGIC, VERSION = b"glTF", 2
    JSON, BINARY = b"JSON", b"BIN\0"


@dataclass(frozen=True, kw_only=True)
class Gltf(Exporter):
    """The first elastic ``modes`` (as many as the file keeps), each drawn with a ``largest`` displacement in units of
    the longest side of the body, and animated once in ``seconds``."""

    name: ClassVar[str] = "gltf"
    suffix: ClassVar[str] = ".glb"
    about: ClassVar[str] = "glTF 2.0: the skin with its modes as animations, for Blender, slides and web pages"
    takes_massless: ClassVar[bool] = True
    needs_frame: ClassVar[bool] = False

    modes: PositiveCount = 12
    largest: Positive = BODY.drawn_displacement
    seconds: Positive = 2.0

    def _write(self, context: ExportContext) -> Exported:
        refuse_two_sided(context.body)  # their modes are complex: no picture of one phase shows them
        shapes = shapes_on(context.body.view(self.modes))
        if shapes is None:
            raise InputError(
                f'body {context.body.name!r} has no elastic modes or no elements to show them on; keep nodes = "skin" '
                'or "all" of a model with elements',
                kind="unsupported",
                keyword="nodes",
            )
        if not all(
            np.abs(each).max() <= np.finfo("f4").max for each in (shapes.points, shapes.motion, shapes.frequencies_hz)
        ):
            raise InputError(
                f"body {context.body.name!r} has coordinates or modes that are no numbers of 32 bits, as in glTF; "
                "check the units",
                keyword="units",
            )
        content = _content(context, shapes, self.largest, self.seconds)
        with replacing(context.path) as file:
            file.write(content)
            file.check()
        return Exported(paths=(context.path,), notes=(f"{len(shapes.motion)} modes, drawn larger than they are",))


@dataclass(kw_only=True)
class _Buffer:
    """The one buffer of a file, and where its arrays lie in it."""

    data: bytearray = field(default_factory=bytearray)
    views: list[dict[str, Any]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def add(self, values: NDArray[Any], code: Code, kind: str, target: Code | None = None) -> int:
        """Number of the accessor of ``values`` (n,) or (n, 3), with their least and largest ones."""
        self.data += b"\0" * (-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes}
        self.views.append(view | ({} if target is None else {"target": int(target)}))
        self.data += values.tobytes()
        rows = values.reshape(len(values), -1)
        self.accessors.append(
            {
                "bufferView": len(self.views) - 1,
                "componentType": int(code),
                "count": len(values),
                "type": kind,
                "min": rows.min(axis=0).tolist(),
                "max": rows.max(axis=0).tolist(),
            }
        )
        return len(self.accessors) - 1


def _content(context: ExportContext, shapes: Shapes, largest: float, seconds: float) -> bytes:
    """The file: a node of the body, below it those of its skin and of its interfaces."""
    buffer, count = _Buffer(), len(shapes.motion)
    mesh = _mesh(buffer, shapes, largest)
    frames = [_frame(name, context) for name in context.source.interfaces]
    name = context.body.name
    document = {
        "asset": {"version": "2.0", "generator": "morembs"},
        "scene": 0,
        "scenes": [{"name": name, "nodes": [0]}],
        "nodes": [
            {"name": name, "children": list(range(1, 2 + len(frames)))},
            {"name": f"{name} skin", "mesh": 0, "weights": [0.0] * count},
            *frames,
        ],
        "meshes": [mesh],
        "materials": [
            {
                "name": "body",
                "doubleSided": True,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.5, 0.5, 0.5, 1.0],
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.5,
                },
            }
        ],
        "animations": _animations(buffer, shapes, seconds),
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
        "extras": {"frequencies_hz": shapes.frequencies_hz.tolist()},
    }
    text = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary = bytes(buffer.data) + b"\0" * (-len(buffer.data) % 4)
    chunks = b"".join(
        struct.pack("<I", len(chunk)) + kind + chunk
        for kind, chunk in ((Container.JSON, text), (Container.BINARY, binary))
    )
    # The length is that of the whole file, with its head of three words.
    return Container.MAGIC + struct.pack("<II", Container.VERSION, 12 + len(chunks)) + chunks


def _mesh(buffer: _Buffer, shapes: Shapes, largest: float) -> dict[str, Any]:
    """Skin and modes; each mode is a morph target, of displacements as they are drawn."""
    points, triangles = shapes.points.astype("<f4"), shapes.triangles.ravel()
    small = len(points) <= np.iinfo(np.uint16).max
    position = buffer.add(points, Code.FLOAT, "VEC3", Code.ARRAY_BUFFER)
    indices = buffer.add(
        triangles.astype("<u2" if small else "<u4"),
        Code.UNSIGNED_SHORT if small else Code.UNSIGNED_INT,
        "SCALAR",
        Code.ELEMENT_ARRAY_BUFFER,
    )
    side = float(np.ptp(shapes.points, axis=0).max())
    sizes = [float(np.linalg.norm(motion, axis=1).max()) for motion in shapes.motion]
    # A mode of what lies under the skin alone, as a mass on a spring, leaves the skin at rest.
    scales = [largest * side / size if size > 0 else 1.0 for size in sizes]
    targets = [
        {"POSITION": buffer.add((scale * motion).astype("<f4"), Code.FLOAT, "VEC3", Code.ARRAY_BUFFER)}
        for scale, motion in zip(scales, shapes.motion, strict=True)
    ]
    names = _mode_names(shapes)
    return {
        "name": shapes.body,
        "primitives": [
            {"attributes": {"POSITION": position}, "indices": indices, "material": 0, "targets": targets, "mode": 4}
        ],
        # Programs that show morph targets take their names from here; the shape of unit modal mass is the target over
        # its scale.
        "extras": {"targetNames": names, "frequencies_hz": shapes.frequencies_hz.tolist(), "scale": scales},
    }


def _mode_names(shapes: Shapes) -> list[str]:
    return [f"mode {number}: {hz:,.6g} Hz" for number, hz in enumerate(shapes.frequencies_hz, start=1)]


def _animations(buffer: _Buffer, shapes: Shapes, seconds: float) -> list[dict[str, Any]]:
    """One for each mode: a period of its sine, in steps between which viewers go straight."""
    times = np.linspace(0.0, seconds, TOL.animation_steps + 1).astype("<f4")
    sine = np.sin(2 * np.pi * np.linspace(0.0, 1.0, len(times)))
    # It ends where it began.
    sine[-1] = 0.0
    count, clock = len(shapes.motion), buffer.add(times, Code.FLOAT, "SCALAR")
    animations = []
    for number, (name, hz) in enumerate(zip(_mode_names(shapes), shapes.frequencies_hz, strict=True)):
        weights = np.zeros((len(times), count), dtype="<f4")
        weights[:, number] = sine
        output = buffer.add(weights.ravel(), Code.FLOAT, "SCALAR")
        animations.append(
            {
                "name": name,
                "samplers": [{"input": clock, "output": output, "interpolation": "LINEAR"}],
                "channels": [{"sampler": 0, "target": {"node": 1, "path": "weights"}}],
                "extras": {"mode": number + 1, "frequency_hz": float(hz)},
            }
        )
    return animations


def _frame(name: str, context: ExportContext) -> Mapping[str, Any]:
    """An empty node at an interface, turned as its frame is."""
    interface = context.source.interfaces[name]
    node: dict[str, Any] = {"name": name, "translation": [float(x) for x in interface.point]}
    if interface.kind.framed:
        w, x, y, z = quaternion(interface.axes.T).tolist()
        node["rotation"] = [x, y, z, w]
    return node | {"extras": {"interface": name, "coupling": str(interface.coupling)}}


__all__ = ["Gltf"]
