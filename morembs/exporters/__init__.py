"""Files for other programs; the table below is the contents page."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError, alike
from morembs.base.options import read_options
from morembs.base.plugins import Registry, subclass_fault
from morembs.body.body import Body
from morembs.body.file import read_body
from morembs.body.stored import choose_body
from morembs.exporters.abaqus_matrices import AbaqusExporter
from morembs.exporters.base import ExportContext, Exported, Exporter
from morembs.exporters.dmig import DmigExporter
from morembs.exporters.extptfm import ExtPtfm
from morembs.exporters.exudyn import Exudyn
from morembs.exporters.fmu.targets import CSource, Fmu
from morembs.exporters.gltf import Gltf
from morembs.exporters.matrix_market import MatrixMarketExporter
from morembs.exporters.mbdyn import MBDynExporter
from morembs.exporters.modelica import Modelica
from morembs.exporters.mujoco import MuJoCo
from morembs.exporters.op4 import OP4Exporter
from morembs.exporters.real_time import RealTime, find_step
from morembs.exporters.sid import SidFem
from morembs.exporters.simscape import Simscape
from morembs.exporters.state_space_files import StateSpaceExporter
from morembs.storage.contents import keeping_ledger

# One line for each target.
_ALL: tuple[type[Exporter], ...] = (
    Exudyn,
    SidFem,
    Simscape,
    MBDynExporter,
    OP4Exporter,
    DmigExporter,
    AbaqusExporter,
    MatrixMarketExporter,
    StateSpaceExporter,
    Modelica,
    ExtPtfm,
    MuJoCo,
    Fmu,
    CSource,
    Gltf,
)
EXPORTERS: Registry[type[Exporter]] = Registry(
    "morembs.exporters", {exporter.name: exporter for exporter in _ALL}, subclass_fault(Exporter, "name")
)
# Programs by name, in small letters -> what to export to instead.
ADVICE: dict[str, str] = {
    **dict.fromkeys(("simpack", "fembs", "sid-fem", "embslib"), "take 'sid'"),
    **dict.fromkeys(("openmodelica", "dymola"), "take 'modelica', 'fmu', or 'sid' for EMBSlib"),
    **dict.fromkeys(("matlab", "simulink"), "take 'simscape', 'statespace' for control, or 'matrix-market'"),
    **dict.fromkeys(("control", "python-control", "state-space"), "take 'statespace'"),
    **dict.fromkeys(("mjcf", "newton"), "take 'mujoco'"),
    **dict.fromkeys(("openfast", "fast"), "take 'extptfm'"),
    **dict.fromkeys(("chrono",), "its modal assembly wants the inner nodes of a model; take 'matrix-market'"),
    **dict.fromkeys(("glb", "blender", "three.js", "threejs", "powerpoint"), "take 'gltf'"),
    **dict.fromkeys(("fmi", "fmpy", "omsimulator"), "take 'fmu'"),
    **dict.fromkeys(("nastran", "optistruct"), "take 'dmig' or 'op4'"),
    **dict.fromkeys(("mtx", "ansys", "octave", "julia", "scipy"), "take 'matrix-market'"),
    **dict.fromkeys(
        ("adams", "mnf", "recurdyn", "rfi"),
        "modal neutral files (.mnf, .rfi) are closed formats and not written; take 'dmig' for Nastran, or 'sid'",
    ),
}
# Ends of body files that do not belong to their names.
_BODY_ENDINGS = (".h5", ".hdf5", ".hdf", ".vtkhdf", ".morembs")


def make_exporter(to: str, options: Mapping[str, object] | None = None) -> Exporter:
    """Exporter ``to`` with its options.

    Args:
        to: name of the target.
        options: options of that target.

    Raises:
        InputError: unknown target or option, or an option of the wrong type.
    """
    if to not in EXPORTERS:
        word = to.lower().replace("_", "-")
        near = alike(word, [*ADVICE, *EXPORTERS])
        advice = f"for {near} {ADVICE[near]}" if near in ADVICE else EXPORTERS.advice(word)
        raise InputError(f"there is no export to {to!r}; {ADVICE.get(word, advice)}", kind="unknown", keyword="to")
    kind = EXPORTERS[to]
    return kind(**read_options(kind, options or {}, f"export to {to!r}"))


@keeping_ledger()
def export_body(
    source: str | Path,
    to: str,
    *,
    path: str | Path | None = None,
    body: str | None = None,
    options: Mapping[str, object] | None = None,
    frame: str | None = None,
    at: Mapping[str, float] | None = None,
    taken: Collection[Path] = (),
) -> Exported:
    """Write one body of a body file in the format of another program.

    Args:
        to: a name of ``EXPORTERS``.
        path: the output; by default beside the source, named after it (and the body, if there are several).
        body: its name; may be left out where the file holds one.
        options: fields of the exporter.
        frame: another floating frame, "mean-axes" or with its interfaces "tangent:LEFT", "chord:LEFT,RIGHT"; the name
            of the output tells it.
        at: values of the parameters of a body that has some, by name; others are nominal.
        taken: files that must stay as they are, such as those of other bodies.

    Raises:
        InputError: unknown target, option or body, a body that cannot be expressed in the target, or an output that is
            taken.
        OutputError: the file cannot be written.

    >>> path = write_body("bar.h5", [body])
    >>> [file.name for file in export_body("bar.h5", "matrix-market").paths]
    [...]
    """
    exporter = make_exporter(to, options)
    place = Path(source)
    bodies = read_body(place)
    chosen = choose_body(bodies, body, place)
    several = len(bodies.bodies) > 1
    notes: tuple[str, ...] = ()
    if at is not None:
        there = chosen.parametric.at(**at)
        bodies, chosen = there.bodies, there.body
    if frame is not None:
        chosen, notes = _in_frame(chosen, frame)
    if chosen.spin is not None:
        notes += ("the matrices are those at rest: what spin adds (spin/C, spin/S, spin/Kg) stays in the body file",)
    target = default_path(place, exporter, chosen.name, several=several, frame=frame) if path is None else Path(path)
    if target.resolve() in {other.resolve() for other in taken}:
        raise InputError(
            f"{target} was just written, from another file or the same; give each file once, or --out", kind="output"
        )
    done = exporter.export(bodies, chosen, target, place)
    return replace(done, notes=(*notes, *done.notes))


def step_for_band(
    source: str | Path, to: str, band_hz: float, *, body: str | None = None, options: Mapping[str, object] | None = None
) -> tuple[RealTime, dict[str, float]]:
    """The time step for motion up to ``band_hz`` in real time, and its loss of accuracy; nothing is written.

    Args:
        source: body file.
        to: name of the target.
        band_hz: highest frequency in Hz.
        body: name, None for the only one.
        options: options of that target.

    Returns:
        the modes that the step leaves of the body, and the errors up to ``band_hz`` by kind of output; "steps" is that
        of the simulator.

    Raises:
        InputError: as ``export_body``, or a target that knows no time step.

    >>> found, errors = step_for_band("bar.h5", "statespace", 100.0)
    >>> errors["displacements"] <= 1e-3
    True
    """
    if not 0 < band_hz < np.inf:
        raise InputError(f"a band up to {band_hz} Hz was given; expected a positive frequency", keyword="band_hz")
    exporter, place = make_exporter(to, options), Path(source)
    bodies = read_body(place)
    context = ExportContext(source=bodies, body=choose_body(bodies, body, place), path=place, file=place)
    found = find_step(
        lambda step: exporter.truncate(exporter.prepare(context, step)[0], step),
        lambda angle: exporter.step_error(context, angle),
        band_hz,
    )
    if found is None:
        known = [repr(name) for name, kind in EXPORTERS.items() if kind.truncate is not Exporter.truncate]
        raise InputError(
            f"export to {to!r} knows no time step; take {', '.join(known[:-1])} or {known[-1]}",
            kind="unsupported",
            keyword="to",
        )
    return found


def _in_frame(body: Body, text: str) -> tuple[Body, tuple[str, ...]]:
    """``body`` in the floating frame that ``text`` names, and notes on terms that the change of frame loses."""
    if body.floating is None:
        raise InputError(
            f"the body {body.name!r} has no floating frame (it is held, or not symmetric); leave frame out",
            kind="unsupported",
        )
    kind, _, names = text.partition(":")
    moved = body.floating.in_frame(kind, [name.strip() for name in names.split(",") if name.strip()])
    lost = "geometric stiffening belongs to the frame of the file and stays behind"
    return replace(body, floating=moved), (lost,) if body.floating.stiffening is not None else ()


def default_path(
    place: Path, exporter: Exporter | type[Exporter], body: str, *, several: bool, frame: str | None = None
) -> Path:
    """``conrod.SID_FEM`` beside ``conrod.h5``; ``conrod_cb30.SID_FEM`` where the file holds several bodies,
    ``conrod_tangent-LEFT.SID_FEM`` in another frame than that of the file.

    Args:
        place: the body file.
        exporter: gives the suffix.
        body: name of the body.
        several: whether the file has more than one body.
        frame: kind of the floating frame, None for that of the file.
    """
    stem = place.name
    for ending in _BODY_ENDINGS:
        stem = stem.removesuffix(ending) or stem
    kind, _, names = (frame or "").partition(":")
    words = "-".join([kind, *(name.strip() for name in names.split(",") if name.strip())])
    ends = f"{f'_{body}' if several else ''}{f'_{words}' if words else ''}"
    return place.with_name(f"{stem}{ends}{exporter.suffix}")


__all__ = [
    "EXPORTERS",
    "ExportContext",
    "Exported",
    "Exporter",
    "choose_body",
    "default_path",
    "export_body",
    "make_exporter",
    "step_for_band",
]
