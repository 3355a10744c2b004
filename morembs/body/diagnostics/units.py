"""Do the numbers look like the units they are read as? Judged by speed of sound, density and size.

Wave speeds of solids lie between 30 m/s (soft rubber) and 18 km/s (diamond), densities between 10 (foam) and
23,000 kg/m3. Matrices show both: c is near h sqrt(K_ii / M_ii) / 2 and the density near M_ii over its share of the
volume of its neighbourhood; h is the distance to the nearest node that a node is coupled to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Floats
from morembs.base.units import Units, parse_units
from morembs.body.diagnostics.findings import Finding
from morembs.body.diagnostics.tolerances import TOL
from morembs.fem import DofMap, Nodes
from morembs.fem.material import Material

SYSTEMS = (
    "m-kg-s",
    "mm-t-s",
    "mm-kg-s",
    "mm-kg-ms",
    "mm-g-ms",
    "cm-g-s",
    "um-kg-s",
    "in-slinch-s",
    "in-lb-s",
    "ft-slug-s",
)


def estimate(K: sp.csr_array, M: sp.csr_array, nodes: Nodes, dofs: DofMap) -> tuple[float, float] | None:
    """Speed of sound and density in units of the input, within a factor of a few; None where they are unknown.

    The density of beams and plates comes out too low.
    """
    table = dofs.of_nodes(np.unique(dofs.node))
    table = table[(table >= 0).all(axis=1)]
    if not len(table):
        return None
    stiff, heavy = K.diagonal(), M.diagonal()
    rows = np.random.default_rng(9).permutation(len(table))[: TOL.sampled_nodes]
    speed, density = [], []
    for here in table[rows]:
        near = [
            K.indices[K.indptr[row] : K.indptr[row + 1]][K.data[K.indptr[row] : K.indptr[row + 1]] != 0] for row in here
        ]
        others = np.unique(dofs.node[np.concatenate(near)])
        arms = nodes.xyz[others] - nodes.xyz[dofs.node[here[0]]]
        distance = np.linalg.norm(arms, axis=1)
        h = distance[distance > 0].min(initial=np.inf)
        k, m = stiff[here].max(), heavy[here].mean()
        if np.isfinite(h) and k > 0 and m > 0:
            # Half of it agrees with sound in elements of most types.
            speed.append(0.5 * h * np.sqrt(k / m))
            span = np.ptp(arms, axis=0)
            span[span < TOL.flat_side * span.max()] = span.max()
            density.append(8 * m / span.prod())
    return (float(np.median(speed)), float(np.median(density))) if speed else None


@dataclass(frozen=True, kw_only=True)
class Outlook:
    """What a body is by its numbers (SI): ``extent`` (3,) along x, y, z, ``mass`` (nan where not known), and the first
    elastic frequency of a free solid bar of this extent: curved or hollow bodies are several times softer."""

    extent: tuple[float, float, float]
    mass: float
    first_hz: float

    @property
    def words(self) -> str:
        """A line for people."""
        known = f", {self.mass:.4g} kg" if np.isfinite(self.mass) else ""
        hz = f"; a solid bar of this size vibrates from about {_one_digit(self.first_hz)} Hz on"
        size = " x ".join(f"{side:.4g}" for side in self.extent)
        return f"{size} m{known}{hz if np.isfinite(self.first_hz) else ''}"


def _one_digit(value: float) -> str:
    return f"{float(f'{value:.0e}'):g}"


def outlook(speed: float, extent: Floats, mass: float) -> Outlook:
    """What to expect of a body in a box of ``extent`` (3,): bending of a bar as thin as its box, or waves along it.

    A body that is curved, hollow or not along the axes may be several times softer.
    """
    low, high = float(extent.min()), float(extent.max())
    waves = speed / (2 * high) if high else np.nan
    bending = TOL.free_bar_bending * speed * low / np.sqrt(12) / high**2 if low else waves
    return Outlook(extent=tuple(extent.tolist()), mass=mass, first_hz=float(min(waves, bending)))


def model_outlook(
    K: sp.csr_array, M: sp.csr_array, nodes: Nodes, dofs: DofMap, materials: Sequence[Material]
) -> Outlook:
    """``outlook`` of a model (SI), by its materials where it has some, else by its matrices."""
    estimated = None if materials else estimate(K, M, nodes, dofs)
    speeds = [wave_speed(material) for material in materials]
    speed = float(np.mean(speeds)) if speeds else (estimated or (np.nan,))[0]
    along = (dofs.component == 0).astype(float)
    used = nodes.xyz[np.unique(dofs.node)]
    return outlook(speed, np.ptp(used, axis=0) if len(used) else np.zeros(3), float((along @ (M @ along)).real))


def wave_speed(material: Material) -> float:
    """Speed of compression waves."""
    return float(np.sqrt(max(material.stiffness[0, 0], 0.0) / material.density))


def unit_findings(
    estimated: tuple[float, float] | None,
    materials: Sequence[Material],
    extent: Floats,
    units: Units,
    declared: Units | None = None,
    mass: float = np.nan,
) -> list[Finding]:
    """True if numbers in ``units`` can be those of an elastic body of ``extent`` (3,) and ``mass`` (in the same units).

    ``declared`` are the units that the numbers were read as before they were converted to ``units``, where they were.
    """
    size = float(np.linalg.norm(extent))
    if materials:
        pairs = [(wave_speed(material), material.density) for material in materials]
        speeds, densities = TOL.material_speeds, TOL.material_densities
    elif estimated is not None:
        pairs, speeds, densities = [estimated], TOL.speeds, TOL.densities
    else:
        return []
    for speed, density in pairs:
        c, rho = speed * units.length / units.time, density * units.density
        slow, light = not speeds[0] <= c <= speeds[1], not densities[0] <= rho <= densities[1]
        # Beams and plates come out light, but not also as long as a coordinate in mm makes them.
        light = light or (rho < TOL.material_densities[0] and size * units.length > TOL.large_size)
        # Steel in mm-t-s that is read as mm-kg-s: a thousandth of its density at its own speed of sound.
        light = light or bool(materials and rho < TOL.foam_density and c > TOL.fastest_foam)
        low, high = TOL.material_moduli
        slow = slow or bool(materials and rho > TOL.metal_density and c < TOL.slowest_metal)
        if slow or light or (materials and not low <= rho * c**2 <= high):
            return [_wrong(c, rho, size * units.length, units, declared)]
    meters = size * units.length
    if meters > TOL.large_size:
        severity = "warning" if meters > TOL.too_large else "note"
        sentence = f"the body is {meters:.4g} m long"
        cure = (
            "if its coordinates are in mm, declare such units and give the material in them too (steel in mm-t-s: "
            "210e3 MPa and 7.85e-9 t/mm3)"
        )
        return [Finding(code="size", severity=severity, sentence=sentence, cure=cure)]
    taken = declared or units
    if (
        meters < TOL.small_size
        and TOL.sizes_in_meters[0] <= meters / taken.length <= TOL.sizes_in_meters[1]
        and taken.length > TOL.micro_unit
    ):
        estimate = outlook(pairs[0][0] * units.length / units.time, extent * units.length, mass * units.mass)
        sentence = f"taken in {taken.name}, the body is tiny: {estimate.words}"
        cure = (
            f"if its longest side is {max(estimate.extent) / taken.length:.3g} m, its coordinates are in m: give units "
            "m-kg-s and the material in Pa and kg/m3, or the coordinates in the units that were declared"
        )
        return [Finding(code="size", severity="warning", sentence=sentence, cure=cure)]
    return []


def _wrong(c: float, rho: float, meters: float, units: Units, declared: Units | None) -> Finding:
    """The finding for a speed of sound ``c`` in m/s, a density ``rho`` in kg/m3 and a size in m."""
    taken = declared or units
    sentence = (
        f"taken in {taken.name}{' as declared' if declared is not None else ''}, the speed of sound in this body would "
        f"be about {c:.2g} m/s, its density about {rho:.2g} kg/m3 and its length {meters:.3g} m"
    )
    words, cure = _diagnose_units(c, rho, meters, taken)
    if not words and declared is None:
        # Perhaps an import converted them from other units than they were in.
        for name in SYSTEMS:
            likely = likely_units(
                *_convert_to_units(c, rho, meters, parse_units(name)), parse_units(name), TOL.near_metal
            )
            if likely is not None:
                words = f"the numbers look like {likely} that was read as {name}"
                cure = f"if the model was imported, import it again with --units {likely}"
                break
    if not words:
        cure = "no known system of units makes sense of them; check the units of length, modulus and density"
    return Finding(code="units", severity="warning", sentence=f"{sentence}; {words}" if words else sentence, cure=cure)


def _convert_to_units(c: float, rho: float, meters: float, units: Units) -> tuple[float, float, float]:
    """Speed of sound, density and size as the numbers of an input in ``units`` have them."""
    return c * units.time / units.length, rho / units.density, meters / units.length


def _diagnose_units(c: float, rho: float, meters: float, taken: Units) -> tuple[str, str]:
    """What the numbers of an input taken in the units ``taken`` look like, and the cure; empty where not known."""
    speed, density, size = _convert_to_units(c, rho, meters, taken)
    alone = _thousandfold(c, rho, meters, taken)
    if alone:
        return alone
    name = likely_units(speed, density, size, taken)
    material = (
        f"give the material in {taken.name} too (steel: modulus {TOL.steel_modulus / taken.stress:.3g}, density "
        f"{TOL.steel_density / taken.density:.3g})"
    )
    # A modulus in Pa and a density in kg/m3, while the coordinates may well be as they were taken.
    beside = _is_solid(speed) and _in_si(density) and TOL.least_size < meters < TOL.long_size
    if name is not None:
        there = parse_units(name)
        words = (
            f"the numbers look like {name} (sound at {speed * there.length / there.time:.2g} m/s, "
            f"{density * there.density:.2g} kg/m3, a body {size * there.length:.3g} m long)"
        )
        cure = f'give units = "{name}" in a job or in Python, --units {name} in an import'
        return words, f"{cure}; or, if the coordinates are in {taken.name}, {material}" if (
            beside and size * there.length > TOL.long_size
        ) else cure
    if _mixed(speed, density):
        words = "it looks like lengths and moduli in mm and N/mm2 (MPa) beside a density in kg/m3"
        return words, "give the density in t/mm3 (steel 7.85e-9), and units mm-t-s"
    if beside:
        return f"it looks like a material in Pa and kg/m3 beside coordinates in {taken.name}", material
    return "", ""


def _thousandfold(c: float, rho: float, meters: float, taken: Units) -> tuple[str, str] | None:
    """What is wrong and its cure where modulus or density alone, a thousand times as large or small, is a metal's."""
    if not TOL.small_size < meters < TOL.long_size:
        return None
    # The prefix kilo too much or too little.
    for factor, words in ((1e3, "large"), (1e-3, "small")):
        for what, speed, density, steel in (
            ("density", c * np.sqrt(factor), rho / factor, TOL.steel_density / taken.density),
            ("modulus", c / np.sqrt(factor), rho, TOL.steel_modulus / taken.stress),
        ):
            if _from_metal(speed, density) < TOL.near_metal:
                return (
                    f"it looks like a {what} that is a thousand times too {words}",
                    f"give it in {taken.name}, as the other numbers (steel {steel:.3g})",
                )
    return None


def _from_metal(c: float, rho: float) -> float:
    """Distance in powers of ten to a metal; the speed ``c`` is the better estimate of the two."""
    return float(2 * abs(np.log10(c / TOL.usual_metal_speed)) + abs(np.log10(rho / TOL.usual_metal_density)))


def _is_solid(speed: float) -> bool:
    """True if sound travels at ``speed`` m/s in what bodies are made of."""
    return TOL.slowest_metal < speed < TOL.material_speeds[1]


def _in_si(density: float) -> bool:
    """True if the number of a density looks like one in kg/m3."""
    return TOL.least_density < density < TOL.material_densities[1]


def _mixed(speed: float, density: float) -> bool:
    """True if a density in kg/m3 stands beside a modulus in MPa: the speed is that of sound over 1000."""
    slowest, fastest = TOL.slowest_metal / 1000, TOL.material_speeds[1] / 1000
    return _in_si(density) and slowest < speed < fastest


def likely_units(speed: float, density: float, size: float, declared: Units, furthest: float = np.inf) -> str | None:
    """The system in which the numbers are nearest to a metal; None where none comes near, or beyond ``furthest``."""
    best: tuple[float, str] | None = None
    for name in SYSTEMS:
        there = parse_units(name)
        c, rho, meters = speed * there.length / there.time, density * there.density, size * there.length
        same = (there.length, there.mass, there.time) == (declared.length, declared.mass, declared.time)
        if same or not (
            _is_solid(c)
            and TOL.likely_densities[0] < rho < TOL.likely_densities[1]
            and TOL.least_size < meters < TOL.large_size
        ):
            continue
        distance = _from_metal(c, rho)
        if distance < furthest and (best is None or distance < best[0]):
            best = distance, name
    return None if best is None else best[1]
