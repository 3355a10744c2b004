"""A first system for a body file: the body hangs by one of its interfaces, a planar member by its start."""

from __future__ import annotations

from pathlib import Path

from morembs.app.kinds import MEMBER, kind_of
from morembs.base.errors import InputError
from morembs.body.file import read_body
from morembs.dynamics.gmp.stored import read_members

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

MEMBER_TEXT = """[simulation]
end = 0.5                   # s; all numbers are in SI units
step = 1e-3

[gravity]
acceleration = [0, 0, -9.81]

[[member]]                  # {modes} bending modes, {length:.4g} m long, end angles to {reach:.3g} rad
name = "{name}"
file = "{file}"{member}
rotation = {{ axis = [1, 0, 0], degrees = 90 }}   # its plane, x and y before, is upright: across it is -y

# Where it hangs: plane joints hold a member within its plane.
[[joint]]
kind = "plane"              # or "plane-fixed", a clamp
between = ["ground", "{name}:start"]
axis = [0, -1, 0]           # across the plane

# [[load]]
# marker = "{name}:end"
# force = [0, 0, -0.01]
# law = {{ kind = "sine", frequency_hz = 2 }}

[output]
path = "{stem}.motion.h5"
"""


def system_text(file: Path, folder: Path) -> str:
    """The system of a ``file`` of bodies or of planar members, to be written into ``folder``.

    Raises:
        InputError: the file cannot be read, or none of its bodies floats and has an interface to hang by.
    """
    stem = file.name.partition(".")[0]
    words = {
        "stem": stem,
        "name": "".join(letter if letter.isalnum() else "_" for letter in stem),
        "file": file.name if file.resolve().parent == folder.resolve() else str(file.resolve()),
    }
    return _of_member(file, words) if kind_of(file) is MEMBER else _of_body(file, words)


def _of_member(file: Path, words: dict[str, str]) -> str:
    members = read_members(file)
    name, member = next(iter(members.items()))
    member_line = f'\nmember = "{name}"             # of {", ".join(members)}' if len(members) > 1 else ""
    return MEMBER_TEXT.format(**words, modes=member.count, length=member.length, reach=member.reach, member=member_line)


def _of_body(file: Path, words: dict[str, str]) -> str:
    bodies = read_body(file).bodies
    floating = [(body.name, body.floating) for body in bodies.values() if body.floating is not None]
    named = next(((name, frame) for name, frame in floating if frame.markers), None)
    if named is None:
        raise InputError(
            f"{file} has no body with a floating frame and an interface that turns; reduce a free part whose "
            'interfaces have coupling = "rigid" or "average"',
            kind="unsupported",
            keyword="frame",
        )
    reduction, frame = named
    markers = list(frame.markers)
    return TEXT.format(
        **words,
        kind=frame.kind,
        count=frame.count,
        mass=frame.integrals.mass,
        reduction=f'\nreduction = "{reduction}"' if len(bodies) > 1 else "",
        others=", ".join(markers[1:]) or "none",
        first=markers[0],
        last=markers[-1],
    )
