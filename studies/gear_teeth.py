"""Teeth of two spur gears mesh: switched static modes of all flank nodes beside a few modes, against all of the model.

Each gear is a solid sector of three involute teeth, reduced by static modes switching with its flank nodes as
candidates. Along one pitch the contact of all tooth pairs is solved (no pulling forces, a given torque) with the static
modes of the touched elements alone. Draws gear_teeth.png: transmission error, sharing of the load, active candidates.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, parse

from data.make_spur_gear import CELLS, MODULE, PRESSURE, TEETH, WIDTH, Gear, Sector, pair, sector
from morembs.base.types import Ints
from morembs.dynamics.multibody.contact.lemke import lemke
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import ReducedModel, StaticModesSwitching
from morembs.responses.static_mode_tables import StaticModeTables

MODES = 20
FORCE = 4000.0  # N along the line of action, 200 N/mm
RELIEF, RELIEVED = 20e-6, 3e-3  # m at the ends of the path of contact, m of roll
PLACES, QUICK_PLACES, QUICK_CELLS = 81, 13, (2, 1, 4, 1, 1, 4)
STRIP = 8  # samples over the width of an element


@dataclass(frozen=True, kw_only=True, eq=False)
class Reduced:
    """A gear, held at its hub: its modes and the tables of its flank nodes."""

    sector: Sector
    reduced: ReducedModel
    tables: StaticModeTables

    @cached_property
    def elastic(self) -> Ints:
        """Coordinates that move while the hub stays."""
        return np.flatnonzero([kind == "fixed-interface" for kind in self.reduced.mode_kind])

    @cached_property
    def candidate(self) -> Ints:
        """(3, rows, lines): that of each flank node."""
        ids = self.sector.model.nodes.ids[self.sector.flank]
        return np.searchsorted(self.tables.node_ids, ids)

    def by_modes(self, some: Ints) -> Floats:
        """(k, k) m/N compliance of the modes at candidates."""
        rows = self.tables.modes[np.ix_(some, self.elastic)]
        return np.asarray(rows @ np.linalg.solve(self.reduced.K[np.ix_(self.elastic, self.elastic)], rows.T))

    def compliance(self, some: Ints) -> Floats:
        """(k, k) m/N of modes and the static modes of these candidates alone."""
        return self.by_modes(some) + self.tables.R(some)


def reduce(gear: Gear, modes: int = MODES, cells: Sequence[int] = CELLS) -> Reduced:
    """Modes of the held sector, and static modes of all flank nodes along their normals."""
    teeth = sector(gear, cells)
    ids = ",".join(map(str, teeth.model.nodes.ids[np.sort(teeth.flank.ravel())]))
    reducer = StaticModesSwitching(
        base="craig-bampton",
        base_options={"modes": modes},
        candidates=f"ids:{ids}",
        directions="normals",
        kind="surface",
    )
    with Problem(teeth.model, [make_interface(teeth.model, name="hub", nodes=teeth.bore, point=(0, 0, 0))]) as problem:
        reduced = reducer.reduce(problem)
        return Reduced(sector=teeth, reduced=reduced, tables=reducer.tabulate_static_modes(problem, reduced))


def whole_compliance(gear: Reduced) -> Floats:
    """(c, c) m/N of all candidates: the whole model, held at its bore, solved for each of them."""
    model, tables = gear.sector.model, gear.tables
    free = np.flatnonzero(~np.isin(model.dofs.node, gear.sector.bore))
    place = np.full(3 * len(model.nodes), -1)
    place[3 * model.dofs.node[free] + model.dofs.component[free]] = np.arange(len(free))
    rows = place[3 * (tables.node_ids - 1)[:, None] + np.arange(3)]
    B = np.zeros((len(free), tables.count))
    B[rows, np.arange(tables.count)[:, None]] = tables.direction
    K = sp.csc_matrix(model.K)[free][:, free]
    factor = spl.splu(K.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(B.T @ factor.solve(B))


@dataclass(frozen=True, kw_only=True, eq=False)
class Touch:
    """One place of the gears: points that may touch, of ``pair`` (p,) -1, 0, 1, with ``gap`` (p,) m; for each gear the
    active candidates and the weights (p, active) of the points."""

    pair: Ints
    gap: Floats
    active: tuple[Ints, Ints]
    weights: tuple[Floats, Floats]


def base_pitch() -> float:
    """Distance of tooth pairs along the line of action, m."""
    return math.pi * MODULE * math.cos(PRESSURE)


def touch(gears: tuple[Reduced, Reduced], place: float) -> Touch:
    """Points on the line of action where the middle pair is ``place`` m behind the pitch point."""
    driver, driven = (g.sector.gear for g in gears)
    along = (driver.pitch + driven.pitch) * math.sin(PRESSURE)
    pairs, gaps = [], []
    rolls: list[tuple[float, float]] = []
    for k in (-1, 0, 1):
        first = driver.pitch * math.sin(PRESSURE) + place + k * base_pitch()
        second = along - first
        if driver.lowest <= first <= driver.highest and driven.lowest <= second <= driven.highest:
            nearest = min(driver.highest - first, driven.highest - second)
            pairs.append(k)
            rolls.append((first, second))
            gaps.append(RELIEF * max(0.0, 1 - nearest / RELIEVED) ** 2)
    active, weights = [], []
    for number, gear in enumerate(gears):
        # The driven gear turns the other way, so its teeth come in the other order.
        teeth = [k if number == 0 else -k for k in pairs]
        some, W = _weights(gear, teeth, [r[number] for r in rolls])
        active.append(some)
        weights.append(W)
    lines = gears[0].sector.flank.shape[2]
    return Touch(
        pair=np.repeat(pairs, lines),
        gap=np.repeat(gaps, lines),
        active=(active[0], active[1]),
        weights=(weights[0], weights[1]),
    )


def _weights(gear: Reduced, teeth: Sequence[int], rolls: Sequence[float]) -> tuple[Ints, Floats]:
    """Candidates of the touched elements, and how they move the points.

    A point is the mean of a strip as wide as an element: such elements do not resolve what is narrower, such as Hertz's
    pressure. Along the strip the shape functions of element edges hold.
    """
    flanks = gear.sector
    lines, step = flanks.flank.shape[2], 2 * (flanks.roll[1] - flanks.roll[0])
    strip = step * ((np.arange(STRIP) + 0.5) / STRIP - 0.5)
    rows = []
    for roll in rolls:
        x = (np.clip(roll + strip, flanks.roll[0], flanks.roll[-1]) - flanks.roll[0]) / step
        element = np.minimum(x.astype(int), (len(flanks.roll) - 1) // 2 - 1)
        x -= element
        row = np.zeros(len(flanks.roll))
        for k, values in enumerate(((2 * x - 1) * (x - 1), 4 * x * (1 - x), x * (2 * x - 1))):
            np.add.at(row, 2 * element + k, values / STRIP)
        rows.append(row)
    used = [gear.candidate[tooth + 1, row != 0] for tooth, row in zip(teeth, rows, strict=True)]
    some = np.unique(np.concatenate([nodes.ravel() for nodes in used]))
    W = np.zeros((lines * len(used), len(some)))
    for number, (nodes, row) in enumerate(zip(used, rows, strict=True)):
        for line in range(lines):
            W[number * lines + line, np.searchsorted(some, nodes[:, line])] = row[row != 0]
    return some, W


def solve(at: Touch, C: Sequence[Floats], force: float = FORCE) -> tuple[float, Floats]:
    """Approach (m) along the line of action and forces (p,) N: 0 <= gap + C f - approach, 0 <= f, sum f = force."""
    A = sum(W @ compliance @ W.T for W, compliance in zip(at.weights, C, strict=True))
    p, unit = len(A), float(np.abs(A).max())
    M = np.zeros((p + 1, p + 1))
    # The approach is the last unknown; its row says that the forces carry the torque.
    M[:p, :p], M[:p, p], M[p, :p] = A / unit, -1.0, 1.0
    solution = lemke(M, np.concatenate((at.gap / (unit * force), [-1.0]))).z
    return float(solution[p] * unit * force), solution[:p] * force


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycle:
    """Over a pitch: approach (s,) m, load of the three pairs (s, 3) N, active candidates (s,), seconds."""

    approach: Floats
    load: Floats
    active: Ints
    seconds: float


def cycle(gears: tuple[Reduced, Reduced], places: Floats, whole: Sequence[Floats] | None, static: bool = True) -> Cycle:
    """With all of the ``whole`` compliance, or that of modes with (or without) active static modes."""
    approach, load, active, begin = [], [], [], time.process_time()
    for place in places:
        at = touch(gears, float(place))
        if whole is not None:
            C = [compliance[np.ix_(some, some)] for compliance, some in zip(whole, at.active, strict=True)]
        else:
            C = [g.compliance(some) if static else g.by_modes(some) for g, some in zip(gears, at.active, strict=True)]
        near, f = solve(at, C)
        approach.append(near)
        load.append([f[at.pair == k].sum() for k in (-1, 0, 1)])
        active.append(sum(map(len, at.active)))
    return Cycle(
        approach=np.array(approach), load=np.array(load), active=np.array(active), seconds=time.process_time() - begin
    )


def standard() -> float:
    """Stiffness of one pair of teeth, N/(mm micrometre), by ISO 6336-1 (method B, spur gears of solid discs)."""
    q = 0.04723 + 0.15551 / TEETH[0] + 0.25791 / TEETH[1]
    basic_rack = 1 + 0.5 * (1.2 - 1.25)
    return 0.8 * basic_rack / q


def picture(path: Path, places: Floats, switched: Cycle, full: Cycle, modes: Cycle, candidates: int) -> None:
    """Transmission error, sharing of the load, active candidates."""
    x = places / base_pitch()
    shares = [
        Curve(x=x, y=switched.load[:, k] / FORCE, label=f"{name} pair", color=color)
        for k, name, color in ((0, "following", THIRD), (1, "middle", OURS), (2, "leading", THEIRS))
    ]
    draw(
        path,
        f"Meshing teeth of spur gears, {TEETH[0]} : {TEETH[1]}",
        [
            Panel(
                title=f"Transmission error under {FORCE / 1e3:g} kN",
                x="rotation, pitches",
                y="micrometres",
                curves=[
                    Curve(x=x, y=1e6 * full.approach, label="all of the model", color=THEIRS),
                    Curve(x=x, y=1e6 * switched.approach, label=f"{MODES} modes, switched static modes", style="--"),
                    Curve(x=x, y=1e6 * modes.approach, label=f"{MODES} modes alone", color=THIRD, width=1.0),
                ],
            ),
            Panel(title="Sharing of the load", x="rotation, pitches", y="parts of the load", curves=shares),
            Panel(
                title=f"Active candidates of {candidates}",
                x="rotation, pitches",
                y="candidates",
                curves=[Curve(x=x, y=switched.active.astype(float))],
            ),
        ],
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs, draws and prints the figures. Returns the exit code."""
    options = parse(arguments, "Meshing gear teeth with switched static modes.", __file__)
    driver, driven = (reduce(gear, cells=QUICK_CELLS if options.quick else CELLS) for gear in pair())
    gears = (driver, driven)
    candidates = sum(g.tables.count for g in gears)
    print(f"two sectors of {driver.sector.model.size} and {driven.sector.model.size} dofs, {candidates} candidates")
    places = base_pitch() * np.linspace(-0.5, 0.5, QUICK_PLACES if options.quick else PLACES)
    switched = cycle(gears, places, None)
    full = cycle(gears, places, [whole_compliance(g) for g in gears])
    modes = cycle(gears, places, None, static=False)
    error = float(np.abs(switched.approach - full.approach).max() / full.approach.max())
    print(
        f"transmission error: {1e6 * full.approach.min():.2f} to {1e6 * full.approach.max():.2f} micrometres; "
        f"switched static modes differ from all of the model by {error:.1e} of it"
    )
    lost = float(np.abs(modes.approach - full.approach).max() / full.approach.max())
    print(f"{MODES} modes alone differ by {100 * lost:.0f} %")
    print(
        f"active candidates: {switched.active.min()} to {switched.active.max()} of {candidates}, "
        f"{1e3 * switched.seconds / len(places):.2f} ms for each place"
    )
    stiffness = FORCE / WIDTH / full.approach * 1e-9
    print(
        f"stiffness of the mesh: {stiffness.min():.1f} (one pair) to {stiffness.max():.1f} N/(mm micrometre); "
        f"ISO 6336 gives {standard():.1f} for one pair"
    )
    picture(options.folder / "gear_teeth.png", places, switched, full, modes, candidates)
    return 0


if __name__ == "__main__":
    sys.exit(main())
