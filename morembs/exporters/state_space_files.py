"""State space of a body in .npz and .mat files, for control design."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import scipy.io as sio

from morembs.base.errors import InputError
from morembs.base.limits import Positive
from morembs.base.units import in_hz
from morembs.exporters.base import ExportContext, Exported, Exporter
from morembs.exporters.ports import ports_of_file
from morembs.exporters.read_back import FirstOrder, ReadBack
from morembs.exporters.real_time import (
    RealTime,
    Truncation,
    certificate_note,
    gyration,
    price_note,
    refuse_nothing_left,
    slow_modes,
    without_fast,
)
from morembs.exporters.reduced import refuse_two_sided
from morembs.exporters.simscape import write_mat
from morembs.exporters.state_space import StateSpace, state_space_of
from morembs.exporters.tolerances import TOL
from morembs.problem.damping import frequency_domain_only
from morembs.storage.safefile import replacing

KINDS = ("states", "inputs", "outputs")


def write_state_space(path: str | Path, system: StateSpace, real_time: RealTime | None = None) -> None:
    """Write A, B, C, D, dt, and for states, inputs and outputs their names and units, such as inputs, input_units.

    Of a system for ``real_time`` also time_step, and real_time: what the step left and the error. The end of ``path``
    is .npz or .mat (version 5, texts in cells); every bit is kept.

    Raises:
        InputError: another end.
        OutputError: the file cannot be written.
    """
    place = Path(path)
    words = {kind: system.names[kind] for kind in KINDS} | {f"{kind[:-1]}_units": system.units[kind] for kind in KINDS}
    matrices = {"A": system.A, "B": system.B, "C": system.C, "D": system.D, "dt": np.float64(system.dt)}
    if real_time is not None:
        matrices["time_step"] = np.float64(real_time.step)
        words["real_time"] = real_time.notes
    if place.suffix == ".mat":
        write_mat(place, matrices | {key: np.array(texts, dtype=object)[:, None] for key, texts in words.items()})
    elif place.suffix == ".npz":
        stream = BytesIO()
        arrays: dict[str, Any] = matrices | {key: np.array(texts, dtype=np.str_) for key, texts in words.items()}
        np.savez(stream, **arrays)
        with replacing(place) as file:
            file.write(stream.getvalue())
            file.check()
    else:
        raise InputError(f"{place} was given; a state space goes into a file that ends in .npz or .mat", keyword="path")


def refuse_displacement(path: Path, inputs: Sequence[str]) -> None:
    """Refuse an input that a proper state space does not take, in a .mat file.

    Raises:
        InputError: in these cases.
    """
    if path.suffix == ".mat" and any(":displacement" in text for text in inputs):
        raise InputError(
            f"inputs = {list(inputs)} was given for a .mat file; a proper state space takes the acceleration of a "
            "support, not its displacement: name that as the input, or write .npz, where the displacement and its two "
            "derivatives are three inputs",
            keyword="inputs",
        )


def read_state_space(path: str | Path) -> StateSpace:
    """What ``write_state_space`` wrote.

    Raises:
        InputError: no such file, or not of this kind.
    """
    place = Path(path)
    try:
        if place.suffix == ".mat":
            values = {key: np.asarray(value) for key, value in sio.loadmat(place).items()}
            texts = {
                key: [str(cell[0]) if len(cell) else "" for cell in value.ravel()]
                for key, value in values.items()
                if value.dtype == object
            }
        else:
            with np.load(place, allow_pickle=False) as file:
                values = dict(file)
            texts = {key: value.tolist() for key, value in values.items() if value.dtype.kind == "U"}
        A, B, C, D = (np.atleast_2d(values[key]) for key in "ABCD")
        return StateSpace(
            A=A.reshape(len(texts["states"]), -1) if A.size else np.zeros((0, 0)),
            B=B.reshape(len(texts["states"]), len(texts["inputs"])),
            C=C.reshape(len(texts["outputs"]), len(texts["states"])),
            D=D,
            dt=float(values["dt"].item()),
            names={kind: tuple(texts[kind]) for kind in KINDS},
            units={kind: tuple(texts[f"{kind[:-1]}_units"]) for kind in KINDS},
        )
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(
            f"{place} cannot be read as a state space ({error}); expected one of export", kind="file", keyword="path"
        ) from error


@dataclass(frozen=True, kw_only=True)
class StateSpaceExporter(Exporter):
    """State space for control design: ``inputs`` such as "base:acceleration", "tip:force:z", ``outputs`` such as
    "base:reaction", "tip:displacement", interfaces ``held`` at rest; with a ``step`` in s its zero-order hold.

    By default forces on all interfaces go in and their displacements come out. A name that ends in .mat gives a MATLAB
    file. Modes that a ``time_step`` in s does not resolve become a feedthrough.
    """

    name: ClassVar[str] = "statespace"
    suffix: ClassVar[str] = ".statespace.npz"
    about: ClassVar[str] = "state space A, B, C, D for control design, also .mat; support motion in, reactions out"
    needs_frame: ClassVar[bool] = False
    holds: ClassVar[frozenset[str]] = frozenset({"damping", "forces"})

    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    held: list[str] = field(default_factory=list)
    step: Positive | None = None
    time_step: Positive | None = None

    def _write(self, context: ExportContext) -> Exported:
        refuse_displacement(context.path, self.inputs)
        whole = self._system(context)
        system, found = (whole, None) if self.time_step is None else truncate(whole, context, self.time_step)
        write_state_space(context.path, system if self.step is None else system.discrete(self.step), found)
        notes: tuple[str, ...] = ()
        if self.time_step is not None and found is not None:
            price = price_note(_seconds_of_step(system.discrete(self.time_step)), self.time_step)
            notes = (*found.notes, *certificate_note(context.body), *price)
        return Exported(paths=(context.path,), notes=(*notes, *_notes(system, self.step)))

    def truncate(self, context: ExportContext, step: float) -> RealTime:
        return truncate(self._system(context), context, step)[1]

    def _system(self, context: ExportContext) -> StateSpace:
        """In continuous time."""
        names = [name for at, name in enumerate(context.source.interfaces) if at in context.source.input_interface]
        if not names and not (self.inputs and self.outputs):
            raise InputError(
                f"body {context.body.name!r} has no interface, so the state space has no inputs and outputs; add an "
                "[[interface]] to its job"
            )
        reason = frequency_domain_only(context.body.recipe)
        if reason:
            raise InputError(f"body {context.body.name!r}: {reason}", kind="unsupported")
        return state_space_of(
            context.body.reduced,
            ports_of_file(context.source),
            self.inputs or [f"{name}:force" for name in names if name not in self.held],
            self.outputs or [f"{name}:displacement" for name in names],
            self.held,
        )

    def _read_back(self, context: ExportContext, files: Mapping[Path, Path]) -> ReadBack:
        system = self._system(context)
        if self.time_step is not None:
            system, _ = truncate(system, context, self.time_step)
        found, expected = (
            FirstOrder(A=each.A, B=each.B, C=each.C, D=each.D, dt=each.dt)
            for each in (read_state_space(files[context.path]), system.discrete(self.step) if self.step else system)
        )
        return ReadBack(found=found, expected=expected, digits=TOL.double_digits)


def _seconds_of_step(system: StateSpace) -> float:
    """Processor time in s of one step of a ``system`` in discrete time by NumPy, the mean of ``timed_steps``."""
    x, u = np.zeros(len(system.A)), np.zeros(system.B.shape[1])
    start = time.process_time()
    for _ in range(TOL.timed_steps):
        _y, x = system.C @ x + system.D @ u, system.A @ x + system.B @ u
    return (time.process_time() - start) / TOL.timed_steps


def truncate(system: StateSpace, context: ExportContext, time_step: float) -> tuple[StateSpace, RealTime]:
    """The ``system`` of a body without the modes that ``time_step`` in s does not resolve: a feedthrough.

    Raises:
        InputError: the body is not symmetric, so that its coordinates are no modes, or nothing is left.
    """
    refuse_two_sided(context.body)
    states = system.names["states"]
    q = np.array([states.index(name) for name in states if name[0] == "q" and name[1:].isdigit()], dtype=np.int64)
    p = np.array([states.index(f"d{states[at]}") for at in q], dtype=np.int64)
    omega = np.sqrt(np.maximum(-system.A[p, q], 0.0))
    slow = slow_modes(omega, -system.A[p, p], time_step)
    refuse_nothing_left(context.body.name, time_step, len(states) - 2 * int((~slow).sum()))
    fast = np.concatenate([q[~slow], p[~slow]])
    still = np.concatenate([q[omega > 0], p[omega > 0]])
    whole = FirstOrder(A=system.A, B=system.B, C=system.C, D=system.D)
    parts = Truncation(
        system=whole,
        fast=fast,
        moving=np.setdiff1d(np.arange(len(states)), still),
        units=(system.units["outputs"], system.units["inputs"]),
        derivatives=_derivatives(system.names["inputs"]),
        length=gyration(context.source),
        step=time_step,
    )
    short, kept = without_fast(whole, fast), np.setdiff1d(np.arange(len(states)), fast)
    names, units = (
        {**words, "states": tuple(words["states"][at] for at in kept)} for words in (system.names, system.units)
    )
    return StateSpace(A=short.A, B=short.B, C=short.C, D=short.D, names=names, units=units), parts.measure(len(q))


def _derivatives(inputs: Sequence[str]) -> list[tuple[int, int]]:
    """Of each input the displacement that it is a derivative of, or itself, and the order."""
    result = []
    for at, name in enumerate(inputs):
        for order, word in enumerate((":displacement:", ":velocity:", ":acceleration:")):
            base = name.replace(word, ":displacement:")
            if word in name and base in inputs:
                result.append((inputs.index(base), order))
                break
        else:
            result.append((at, 0))
    return result


def _damping(pole: complex) -> float:
    """In per cent of critical; adding zero takes the sign of a zero away."""
    return 100 * -pole.real / (abs(pole) or 1.0) + 0.0


def _notes(system: StateSpace, step: float | None) -> list[str]:
    """Size, poles and static gain, for the log."""
    poles = system.poles()
    notes = [f"{len(poles)} states, {system.B.shape[1]} inputs, {len(system.C)} outputs"]
    rigid = int((np.abs(poles) <= TOL.zero_pole * np.abs(poles).max(initial=0.0)).sum())
    if rigid:
        notes.append(f"{rigid} poles at zero: what moves freely, or with a support")
    upper = poles[rigid:][poles[rigid:].imag >= 0]
    if len(upper):
        shown = [f"{in_hz(abs(pole)):.5g} Hz ({_damping(pole):.3g} %)" for pole in upper]
        more = " ..." if len(shown) > TOL.shown_values else ""
        notes.append(f"poles and their damping: {', '.join(shown[: TOL.shown_values])}{more}")
    fastest = float(np.abs(poles).max(initial=0.0))
    if step is not None and fastest * step > np.pi:
        notes.append(f"the step is longer than half a period of the highest mode, {np.pi / fastest:.3g} s")
    gain = system.dc_gain()
    if gain is None:
        notes.append("no static gain: the system integrates what goes in")
    elif gain.size <= TOL.shown_values:
        ends = [(out, into) for out in system.names["outputs"] for into in system.names["inputs"]]
        shown = [f"{out} by {into} {value:.5g}" for (out, into), value in zip(ends, gain.ravel(), strict=True)]
        notes.append(f"static gain: {', '.join(shown)}")
    return notes


__all__: Sequence[str] = ["StateSpaceExporter", "read_state_space", "write_state_space"]
