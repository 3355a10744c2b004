"""A first system for a body file: the body hangs by one of its interfaces."""

from __future__ import annotations

from pathlib import Path

from morembs.base.errors import InputError
from morembs.body.file import read_body

TEXT = """[simulation]
end = 0.5                   # s; all numbers are in SI units
step = 1e-3

[gravity]
acceleration = [0, 0, -9.81]

[[body]]                    # {kind} frame, {count} elastic coordinates, {mass:.4g} kg
name = "{name}"
file = "{file}"{reduction}
# position = [0, 0, 0]      # of the origin of its model; rotation = {{ axis = [0, 1, 0], degrees = 90 }}

# Where it hangs. There are too: {others}
[[joint]]
kind = "revolute"           # or "fixed", "spherical", "prismatic", ...
between = ["ground", "{name}:{first}"]
axis = [0, 1, 0]

# [[load]]
# marker = "{name}:{last}"
# force = [0, 0, -10]
# law = {{ kind = "sine", frequency_hz = 20 }}

# [[observe]]               # its moving mesh for ParaView
# body = "{name}"
# path = "{stem}.vtkhdf"

[output]
path = "{stem}.motion.h5"
"""


def system_text(file: Path, folder: Path) -> str:
    """The system of a body ``file``, to be written into ``folder``.

    Raises:
        InputError: the file cannot be read, or none of its bodies floats and has an interface to hang by.
    """
    bodies = read_body(file).bodies
    floating = [(body.name, body.floating) for body in bodies.values() if body.floating is not None]
    named = next(((name, frame) for name, frame in floating if frame.markers), None)
    if named is None:
        raise InputError(
            f"{file} has no body with a floating frame and an interface that turns; reduce a free part whose "
            'interfaces have coupling = "rigid" or "average"'
        )
    reduction, frame = named
    markers = list(frame.markers)
    stem = file.name.partition(".")[0]
    place = file.name if file.resolve().parent == folder.resolve() else str(file.resolve())
    return TEXT.format(
        kind=frame.kind,
        count=frame.count,
        mass=frame.integrals.mass,
        name="".join(letter if letter.isalnum() else "_" for letter in stem),
        file=place,
        reduction=f'\nreduction = "{reduction}"' if len(bodies) > 1 else "",
        others=", ".join(markers[1:]) or "none",
        first=markers[0],
        last=markers[-1],
        stem=stem,
    )
