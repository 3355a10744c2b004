"""Files as scenes of the viewer: what each kind of file shows."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path

from morembs.app.report.style import STYLE
from morembs.base.errors import InputError
from morembs.body.body import Body
from morembs.body.file import read_body
from morembs.body.scenes import scene_of_bodies
from morembs.body.stored import StoredBodies
from morembs.fem.viewer import Scene


def scene_of_files(files: Sequence[Path]) -> tuple[Scene, list[Body]]:
    """What a viewer shows of one file, or of two body files, and the bodies in it.

    Raises:
        InputError: files that cannot be shown.
    """
    stored = [read_body(file) for file in files]
    bodies = [body for each in stored for body in each.bodies.values()]
    if len(stored) == 1:
        return stored_scene(stored[0], files[0].name), bodies
    # The recommended body of each, first of all: these two stand beside each other.
    chosen = [_shown(each) for each in stored]
    order = [*chosen, *(body for body in bodies if body not in chosen)]
    of_file = {id(body): file.name for file, each in zip(files, stored, strict=True) for body in each.bodies.values()}
    names = [f"{of_file[id(body)]}: {body.name}" for body in order]
    return scene_of_bodies(order, " and ".join(file.name for file in files), names=names), order


def stored_scene(stored: StoredBodies, title: str, shown: str = "") -> Scene:
    """All bodies of a file, the body named ``shown`` first.

    Raises:
        InputError: a file without nodes or faces, or one that is damaged.
    """
    if not len(stored.node_ids):
        raise InputError(f"{title} keeps no nodes, so there is nothing to show; write it again with nodes = 'skin'")
    first = stored.bodies[shown] if shown else _shown(stored)
    bodies = list(stored.bodies.values())
    return scene_of_bodies(bodies, title, shown=bodies.index(first))


def _shown(stored: StoredBodies) -> Body:
    """The body with the smallest error, else the first that has modes."""
    limits = {
        name: body.certificate.limit.upper
        for name, body in stored.bodies.items()
        if body.certificate and body.certificate.limits
    }
    best = min(limits, key=lambda name: limits[name], default="")
    return stored.bodies[best] if best else next(iter(stored.bodies.values()))


def still_picture(bodies: Sequence[Body]) -> str:
    """Four modes of the first body as the address of a small picture, for where no script runs; "" without any."""
    if not bodies:
        return ""
    # Not at the top: most commands draw nothing.
    from PIL import Image

    file, small = io.BytesIO(), io.BytesIO()
    bodies[0].plot().savefig(file, format="png", dpi=STYLE.still_dots)
    Image.open(file).convert("RGB").quantize(STYLE.still_colors).save(small, format="png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(small.getvalue()).decode()
