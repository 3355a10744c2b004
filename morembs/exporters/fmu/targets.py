"""The targets: Functional Mock-up Units, and C sources alone."""

from __future__ import annotations

import platform
import sys
import zipfile
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import ClassVar, Literal

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import InputError
from morembs.base.limits import NotNegative, Positive
from morembs.base.types import Floats
from morembs.exporters.base import LOSSES, Destination, ExportContext, Exported, Exporter
from morembs.exporters.fmu.compiler import compile_source, seconds_of_step, single_error
from morembs.exporters.fmu.description import Version, build_description, model_description
from morembs.exporters.fmu.floating import floating_system
from morembs.exporters.fmu.linear import linear_system, state_space, truncate
from morembs.exporters.fmu.sources import Code, Precision, glue, token_of
from morembs.exporters.fmu.system import System, identifier, renamed_note
from morembs.exporters.real_time import RealTime, certificate_note, price_note
from morembs.exporters.tolerances import TOL
from morembs.storage.safefile import replacing, replacing_all

Structure = Literal["auto", "linear", "floating"]
Method = Literal["auto", "exponential", "midpoint"]
# Folder of the binaries in version 2, end of that in version 3 behind the processor, end of the library, by system.
_PLATFORMS = {
    "linux": ("linux64", "linux", "so"),
    "darwin": ("darwin64", "darwin", "dylib"),
    "win32": ("win64", "windows", "dll"),
}
_PROCESSORS = {"arm64": "aarch64", "amd64": "x86_64"}
# The first day that a zip file knows, so that the same body gives the same bytes.
_DAY = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, kw_only=True)
class Equations(Exporter):
    """Options of both targets.

    ``structure`` "linear" (small motion, ``held`` at some interfaces or at none) or "floating" (large rotations;
    "auto": that where the body has a floating frame, no generalised forces, and nothing is held), labels of nodes
    whose ``stress`` comes out, and a ``damping_ratio`` of all modes beside the damping matrix. Modes that a
    ``time_step`` in s does not resolve are static compliance. With a time step, or by ``interpolate_inputs`` alone,
    inputs may go in a line over a step.
    """

    needs_frame: ClassVar[bool] = False
    # Generalised forces and stresses as far as the structure has them, which its notes say.
    holds: ClassVar[frozenset[str]] = frozenset({"damping", "forces", "stress"})

    structure: Structure = "auto"
    held: list[str] | None = None
    stress: list[int] = field(default_factory=list)
    damping_ratio: NotNegative = 0.0
    time_step: Positive | None = None
    interpolate_inputs: bool | None = None

    @property
    def has_linear_inputs(self) -> bool:
        """True if inputs may go in a line over a step."""
        return self.time_step is not None if self.interpolate_inputs is None else self.interpolate_inputs

    def _is_linear(self, context: ExportContext) -> bool:
        forces = any(interface.forces for interface in context.source.interfaces.values())
        small = bool(self.held) or context.body.floating is None or forces
        return self.structure == "linear" or (self.structure == "auto" and small)

    def _system(self, context: ExportContext) -> System:
        held = self.held or []
        if self._is_linear(context):
            system = linear_system(context, held=held, stress=self.stress, damping_ratio=self.damping_ratio)
            return system if self.time_step is None else truncate(system, context, self.time_step)
        if held:
            raise InputError(
                'structure = "floating" was given with held interfaces; take structure = "linear"',
                kind="conflict",
                keyword="structure",
            )
        return floating_system(context, stress=self.stress, damping_ratio=self.damping_ratio, time_step=self.time_step)

    def truncate(self, context: ExportContext, step: float) -> RealTime | None:
        return replace(self, time_step=step)._system(context).real_time

    def _write(self, context: ExportContext) -> Exported:
        system = self._system(context)
        return self.write_equations(system, context, context.body.name, self._notes(context, system))

    @abstractmethod
    def write_equations(self, system: System, to: Destination, body: str, notes: tuple[str, ...] = ()) -> Exported:
        """The code of a ``system`` that stands for ``body``, with ``notes`` on it.

        Raises:
            InputError: a name or an option that does not fit.
            OutputError: the file cannot be written.
        """

    def _notes(self, context: ExportContext, system: System) -> tuple[str, ...]:
        left = ({"forces"} if system.structure == "floating" else set()) | (set() if self.stress else {"stress"})
        motion = {"linear": "small motion about its place", "floating": "large rotations, in its floating frame"}
        real_time = () if system.real_time is None else (*system.real_time.notes, *certificate_note(context.body))
        return (
            f"{system.structure} body: {motion[system.structure]}",
            *real_time,
            *context.losses_of(LOSSES.keys() - left),
            *system.notes,
        )


@dataclass(frozen=True, kw_only=True)
class Fmu(Equations):
    """Functional Mock-up Unit of version ``fmi`` for model exchange and co-simulation, with its C sources.

    Co-simulation of linear bodies is exact for held inputs (matrix exponential); floating bodies take as many steps of
    the method of Gauss as the parameter ``tolerance`` wants.
    """

    name: ClassVar[str] = "fmu"
    suffix: ClassVar[str] = ".fmu"
    about: ClassVar[str] = "Functional Mock-up Unit, FMI 2.0 or 3.0, model exchange and co-simulation"
    lossless: ClassVar[bool] = True

    fmi: Version = "2.0"

    def write_equations(self, system: System, to: Destination, body: str, notes: tuple[str, ...] = ()) -> Exported:
        stem = to.path.name.partition(".")[0]
        name = identifier(stem)
        code = Code(name=name, system=system, linear_inputs=self.has_linear_inputs)
        sources = glue(code, self.fmi)
        members = {
            "modelDescription.xml": model_description(code, body, token_of(sources), self.fmi),
            **{f"sources/{file}": text.encode("ascii") for file, text in sources.items()},
        }
        if self.fmi == "3.0":
            members["sources/buildDescription.xml"] = build_description(name)
        notes = (*notes, *renamed_note({stem: name}))
        if self.time_step is not None:
            notes = (*notes, *price_note(seconds_of_step(code, self.time_step), self.time_step))
        with replacing(to.path) as file:
            file.doing = "the compiled library"
            library: bytes | str = ""
            try:
                library = compile_source(sources)
            except OSError as error:
                file.error = error
            if isinstance(library, bytes):
                members[f"binaries/{_library_name(name, self.fmi)}"] = library
            else:
                notes = (*notes, f"the FMU holds sources only: {library}")
            file.doing = "the FMU"
            file.write(_zip(members))
            file.check()
        return Exported(paths=(to.path,), notes=notes)


@dataclass(frozen=True, kw_only=True)
class CSource(Equations):
    """C99 source and header with a function that makes one ``step`` (s) and allocates nothing.

    ``method`` "exponential" (linear bodies: exact for held inputs) or "midpoint" (implicit midpoint rule, the one for
    floating bodies); ``precision`` "double" or "single". A ``time_step`` is the ``step`` too.
    """

    name: ClassVar[str] = "c"
    suffix: ClassVar[str] = ".c"
    about: ClassVar[str] = "C99 source and header with a step function that allocates nothing"
    lossless: ClassVar[bool] = True

    step: Positive = 1e-4
    method: Method = "auto"
    precision: Precision = "double"

    def write_equations(self, system: System, to: Destination, body: str, notes: tuple[str, ...] = ()) -> Exported:
        if to.path.suffix != self.suffix:
            raise InputError(
                f"{to.path} was given; expected a name that ends in .c, beside which the header goes", keyword="out"
            )
        name = identifier(to.path.name.removesuffix(self.suffix))
        step = self._step()
        code = self.code(name, system, step)
        header = to.beside(".h")
        all_notes = [
            f"one call is one step of {step:g} s; take another by --set step=SECONDS",
            *notes,
            *renamed_note({to.path.name.partition(".")[0]: name}),
        ]
        all_notes += price_note(seconds_of_step(code, step), step) if self.time_step is not None else []
        all_notes += [_single_words(code)] if self.precision == "single" else []
        text = {to.path: code.source().replace(f'"{name}.h"', f'"{header.name}"'), header: code.header()}
        with replacing_all(list(text)) as opened:
            for file, content in zip(opened, text.values(), strict=True):
                file.write(content.encode("ascii"))
        return Exported(paths=tuple(text), notes=tuple(all_notes))

    def step_error(self, context: ExportContext, angle: float) -> float:
        # The midpoint rule puts frequencies too low: 2 / h atan(w h / 2); the exponential is exact.
        exact = self._is_linear(context) and self.method != "midpoint"
        return 0.0 if exact else float(1 - 2 * np.arctan(angle / 2) / angle)

    def _step(self) -> float:
        """The step of the code in s.

        Raises:
            InputError: two different ones were given.
        """
        if self.time_step is None:
            return self.step
        if self.step not in (CSource.step, self.time_step):
            raise InputError(
                f"step = {self.step:g} and a time step of {self.time_step:g} s were given; leave step out",
                keyword="step",
            )
        return self.time_step

    def code(self, name: str, system: System, step: float) -> Code:
        """The code of one ``step`` in s."""
        if system.structure != "linear":
            if self.method == "exponential":
                raise InputError(
                    f'method = "exponential" was given; {system.structure} bodies take "midpoint"', keyword="method"
                )
            constants = {key: value for key, value in system.constants.items() if key != "TOLERANCE"}
            slim = replace(system, parameters=system.parameters[:1], constants=constants)
            fixed: dict[str, Floats | float] = {"STEP": step}
        else:
            A, B = state_space(system)
            discretise = midpoint if self.method == "midpoint" else exponential
            fixed = dict(zip(("STEP_X", "STEP_U"), discretise(A, B, step, linear=self.has_linear_inputs), strict=True))
            n = len(A) // 2
            slim = replace(system, parameters=(), tables={**system.tables, "MINUS_D": A[n:, n:]})
        return Code(
            name=name,
            system=slim,
            precision=self.precision,
            fixed=fixed,
            stages=2 if system.structure == "linear" else 1,
            linear_inputs=self.has_linear_inputs,
        )


def exponential(A: Floats, B: Floats, step: float, *, linear: bool = False) -> tuple[Floats, Floats]:
    """X (n, n) and U (n, m) with x + X x + U u after one step of x' = A x + B u under a held u.

    Where inputs are ``linear``, U (n, 2 m) takes [u; d] of inputs that go from u to u + d in a line.
    """
    n, m = B.shape
    # Displacements in units of their velocities, as far as these are coupled: all of one size.
    half = n // 2
    omega = np.sqrt(-np.diag(A[half:, :half]))
    scale = np.concatenate([np.where(omega > 0, omega, 1.0), np.ones(half)])
    width = n + (1 + linear) * m
    whole = np.zeros((width, width))
    whole[:n, :n], whole[:n, n : n + m] = A * scale[:, None] / scale, B * scale[:, None]
    # Rows are left where inputs are held.
    whole[n : n + m, n + m :] = np.eye(m, width - n - m) / step
    E = sl.expm(step * whole)[:n]
    X = (E[:, :n] - np.eye(n)) * scale / scale[:, None]
    return X, E[:, n:] / scale[:, None]


def midpoint(A: Floats, B: Floats, step: float, *, linear: bool = False) -> tuple[Floats, Floats]:
    """As ``exponential``, by the implicit midpoint rule."""
    both = np.asarray(np.linalg.solve(np.eye(len(A)) - 0.5 * step * A, step * np.hstack([A, B])), dtype=np.float64)
    X, U = both[:, : len(A)], both[:, len(A) :]
    return X, np.hstack([U, 0.5 * U]) if linear else U


def _single_words(code: Code) -> str:
    """What single precision costs.

    Raises:
        InputError: it costs too much.
    """
    error, steps, allowed = (single_error(code), TOL.single_precision_steps, TOL.single_precision_error)
    if isinstance(error, str):
        return f"what single precision costs was not measured: {error}"
    if not error < allowed:
        raise InputError(
            f'precision = "single" was given; over {steps} steps of random loads outputs differ from double by '
            f"{error:.0%} of their largest, expected less than {allowed:.0%}. Take --frame mean-axes, another step, "
            'or precision = "double"',
            keyword="precision",
        )
    return (
        f"single precision: over {steps} steps of random loads outputs differ from double by {error:.1e} of "
        "their largest"
    )


def _library_name(name: str, version: Version) -> str:
    """Folder and name of a library for this machine."""
    second, third, ending = _PLATFORMS.get(sys.platform, _PLATFORMS["linux"])
    machine = platform.machine().lower()
    folder = second if version == "2.0" else f"{_PROCESSORS.get(machine, machine)}-{third}"
    return f"{folder}/{name}.{ending}"


def _zip(members: Mapping[str, bytes]) -> bytes:
    """A zip file that is the same for the same members."""
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            info = zipfile.ZipInfo(name, _DAY)
            # Written by the owner, read by all.
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(info, data)
    return stream.getvalue()
