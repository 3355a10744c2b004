"""Modelica package of an elastic body: small motion, large rotations, and frames of Modelica.Mechanics.MultiBody.

The equations of large rotations are those of Wallrapp (1994) in the integrals of ``body.floating``: every
term in the elastic coordinates up to the second order, in axes of the body. They need no library; the standard one has
no elastic bodies to fill with data.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame, InterfaceMarker
from morembs.exporters.base import ExportContext, Exported, Exporter
from morembs.exporters.ports import Port, ports_of_file
from morembs.exporters.state_space import StateSpace, state_space
from morembs.storage.safefile import replacing

# Modelica 3.6, section 2.3.3.
KEYWORDS = frozenset(
    re.findall(
        r"\w+",
        "algorithm and annotation block break class connect connector constant constrainedby der discrete each "
        "else elseif elsewhen encapsulated end enumeration equation expandable extends external false final flow "
        "for function if import impure in initial inner input loop model not operator or outer output package "
        "parameter partial protected public pure record redeclare replaceable return stream then true type when "
        "while within time",
    )
)
AXES = tuple((i, j) for i in (1, 2, 3) for j in (1, 2, 3))
# Names that the models have themselves.
OWN = frozenset(("Linear", "Floating", "MultiBody", "Modelica"))


def identifiers(names: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """Names -> Modelica identifiers: valid ones stay as they are, and no two are alike."""
    result: dict[str, str] = {}
    used = set(taken) | KEYWORDS
    for name in sorted(names, key=lambda name: not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII)):
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        plain = plain if re.match(r"[A-Za-z_]", plain) else f"n{plain}"
        number, known = 2, plain
        while known in used:
            known, number = f"{plain}_{number}", number + 1
        result[name] = known
        used.add(known)
    return result


@dataclass(frozen=True, kw_only=True)
class Modelica(Exporter):
    """A package with the models Linear (small motion, forces in and motions out), Floating (large rotations; no library
    is needed) and MultiBody (the same with frames of the Modelica Standard Library)."""

    name: ClassVar[str] = "modelica"
    suffix: ClassVar[str] = ".mo"
    about: ClassVar[str] = "Modelica package: small motion, large rotations, frames of MultiBody"
    needs_frame: ClassVar[bool] = False
    holds: ClassVar[frozenset[str]] = frozenset({"damping"})

    def _write(self, context: ExportContext) -> Exported:
        source, body = context.source, context.body
        names = identifiers(source.interfaces, OWN)
        package = identifiers([re.sub(r"\.mo$", "", context.path.name)], OWN)
        ((given, known),) = package.items()
        ports = ports_of_file(source)
        if not ports:
            raise InputError(
                f"body {body.name!r} has no interface, so no force can act on it; add an [[interface]] to its job",
                kind="missing",
            )
        rows = list(dict.fromkeys(port.interface for port in ports))
        system = state_space(
            source, [f"{name}:force" for name in rows], [f"{name}:displacement" for name in rows], name=body.name
        )
        notes = [
            f"{name!r} is no Modelica identifier; it is {ident} in the file"
            for name, ident in (*names.items(), (given, known))
            if name != ident
        ]
        if context.path.name != f"{known}.mo":
            notes.append(f"a tool wants the package {known} in the file {known}.mo; rename it, or load it by its path")
        parts = [_linear(system, ports, names)]
        if body.floating is None or not body.floating.elastic.shape[1]:
            notes.append("only the model Linear is there: the body has no floating frame with elastic coordinates")
        else:
            markers = {name: body.floating.markers[name] for name in source.interfaces if name in body.floating.markers}
            parts.append(_floating(body.floating, markers, names))
            if markers:
                axes = {name: source.interfaces[name].axes for name in markers}
                parts.append(_multibody(markers, axes, names))
            left = [name for name in source.interfaces if name not in markers]
            if left:
                notes.append(f"only the model Linear has {', '.join(left)}: the others need frames that turn")
        with replacing(context.path) as file:
            file.write(f'package {known} "Elastic body, SI units"\n'.encode())
            for part in parts:
                for line in part:
                    file.write(f"  {line}\n".encode("ascii"))
                file.check()
            file.write(f"end {known};\n".encode())
        return Exported(paths=(context.path,), notes=tuple(notes))


def _linear(system: StateSpace, ports: Sequence[Port], names: dict[str, str]) -> Iterator[str]:
    """Normal coordinates of the whole body under the forces on its interfaces."""
    n = len(system.A) // 2
    yield 'model Linear "Small motion about the place at rest"'
    yield f'  parameter Integer n = {n} "Number of coordinates";'
    yield f'  parameter Real K[n, n] = {_matrix(-system.A[n:, :n])} "Stiffness by mass";'
    yield f'  parameter Real D[n, n] = {_matrix(-system.A[n:, n:])} "Damping by mass";'
    at = 0
    terms, outputs = [], []
    for name in dict.fromkeys(port.interface for port in ports):
        ident, words = names[name], [port.word for port in ports if port.interface == name]
        some = slice(at, at + len(words))
        at += len(words)
        about = ", ".join(dict.fromkeys(words))
        yield f"  parameter Real {ident}_B[n, {len(words)}] = {_matrix(system.B[n:, some])};"
        yield f"  parameter Real {ident}_C[{len(words)}, n] = {_matrix(system.C[some, :n])};"
        yield f'  input Real {ident}_force[{len(words)}] "{about} in N, N.m";'
        yield f'  output Real {ident}_motion[{len(words)}] "{about} in m, rad";'
        terms.append(f"{ident}_B*{ident}_force")
        outputs.append(f"  {ident}_motion = {ident}_C*q;")
    yield '  Real q[n](each start = 0, each fixed = true) "Coordinates";'
    yield "  Real dq[n](each start = 0, each fixed = true);"
    yield "equation"
    yield "  der(q) = dq;"
    yield f"  der(dq) = {' + '.join(terms)} - K*q - D*dq;"
    yield from outputs
    yield "end Linear;"


def _floating(frame: FloatingFrame, markers: dict[str, InterfaceMarker], names: dict[str, str]) -> Iterator[str]:
    """Newton and Euler for the frame, Lagrange for the elastic coordinates."""
    yield 'model Floating "Large rotations of a body whose deflections are small"'
    yield from _parameters(frame)
    for name, marker in markers.items():
        yield from _marker(names[name], marker)
    yield from _VARIABLES
    for i, j in AXES:
        yield f"  Real u{i}{j}[n], d{i}{j}[n], p{i}{j}[n];"
    yield "equation"
    yield from _EQUATIONS
    for i, j in AXES:
        F = f"F{i}{j}" if i <= j else f"transpose(F{j}{i})"
        yield f"  u{i}{j} = {F}*q;"
        yield f"  d{i}{j} = {F}*dq;"
        yield f"  p{i}{j} = x{i}{j} + u{i}{j};"
    yield f"  N = {_square('p{0}{1}*dq')};"
    yield f"  G = {_square('x{0}{1}*q + x{1}{0}*q + u{0}{1}*q')};"
    yield "  Jq = inertia + (G[1, 1] + G[2, 2] + G[3, 3])*identity(3) - G;"
    yield from _balances([names[name] for name in markers])
    yield "end Floating;"


def _parameters(frame: FloatingFrame) -> Iterator[str]:
    """The integrals of the body, and its gravity."""
    integrals, n = frame.integrals, frame.count
    values = {
        "first[3]": integrals.first,
        "inertia[3, 3]": integrals.inertia,
        "Ct[n, 3]": integrals.Ct,
        "Cr[n, 3]": integrals.Cr,
        "Me[n, n]": integrals.Me,
        "Ke[n, n]": frame.Ke,
        "De[n, n]": frame.De,
        **{f"x{i}{j}[n]": integrals.x_phi[i - 1, j - 1] for i, j in AXES},
        # [l, k] of int phi_a,k phi_b,l; those of (b, a) are transposed.
        **{f"F{i}{j}[n, n]": integrals.phi_phi[i - 1, j - 1].T for i, j in AXES if i <= j},
    }
    yield f'  parameter Integer n = {n} "Number of elastic coordinates";'
    yield f"  parameter Real mass = {integrals.mass!r};"
    yield '  parameter Real g[3] = {0, 0, 0} "Gravity along the inertial axes";'
    for name, value in values.items():
        yield f"  parameter Real {name} = {_matrix(value)};"


def _marker(ident: str, marker: InterfaceMarker) -> Iterator[str]:
    """An interface with its force, place and rotation."""
    yield f"  parameter Real {ident}_point[3] = {_matrix(marker.point)};"
    yield f"  parameter Real {ident}_phi[3, n] = {_matrix(marker.motion[:3])};"
    yield f"  parameter Real {ident}_psi[3, n] = {_matrix(marker.motion[3:])};"
    yield f'  Real {ident}_f[3] "Force on the body, axes of the body";'
    yield f'  Real {ident}_t[3] "Moment on the body about the interface, axes of the body";'
    yield f'  Real {ident}_s[3] "Place in the body";'
    yield f'  Real {ident}_r[3] "Place in the inertial frame";'
    yield f'  Real {ident}_turn[3] "Small rotation in the body, twice the Rodrigues parameters";'


def _balances(idents: Sequence[str]) -> Iterator[str]:
    """Forces, moments and work of the elastic coordinates, with those of the interfaces ``idents``."""
    force, moment, work = ["mass*g_body"], ["cross(mu, g_body)"], ["Ct*g_body"]
    for ident in idents:
        yield f"  {ident}_s = {ident}_point + {ident}_phi*q;"
        yield f"  {ident}_r = r + R*{ident}_s;"
        yield f"  {ident}_turn = {ident}_psi*q;"
        force.append(f"{ident}_f")
        moment.append(f"cross({ident}_s, {ident}_f) + {ident}_t")
        share = f"({ident}_t - 0.5*cross({ident}_turn, {ident}_t))/(1 + 0.25*({ident}_turn*{ident}_turn))"
        work.append(f"transpose({ident}_phi)*{ident}_f + transpose({ident}_psi)*({share})")
    yield f"  mass*a + cross(z, mu) + transpose(Ct)*der(dq) + 2*cross(w, drift) + spin*mu = {' + '.join(force)};"
    yield (
        "  cross(mu, a) + Jq*z + turned*der(dq) + 2*((N[1, 1] + N[2, 2] + N[3, 3])*w - transpose(N)*w) + "
        f"cross(w, Jq*w) = {' + '.join(moment)};"
    )
    turning = " + ".join(f"spin[{i}, {j}]*p{i}{j}" for i, j in AXES)
    yield (
        "  Ct*a + transpose(turned)*z + Me*der(dq) + 2*((d23 - d32)*w[1] + (d31 - d13)*w[2] + (d12 - d21)*w[3]) + "
        f"{turning} + Ke*q + De*dq = {' + '.join(work)};"
    )


_VARIABLES = (
    '  Real r[3](each start = 0, each fixed = true) "Place of the frame";',
    '  Real v[3](each start = 0, each fixed = true) "Its velocity, inertial axes";',
    '  Real e[4](start = {1, 0, 0, 0}, each fixed = true) "Euler parameters, scalar first";',
    '  Real w[3](each start = 0, each fixed = true) "Angular velocity, axes of the body";',
    '  Real q[n](each start = 0, each fixed = true) "Elastic coordinates";',
    "  Real dq[n](each start = 0, each fixed = true);",
    '  Real R[3, 3] "Axes of the body as columns";',
    "  Real a[3], z[3], g_body[3], mu[3], drift[3], spin[3, 3], Jq[3, 3], G[3, 3], N[3, 3], turned[3, n];",
)
_EQUATIONS = (
    "  der(r) = v;",
    # The last term takes back the drift of the norm.
    "  der(e) = 0.5*{-e[2]*w[1] - e[3]*w[2] - e[4]*w[3], e[1]*w[1] + e[3]*w[3] - e[4]*w[2], "
    "e[1]*w[2] + e[4]*w[1] - e[2]*w[3], e[1]*w[3] + e[2]*w[2] - e[3]*w[1]} + (1 - e*e)*e;",
    "  R = {{e[1]^2 + e[2]^2 - e[3]^2 - e[4]^2, 2*(e[2]*e[3] - e[1]*e[4]), 2*(e[2]*e[4] + e[1]*e[3])}, "
    "{2*(e[2]*e[3] + e[1]*e[4]), e[1]^2 - e[2]^2 + e[3]^2 - e[4]^2, 2*(e[3]*e[4] - e[1]*e[2])}, "
    "{2*(e[2]*e[4] - e[1]*e[3]), 2*(e[3]*e[4] + e[1]*e[2]), e[1]^2 - e[2]^2 - e[3]^2 + e[4]^2}};",
    "  der(q) = dq;",
    "  a = transpose(R)*der(v);",
    "  z = der(w);",
    "  g_body = transpose(R)*g;",
    "  mu = first + transpose(Ct)*q;",
    "  drift = transpose(Ct)*dq;",
    "  spin = {{-w[2]^2 - w[3]^2, w[1]*w[2], w[1]*w[3]}, {w[1]*w[2], -w[1]^2 - w[3]^2, w[2]*w[3]}, "
    "{w[1]*w[3], w[2]*w[3], -w[1]^2 - w[2]^2}};",
    "  turned = transpose(Cr) + {u23 - u32, u31 - u13, u12 - u21};",
)


def _square(term: str) -> str:
    """A literal (3, 3) of ``term`` with the numbers of its row and column."""
    return "{" + ", ".join("{" + ", ".join(term.format(i, j) for j in (1, 2, 3)) + "}" for i in (1, 2, 3)) + "}"


def _multibody(markers: dict[str, InterfaceMarker], axes: dict[str, Floats], names: dict[str, str]) -> Iterator[str]:
    """Frames of the standard library at the interfaces; their angular velocity is that of the Cayley map of their small
    rotation, so that moments work as Floating says."""
    yield 'model MultiBody "Floating, with frames of Modelica.Mechanics.MultiBody"'
    yield "  outer Modelica.Mechanics.MultiBody.World world;"
    yield "  extends Floating(g = world.gravityAcceleration({0, 0, 0}));"
    idents = [names[name] for name in markers]
    for name in markers:
        ident = names[name]
        yield f"  Modelica.Mechanics.MultiBody.Interfaces.Frame_a {ident}_frame;"
        yield f'  parameter Real {ident}_axes[3, 3] = {_matrix(axes[name])} "Axes of the interface as rows";'
        yield f'  Real {ident}_T[3, 3] "From the inertial frame to the interface";'
        yield f'  Real {ident}_w[3] "Its angular velocity, own axes";'
    yield "equation"
    yield f"  Connections.root({idents[0]}_frame.R);"
    for ident in idents[1:]:
        yield f"  Connections.branch({idents[0]}_frame.R, {ident}_frame.R);"
    for ident in idents:
        turn, size = f"{ident}_turn", f"(1 + 0.25*({ident}_turn*{ident}_turn))"
        back = f"(identity(3) - (skew({turn}) - 0.5*skew({turn})*skew({turn}))/{size})"
        yield f"  {ident}_T = {ident}_axes*{back}*transpose(R);"
        yield f"  {ident}_w = {ident}_T*R*(w + ({ident}_psi*dq + 0.5*cross({turn}, {ident}_psi*dq))/{size});"
        yield f"  {ident}_frame.r_0 = {ident}_r;"
        yield f"  {ident}_frame.R = Modelica.Mechanics.MultiBody.Frames.from_T({ident}_T, {ident}_w);"
        yield f"  {ident}_f = transpose(R)*transpose({ident}_T)*{ident}_frame.f;"
        yield f"  {ident}_t = transpose(R)*transpose({ident}_T)*{ident}_frame.t;"
    yield "end MultiBody;"


def _matrix(values: Floats) -> str:
    """A literal of one or two dimensions; every bit is kept."""
    if values.ndim == 1:
        return "{" + ", ".join(repr(float(value)) for value in values) + "}"
    return "{" + ", ".join(_matrix(row) for row in values) + "}"
