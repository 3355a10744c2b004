"""Parameters at random: moduli, densities, springs and Rayleigh damping of meshes, and what ``evaluate`` gives."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tests.fuzz.files import UNITS
from tests.fuzz.judge import Verdict, bodies
from tests.fuzz.truth import Truth

Band = tuple[float, float]
PROPERTIES = ("young", "density", "beta", "alpha", "spring")
AT = "at.h5"
# Relative error of H by the envelope that round-off may be, beside the bound.
LEAST = 1e-8


@dataclass(kw_only=True)
class Evaluation:
    """Tables of a job, nominal values and those at which its body is judged (SI), and the tolerance."""

    text: str
    properties: list[str]
    nominal: dict[str, float]
    values: dict[str, float]
    tolerance: float
    band: Band
    stiffness: tuple[float, ...] = ()
    port: int = 0
    commands: list[list[str]] = field(default_factory=list)

    def judge(self, folder: Path, truth: Truth, rng: np.random.Generator, floor: float) -> Verdict:
        """The body at the values against the model there."""
        there = self.at(truth, self.values)
        # Moments count by the radius of gyration of nominal values.
        there.__dict__["scale"] = truth.scale
        (body,), _ = bodies(folder / AT)
        verdict = Verdict([])
        off = np.sqrt(np.maximum(np.linalg.eigvals(np.linalg.solve(body.M, body.K)).real, 0)) / (2 * np.pi)
        found = np.sort(off)[there.model.free :]
        low = found[: len(there.hz)] / there.hz[: len(found)] - 1
        if (low < -1e-6 - 1e3 * there.rounding[: len(low)] / there.modes[0][: len(low)].astype(float)).any():
            verdict.wrong.append(f"at {self.values}: a frequency lies below that of the model by {-low.min():.1e}")
        omega = 2 * np.pi * np.concatenate([rng.uniform(*self.band, 8), [self.band[0], self.band[1]]])
        E = there.H(omega, 2 * floor) - body.H(omega, there.damping.structural + 2 * floor, truth.scale)
        ratio = np.sqrt((np.abs(E) ** 2).sum(axis=(1, 2))).astype(float) / there.envelope(omega, 2 * floor)
        verdict.points += len(omega)
        # The tolerance is kept at the values of training; between them the error may be some times larger.
        if ratio.max() > 10 * self.tolerance + LEAST:
            verdict.wrong.append(
                f"at {self.values}: off by {ratio.max():.1e} of the envelope, {self.tolerance:.1e} was asked for"
            )
        return verdict

    def at(self, truth: Truth, values: dict[str, float]) -> Truth:
        """The model at ``values``, ``truth`` being that without parameters."""
        model, solid, damping = truth.model, truth.model.solid, truth.damping
        ones = np.ones(len(solid.cells))
        K, M = solid.matrices(
            young=values.get("young", solid.young) * ones, density=values.get("density", solid.density) * ones
        )
        damping = replace(damping, **{k: values[k] for k in ("alpha", "beta") if k in values})
        there = Truth(replace(model, K=K, M=M), truth.ports, damping)
        if "spring" in values:
            first = sum(len(p.components) for p in truth.ports[: self.port])
            B = there.B[:, first : first + 6]
            there.K = there.K + np.longdouble(values["spring"]) * (B * np.array(self.stiffness)) @ B.T
            there.model = replace(there.model, free=0)
        return there


def draw(rng: np.random.Generator, truth: Truth, units: str, band: Band) -> Evaluation | None:
    """One or two parameters of a mesh; none where its damping or interfaces take none."""
    solid, (_, stress, density) = truth.model.solid, UNITS[units]
    frames = [k for k, p in enumerate(truth.ports) if p.coupling in ("rigid", "average") and len(p.components) == 6]
    direct_before = any(p.coupling == "direct" for p in truth.ports)
    possible = [
        p
        for p in PROPERTIES
        if p != "spring" or (frames and not direct_before and all(len(q.components) == 6 for q in truth.ports))
    ]
    if truth.damping.steps:
        possible = [p for p in possible if p not in ("alpha", "beta")]
    chosen = [str(p) for p in rng.choice(possible, min(int(rng.integers(1, 3)), len(possible)), replace=False)]
    tables, nominals, values, stiffness, port = [], {}, {}, (), 0
    omega = 2 * np.pi * truth.hz[0]
    for name in chosen:
        extra = ""
        if name == "young":
            nominal, unit = solid.young, stress
        elif name == "density":
            nominal, unit = solid.density, density
        elif name == "spring":
            nominal, unit, port = 1.0, 1.0, int(rng.choice(frames))
            k = float(f"{0.1 * omega**2 * truth.mass[0]:.3g}")
            stiffness = (k, k, k, *[float(f"{k * float(np.ptp(truth.model.xyz[:, 0])) ** 2:.3g}")] * 3)
            in_job = [x / (1e3 if units == "mm-t-s" else 1) for x in stiffness[:3]]
            in_job += [x * (1e3 if units == "mm-t-s" else 1) for x in stiffness[3:]]
            extra = f'interface = "{truth.ports[port].name}"\nstiffness = {in_job}\n'
        else:
            # A factor of the job is the nominal one.
            drawn = float(f"{0.01 * omega if name == 'alpha' else 0.01 / omega:.3g}")
            nominal, unit = getattr(truth.damping, name) or drawn, 1.0
        low, high = (0.0 if name in ("alpha", "beta") and rng.random() < 0.4 else 0.6), 1.5
        tables.append(
            f'[[parameter]]\nname = "{name}"\nproperty = "{name}"\n{extra}'
            f"range = [{low * nominal * unit!r}, {high * nominal * unit!r}]\n"
            + (f"nominal = {nominal * unit!r}\n" if name in ("alpha", "beta", "spring") else "")
        )
        nominals[name] = nominal
        values[name] = float(f"{nominal * rng.uniform(0.7, 1.4):.5g}")
    tolerance = float(rng.choice([1e-2, 1e-3, 1e-4]))
    band = (0.0, band[1]) if rng.random() < 0.6 else band
    text = f'\n[[reduce]]\nmethod = "parametric"\nband_hz = [{band[0]}, {band[1]}]\n'
    text += f"tolerance = {tolerance}\ntraining = 8\n"
    at = ",".join(f"{name}={value!r}" for name, value in values.items())
    commands = [["evaluate", "body.h5", "--at", at, "-o", AT], ["info", AT]]
    return Evaluation(
        text="\n".join(tables) + text,
        properties=chosen,
        nominal=nominals,
        values=values,
        tolerance=tolerance,
        band=band,
        stiffness=stiffness,
        port=port,
        commands=commands,
    )
