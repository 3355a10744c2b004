"""Cases about mechanisms: what a step costs in the studies, and the offline stage of large deflections.

Times are of the processor, on one thread of the BLAS. Libraries are imported in the functions, because the process that
starts the children has to stay small.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from measure import ROOT, Report, Row, Settings, child, in_rounds

# Steps over which the time of one is taken, and those of the pendulum in a quick run.
STEPS, QUICK_STEPS = 50, 4
# Elements of crank and rod: those of the study, four times as many, those of the comparison with Exudyn.
MEDIUM, FINE, COARSE = (80, 160), (320, 640), (16, 32)
_STEP_COLUMNS = (
    ("coordinates", "coordinates", "n"),
    ("step_seconds", "ms per step", "ms"),
    ("offline_seconds", "offline s", "s"),
)
_OFFLINE_COLUMNS = (
    ("points", "points", "n"),
    ("equilibria", "in tables and checks", "n"),
    ("solved", "solved", "n"),
    ("cpu_seconds", "processor s", "s"),
    ("seconds", "seconds", "s"),
)


def slider_crank(elements: tuple[int, int], model: str, quick: bool) -> Row:
    """``model``: "full", one of the study's, or "Exudyn"."""
    from studies import flexible_slider_crank as study

    options: dict[str, Any] = {"elements": study.QUICK_ELEMENTS if quick else elements, "end": STEPS * study.STEP}
    if model == "Exudyn" and (reason := study.exudyn_missing()):
        return {"error": reason}
    own = {"full": study.full, "Exudyn": study.exudyn}
    run = own[model](**options) if model in own else study.reduced(model, **options)
    return {"coordinates": run.coordinates, "step_seconds": run.step, "offline_seconds": run.offline or None}


def pendulum(body: bool, quick: bool) -> Row:
    """The flexible pendulum, by a mechanism of morembs.dynamics.nonlinear or as a body of multibody."""
    import numpy as np

    from morembs.dynamics.gmp import ParameterisedBody, PlaneJoint, ReducedMember
    from morembs.dynamics.multibody import System, ground, rotation, simulate
    from studies.flexible_pendulum import fall, rod

    member = ReducedMember(rod(3e6), modes=3, formulation="membrane", reach=0.83, points_per_angle=9)
    count, step = QUICK_STEPS if quick else 600, 5e-4
    if not body:
        return {"step_seconds": fall(member, end=count * step, step=step).seconds / count}
    system = System(gravity=(0, 0, -9.81))
    part = system.add(ParameterisedBody(member, rotation=rotation((1, 0, 0), np.pi / 2), name="rod"))
    system.add(PlaneJoint(ground.marker_at(), part.marker("start"), normal=(0, -1, 0)))
    start = time.process_time()
    simulate(system, end=count * step, step=step)
    return {"step_seconds": (time.process_time() - start) / count}


def moving_load(quick: bool) -> Row:
    """A step of the load that crosses beams of 40, 120 and 400 elements, with all nodes as candidates or with 41."""
    from studies import moving_load as study

    sizes = study.SIZES[:2] if quick else study.SIZES
    times = study.step_times(sizes, study.QUICK_TIMED if quick else study.TIMED, 1 if quick else study.ROUNDS)
    return {
        f"{kind}_{size}_seconds": 1e-3 * float(value)
        for kind, values in zip(("all", "few"), times, strict=True)
        for size, value in zip(sizes, values, strict=True)
    }


def rail(quick: bool) -> Row:
    """A load that crosses the rail: all dofs, all static modes, switched ones."""
    from studies import flexible_rail as study

    model = study.make_rail(study.QUICK_CELLS if quick else study.CELLS)
    steps = study.QUICK_STEPS if quick else study.STEPS
    reduced, tables, offline = study.reduce(model)
    with tempfile.TemporaryDirectory() as folder:
        switched, _ = study.with_switching(reduced, tables, steps, Path(folder) / "rail.npz")
    full = study.with_all_dofs(model, tables, steps)
    count, static = study.with_all_static_modes(reduced, tables, steps)
    return {
        "dofs": model.model.size,
        "steps": steps,
        "offline_seconds": offline,
        "coordinates": switched.coordinates,
        "static_coordinates": count,
        "switched_seconds": switched.seconds,
        "static_seconds": static,
        "full_seconds": full.seconds,
    }


def offline(solid: bool, options: dict[str, Any], quick: bool) -> Row:
    """The offline stage of a member; processor time of all its processes."""
    import os

    from morembs.dynamics.gmp import ReducedMember
    from morembs.dynamics.gmp.solid_member import solid_member
    from morembs.dynamics.nonlinear import PlanarBeam, Section

    if solid:
        component = _prism(4 if quick else 36)
        make: Callable[[], ReducedMember] = lambda: solid_member(component, modes=2, reach=0.6, **options)  # noqa: E731
    else:
        section = Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770.0)
        beam = PlanarBeam.straight(0.304, 24 if quick else 240, section)
        given = {"tolerance": 1e-4 if quick else 1e-6, **options}
        make = lambda: ReducedMember(beam, modes=3, formulation="membrane", reach=0.83, **given)  # noqa: E731
    before, start = os.times(), time.perf_counter()
    report = make().report
    seconds, after = time.perf_counter() - start, os.times()
    if report is None:
        raise TypeError("the member has no report")
    return {
        "points": report.points,
        "equilibria": report.equilibria,
        "solved": report.solved,
        "seconds": seconds,
        "coordinates": component.size if solid else beam.size,
        "cpu_seconds": sum(after[:4]) - sum(before[:4]),
    }


def _prism(elements: int) -> Any:
    """A soft rod of square section, 0.152 m long, of 20-node hexahedra, with rigid ends."""
    import numpy as np

    from morembs import assemble, isotropic, make_interface
    from morembs.dynamics.nonlinear.solid import NonlinearSolid
    from tests.support.meshes import box

    length, side = 0.152, 8.862e-3
    mesh = box("hex20", (elements, 2, 2), (length, side, side), lambda x: x - np.array([0, side / 2, side / 2]))
    model, x = assemble(mesh, [isotropic(set="all", young=3e6, poisson=0.3, density=2770.0)]), mesh.nodes.xyz[:, 0]
    ends = [
        make_interface(model, name=name, nodes=np.flatnonzero(np.isclose(x, place)), coupling="rigid")
        for name, place in (("start", 0.0), ("end", length))
    ]
    return NonlinearSolid(model, ends)


_SLIDER = {
    "full, 240 elements": (MEDIUM, "full"),
    "GMP, 240 elements": (MEDIUM, "GMP"),
    "full, 960 elements": (FINE, "full"),
    "GMP, 960 elements": (FINE, "GMP"),
    "Exudyn, 48 elements": (COARSE, "Exudyn"),
}
STEP_ROWS: dict[str, Callable[[bool], Row]] = {
    **{
        f"slider-crank: {name}": lambda quick, given=given: slider_crank(*given, quick)
        for name, given in _SLIDER.items()
    },
    "pendulum: mechanism": lambda quick: pendulum(False, quick),
    "pendulum: body": lambda quick: pendulum(True, quick),
    "moving load": moving_load,
    "rail": rail,
}
_ASYMMETRIC, _WORKERS = {"symmetric": False}, {"workers": 2}
OFFLINE_ROWS: dict[str, Callable[[bool], Row]] = {
    f"{'solid' if solid else 'rod'}{words}": lambda quick, solid=solid, options=options: offline(solid, options, quick)
    for solid in (False, True)
    for words, options in (("", {}), (", symmetries not used", _ASYMMETRIC), (", two workers", _WORKERS))
}


def measure(spec: dict[str, Any]) -> Row:
    """What one child finds."""
    sys.path.insert(0, str(ROOT))
    return {**STEP_ROWS, **OFFLINE_ROWS}[spec["row"]](spec["quick"])


def steps(settings: Settings) -> None:
    """Time of a step in the studies."""
    report = _measured("steps", list(STEP_ROWS), settings)
    report.table("steps: processor time of a step", _STEP_COLUMNS)
    report.write()


def gmp(settings: Settings) -> None:
    """The offline stage of large deflections, with and without symmetries, in one process and in two."""
    report = _measured("gmp", list(OFFLINE_ROWS), settings)
    report.table("gmp: offline stage of members for large deflections", _OFFLINE_COLUMNS)
    report.write()


def _measured(case: str, names: list[str], settings: Settings) -> Report:
    settings = replace(settings, threads=1)
    report = Report(case, settings)
    report.add(
        in_rounds(
            {name: lambda name=name: child("mechanism", settings, row=name, quick=settings.quick) for name in names},
            settings.repeat,
        )
    )
    return report


CASES: dict[str, Callable[[Settings], None]] = {"steps": steps, "gmp": gmp}
