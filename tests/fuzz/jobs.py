"""Jobs at random: interfaces, damping, reductions, bands and outputs on a model, and what is known of them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.fuzz import assemblies, files, parametric
from tests.fuzz.models import Model, draw_model
from tests.fuzz.ports import draw_ports, port_tables
from tests.fuzz.reductions import Drawn, draw_reductions, guyan
from tests.fuzz.truth import Damping, Port, Truth

FLOOR = 0.01
# Share of jobs that couple two bodies.
ASSEMBLIES = 0.05
DAMPINGS = ("none", "rayleigh", "modal", "table", "structural", "rayleigh+structural", "modal+structural")
DAMPING_SHARES = (0.28, 0.2, 0.18, 0.12, 0.12, 0.05, 0.05)
TARGETS = (
    "statespace",
    "matrix-market",
    "sid",
    "c",
    "op4",
    "dmig",
    "simscape",
    "mbdyn",
    "modelica",
    "abaqus",
    "mujoco",
    "exudyn",
    "fmu",
)


@dataclass(kw_only=True)
class Job:
    """A job file and what it needs: ``prepare`` are command lines before it, ``after`` those that follow.

    ``valid``: whether the documents promise a body; ``features`` are counted in the tables.
    """

    text: str
    truth: Truth
    prepare: list[list[str]] = field(default_factory=list)
    after: list[list[str]] = field(default_factory=list)
    valid: bool = True
    why_not: str = ""
    features: dict[str, str] = field(default_factory=dict)
    reductions: list[Drawn] = field(default_factory=list)
    floor: float = 0.0
    judged: bool = True
    evaluation: parametric.Evaluation | None = None


def draw(rng: np.random.Generator, folder: Path) -> Job:
    """A job, and its input files in ``folder``."""
    return _draw_assembly(rng, folder) if rng.random() < ASSEMBLIES else _draw_part(rng, folder)


def _draw_assembly(rng: np.random.Generator, folder: Path) -> Job:
    """Two bodies, which keep all modes of their parts, coupled and reduced again."""
    made = assemblies.draw(rng, folder)
    damping, damping_text, damping_name = _damping(rng, made.truth(Damping()).hz[0])
    truth = made.truth(damping)
    band, band_name = _band(rng, truth)
    certify, floor, floor_name = _certify(rng, truth, band)
    drawn = [each for each in draw_reductions(rng, truth, band, damping_name) if each.method in assemblies.METHODS]
    drawn = drawn or [guyan("r1")]
    text = "\n".join([made.text, damping_text, *(each.text for each in drawn), certify, '[output]\npath = "body.h5"'])
    job = Job(text=text, truth=truth, prepare=[["reduce", "part.toml", "--quiet"]], reductions=drawn, floor=floor)
    job.features = {
        "model": "assembly",
        "support": "free",
        "coupling": "springs" if made.stiffness else "one motion",
        "damping": damping_name + floor_name,
        "band": band_name if certify else "none",
        "reduction": "+".join(each.method for each in drawn),
    }
    _validity(job, damping_name, "none")
    job.after.append(["info", "body.h5"])
    return job


def _draw_part(rng: np.random.Generator, folder: Path) -> Job:
    ports: tuple[Port, ...] = ()
    while not ports:
        model = draw_model(rng)
        ports = draw_ports(rng, model)
    if model.D is None:
        damping, damping_text, damping_name = _damping(rng, Truth(model, ports, Damping()).hz[0])
    else:
        damping, damping_text, damping_name = Damping(), "", "own"
    truth = Truth(model, ports, damping)
    text, prepare, units = _model(rng, folder, model)
    job = Job(text=text, truth=truth, prepare=prepare)
    band, band_name = _band(rng, truth)
    certify, job.floor, floor_name = _certify(rng, truth, band)
    spring = parametric.draw(rng, truth, units, band) if model.family == "mesh" and rng.random() < 0.2 else None
    job.reductions = [] if spring else draw_reductions(rng, truth, band, damping_name)
    job.evaluation = spring
    if spring:
        job.truth = spring.at(truth, spring.nominal)
        job.floor = floor_of(job.truth, spring.band)
    parts = [text, port_tables(ports, model, units), damping_text, *(drawn.text for drawn in job.reductions)]
    parts += [spring.text] if spring else [certify]
    extra, extra_text = _extra(rng, job.truth, units, damping_name, spring is not None)
    job.text = "\n".join([*parts, extra_text, '[output]\npath = "body.h5"'])
    job.features = {
        "model": model.family + (f" {model.solid.kind}" if model.solid else ""),
        "support": model.support,
        "coupling": "+".join(sorted({p.coupling for p in ports})),
        "damping": damping_name + floor_name,
        "band": band_name if certify or spring else "none",
        "extra": extra,
        "reduction": "parametric" if spring else "+".join(drawn.method for drawn in job.reductions),
        "parameter": "+".join(spring.properties) if spring else "none",
    }
    # A preload changes K, which the truth does not follow; its body is only run.
    job.judged = extra != "preload"
    _validity(job, damping_name, extra)
    _outputs(rng, job)
    return job


def _model(rng: np.random.Generator, folder: Path, model: Model) -> tuple[str, list[list[str]], str]:
    if model.family == "mesh":
        names = [name for name in files.MESHES if not (name.endswith("inp") and model.solid.kind == "wedge6")]
        units = str(rng.choice(list(files.UNITS)))
        return files.write_mesh(folder, model, str(rng.choice(names)), units), [], units
    table, arguments = files.write_matrices(folder, model, str(rng.choice(files.MATRICES)))
    return table, [arguments] if arguments else [], "m-kg-s"


def _damping(rng: np.random.Generator, first: float) -> tuple[Damping, str, str]:
    """Factors, the table of the job, and a name, for a model whose first frequency is ``first`` Hz."""
    name = str(rng.choice(DAMPINGS, p=DAMPING_SHARES))
    if name == "none":
        return Damping(), "", name
    omega = 2 * np.pi * first
    lines, alpha, beta, steps, eta = [], 0.0, 0.0, (), 0.0
    if "rayleigh" in name:
        alpha, beta = (float(f"{x:.3g}") for x in 10 ** rng.uniform(-3, -1.3, 2) * [omega, 1 / omega])
        alpha = alpha if rng.random() < 0.8 else 0.0
        lines.append(f"rayleigh = {{ alpha = {alpha}, beta = {beta} }}")
    if "modal" in name:
        steps = ((0.0, float(f"{10 ** rng.uniform(-4, -1):.3g}")),)
        lines.append(f"modal = {steps[0][1]}")
    if name == "table":
        at = [0.0, *sorted(float(f"{x:.4g}") for x in rng.uniform(0.3, 3, 2) * first + first * np.array([0, 3]))]
        steps = tuple((f, float(f"{10 ** rng.uniform(-3, -1):.3g}")) for f in at)
        lines.append(f"modal = {json.dumps(steps)}")
    if "structural" in name:
        eta = float(f"{10 ** rng.uniform(-3, -1):.3g}")
        lines.append(f"structural = {eta}")
    return Damping(alpha=alpha, beta=beta, steps=steps, structural=eta), "[damping]\n" + "\n".join(lines), name


def _band(rng: np.random.Generator, truth: Truth) -> tuple[tuple[float, float], str]:
    """Edges that no mode lies on: from 0, from above 0, about one mode, or between two."""
    hz = truth.hz
    gaps = [k for k in range(min(8, len(hz) - 1)) if hz[k + 1] > hz[k] * 1.02]
    k = int(rng.choice(gaps)) if gaps else 0
    after = float(np.sqrt(hz[k] * hz[k + 1])) if gaps else float(hz[0] * 1.3)
    kind = str(rng.choice(["from 0", "from above 0", "between two modes", "below the first"], p=[0.5, 0.3, 0.13, 0.07]))
    if kind == "from 0":
        band = 0.0, after
    elif kind == "below the first":
        band = 0.0, float(hz[0] * 0.7)
    elif kind == "between two modes" and gaps:
        band = float(hz[k] * (after / hz[k]) ** 0.3), after
    else:
        kind = "from above 0"
        low = int(rng.integers(0, k + 1))
        band = float(np.sqrt(hz[low] * (hz[low - 1] if low else hz[low] / 4))) * 1.001, after
        if band[0] >= band[1]:
            band = band[1] * 0.5, band[1]
    return (float(f"{band[0]:.6g}"), float(f"{band[1]:.6g}")), kind


def floor_of(truth: Truth, band: tuple[float, float]) -> float:
    """The ratio that certificates assume by themselves."""
    d = truth.damping
    if d.alpha or d.beta or d.structural or truth.D is not None:
        return 0.0
    inside = [f for f, _ in d.steps if band[0] < f < band[1]]
    return 0.0 if d.steps and d.ratio(np.array([band[0], *inside])).all() else FLOOR


def _certify(rng: np.random.Generator, truth: Truth, band: tuple[float, float]) -> tuple[str, float, str]:
    if rng.random() < 0.2:
        return "", floor_of(truth, band), ""
    lines, floor, name = [f"band_hz = [{band[0]}, {band[1]}]"], floor_of(truth, band), ""
    if rng.random() < 0.15:
        floor, name = float(f"{10 ** rng.uniform(-3, -1):.3g}"), "+floor"
        lines.append(f"damping_floor = {floor}")
    if rng.random() < 0.3:
        lines.append(f'measure = "{rng.choice(["envelope", "peak", "pointwise"])}"')
    lines.append(f"points = {int(rng.integers(2, 60))}")
    return "[certify]\n" + "\n".join(lines), floor, name


def _extra(rng: np.random.Generator, truth: Truth, units: str, damping: str, parametric: bool) -> tuple[str, str]:
    """A further table, where the model may have it."""
    model = truth.model
    framed = [p for p in truth.ports if p.coupling in ("rigid", "average") and len(p.components) == 6]
    choice = str(
        rng.choice(
            ["none", "frame", "stress", "preload", "spin", "response", "state space", "envelope"],
            p=[0.55, 0.07, 0.07, 0.07, 0.08, 0.06, 0.05, 0.05],
        )
    )
    length = files.UNITS[units][0]
    axis = [float(x) for x in np.round(rng.standard_normal(3), 3)]
    name = framed[0].name if framed else ""
    if choice == "frame" and model.free == 6 and framed:
        kind = str(rng.choice(["mean-axes", "center-of-mass", "tangent"]))
        ends = "" if kind == "mean-axes" else f'\ninterfaces = ["{name}"]'
        return choice, f'[frame]\nkind = "{kind}"{ends}'
    if choice == "stress" and model.family == "mesh" and not parametric:
        return choice, f'[stress]\nnodes = "{rng.choice(["skin", "all"])}"'
    if choice == "preload" and model.family == "mesh" and framed and not parametric:
        # A thousandth of a thousandth of a strain, in newtons.
        force = model.solid.young * float(np.ptp(model.xyz[:, 1]) * np.ptp(model.xyz[:, 2])) * 1e-5
        force *= {"m-kg-s": 1.0, "mm-t-s": 1.0}[units]
        held = next((p.name for p in framed[1:]), "")
        more = f'\nheld = ["{held}"]' if held else ""
        return choice, f"[preload]\nwrench = {{ {name} = [{force:.6g}, {0.2 * force:.6g}, 0, 0, 0, 0] }}{more}"
    spins = model.nodes and model.free == 6 and "modal" not in damping and "table" not in damping
    if choice == "spin" and spins and "structural" not in damping and not truth.damping.alpha and not parametric:
        holds = next((p.name for p in truth.ports if p.coupling == "rigid" and len(p.components) == 6), "")
        if holds:
            speed = [0.0, float(f"{0.05 * 2 * np.pi * truth.hz[0]:.4g}")]
            return choice, f'[spin]\nspeed = {speed}\naxis = {axis}\nheld = ["{holds}"]\nmodes = 4'
    if choice == "response":
        return choice, f"[response]\nfrom_hz = {truth.hz[0] / 3:.5g}\nto_hz = {truth.hz[0] * 2:.5g}\npoints = 20"
    if choice == "state space" and "structural" not in damping and model.inputs is None and not parametric:
        port = truth.ports[0].name
        return (
            choice,
            f'[state_space]\npath = "plant.npz"\ninputs = ["{port}:force"]\noutputs = ["{port}:displacement"]',
        )
    if choice == "envelope" and model.free == 6 and not parametric:
        return choice, f"[envelope]\nacceleration = {10 * length}\nspeed = 3.0\nforce = 100.0"
    return "none", ""


def _validity(job: Job, damping: str, extra: str) -> None:
    """What the documents do not promise."""
    methods = {drawn.method for drawn in job.reductions}
    reasons = [drawn.why_not for drawn in job.reductions if drawn.why_not]
    if extra in ("spin", "preload") and job.truth.model.family != "mesh":
        reasons += ["stress of a model without elements"] if extra == "preload" else []
    if extra == "spin" and job.truth.model.family == "beams":
        reasons.append("spin of masses that turn")
    if damping == "table" or "modal" in damping:
        reasons += [
            f"direct responses of {each.name} with modal damping"
            for each in job.reductions
            if "direct = true" in each.text
        ]
    if "structural" in damping and methods & {"irka"}:
        reasons.append("irka refuses structural damping")
    job.valid, job.why_not = not reasons, "; ".join(reasons)


def _outputs(rng: np.random.Generator, job: Job) -> None:
    """Commands that take the body afterwards."""
    job.after.append(["info", "body.h5"])
    if rng.random() < 0.25 and job.judged:
        target = str(rng.choice(TARGETS))
        name = job.reductions[0].name if job.reductions else "parametric"
        job.features["output"] = target
        job.after.append(["export", "body.h5", "--to", target, "--body", name])
    elif rng.random() < 0.1:
        job.features["output"] = "modes"
        job.after.append(["modes", "job.toml", "--count", "5"])
    elif rng.random() < 0.1:
        job.features["output"] = "batch"
        job.after.append(["batch", ".", "--jobs", "1"])
    if job.evaluation:
        job.after += job.evaluation.commands
