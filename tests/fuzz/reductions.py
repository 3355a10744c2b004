"""Reductions at random, with what each promises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.fuzz.truth import Truth

Band = tuple[float, float]
METHODS = (
    "auto",
    "modal",
    "guyan",
    "craig-bampton",
    "free-interface",
    "krylov",
    "gramian",
    "balanced-truncation",
    "irka",
    "static-modes-switching",
)
SHARES = (0.22, 0.16, 0.05, 0.2, 0.09, 0.1, 0.07, 0.05, 0.04, 0.02)

LOOSE = "the interfaces leave rigid motions free"


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """A ``[[reduce]]`` table. ``whole``: all modes of the model are kept; ``promise``: measure, tolerance, band and
    floor of auto; ``kind``: its method as the judge knows it; ``why_not``: why the documents promise no body."""

    name: str
    method: str
    text: str
    kind: str
    whole: bool = False
    promise: tuple[str, float, Band, float] | None = None
    why_not: str = ""


def draw_reductions(rng: np.random.Generator, truth: Truth, band: Band, damping: str) -> list[Drawn]:
    """One to three."""
    count = int(rng.choice([1, 2, 3], p=[0.5, 0.35, 0.15]))
    methods = rng.choice(METHODS, count, p=np.array(SHARES) / sum(SHARES))
    return [_one(rng, truth, band, damping, str(method), f"r{k + 1}") for k, method in enumerate(methods)]


def guyan(name: str) -> Drawn:
    """The method without a choice."""
    return Drawn(name=name, method="guyan", text=f'[[reduce]]\nmethod = "guyan"\nname = "{name}"', kind="guyan")


def _one(rng: np.random.Generator, truth: Truth, band: Band, damping: str, method: str, name: str) -> Drawn:
    make = {
        "auto": _auto,
        "modal": _modal,
        "craig-bampton": _craig,
        "free-interface": _free,
        "krylov": _krylov,
        "gramian": _gramian,
        "balanced-truncation": _balanced,
        "irka": _irka,
    }.get(method)
    lines, more = make(rng, truth, band, damping) if make else ([], {})
    if method == "static-modes-switching":
        nodes = sorted(set(truth.model.node.tolist()))[-3:]
        lines = [f'candidates = "ids:{",".join(str(n + 1) for n in nodes)}"', "base_options = { modes = 2 }"]
        lines.append(
            f"directions = {sorted(set(truth.model.component[np.isin(truth.model.node, nodes)].tolist()) & {0, 1, 2})}"
        )
        taken = np.isin(nodes, np.concatenate([port.nodes for port in truth.ports])).any()
        more = {"why_not": "a candidate lies on an interface"} if taken else {}
        more = more if truth.model.nodes else {"why_not": "coordinates have no directions"}
    if method == "guyan" and _loose(truth):
        more = {"why_not": LOOSE}
    text = "\n".join([f'[[reduce]]\nmethod = "{method}"\nname = "{name}"', *lines])
    return Drawn(**({"name": name, "method": method, "text": text, "kind": method} | more))


def _counts(truth: Truth) -> tuple[int, int, int]:
    """Elastic modes, modes with all interfaces held, inputs."""
    m = truth.B.shape[1]
    return len(truth.hz), len(truth.K) - m, m


def _auto(rng: np.random.Generator, truth: Truth, band: Band, damping: str):  # type: ignore[no-untyped-def]
    from tests.fuzz.jobs import floor_of

    tolerance = float(f"{10 ** rng.uniform(-6, -1):.2g}")
    measure = str(rng.choice(["envelope", "peak", "pointwise"], p=[0.6, 0.2, 0.2]))
    lines = [f"band_hz = [{band[0]}, {band[1]}]", f"tolerance = {tolerance}", f'measure = "{measure}"']
    lines += ["static_exact = true"] if rng.random() < 0.15 else []
    lines += ["inertia_loads = true"] if rng.random() < 0.15 and truth.model.nodes else []
    floor = floor_of(truth, band)
    if rng.random() < 0.15:
        floor = float(f"{10 ** rng.uniform(-3, -1):.3g}")
        lines.append(f"damping_floor = {floor}")
    return lines, {"promise": (measure, tolerance, band, floor)}


def _limit(rng: np.random.Generator, truth: Truth, most: int, most_share: float = 0.5) -> tuple[list[str], bool]:
    """``modes`` or ``up_to_hz`` and whether that is all."""
    if rng.random() < 0.25:
        k = int(rng.integers(0, min(len(truth.hz), 12)))
        return [f"up_to_hz = {truth.hz[k] * 1.17:.6g}"], False
    if rng.random() < 0.25:
        return [f"modes = {most}"], True
    return [f"modes = {int(rng.integers(1, max(2, int(most * most_share)) + 1))}"], False


def _loose(truth: Truth) -> bool:
    """Whether interfaces that are held leave a rigid motion free."""
    Z = (truth.B.T @ truth.rigid).astype(float) / truth.scale[:, None]
    return bool(truth.model.free and np.linalg.matrix_rank(Z, tol=1e-6 * np.abs(Z).max()) < truth.model.free)


def _modal(rng: np.random.Generator, truth: Truth, band: Band, damping: str):  # type: ignore[no-untyped-def]
    elastic, internal, _ = _counts(truth)
    if rng.random() < 0.12:
        lines, _ = _limit(rng, truth, internal)
        return [*lines, 'interfaces = "fixed"'], {"kind": "modal fixed", "why_not": LOOSE if _loose(truth) else ""}
    lines, whole = _limit(rng, truth, elastic)
    return lines, {"whole": whole}


def _craig(rng: np.random.Generator, truth: Truth, band: Band, damping: str):  # type: ignore[no-untyped-def]
    _, internal, m = _counts(truth)
    lines, whole = _limit(rng, truth, internal)
    if _loose(truth):
        return lines, {"why_not": LOOSE}
    extra = rng.random()
    if extra < 0.12 and not lines[0].startswith("up_to") and internal > 2 * m + 2 and m > truth.model.free:
        return [f"modes = {int(rng.integers(m, internal - m))}", "inertia_modes = true"], {}
    if extra < 0.2 and m > truth.model.free + 1:
        count = int(rng.integers(1, m - truth.model.free))
        return [*lines, f"interface_modes = {count}"], {}
    return lines, {"whole": whole}


def _free(rng: np.random.Generator, truth: Truth, band: Band, damping: str):  # type: ignore[no-untyped-def]
    elastic, _, m = _counts(truth)
    return _limit(rng, truth, max(1, elastic - m))[0], {}


def _krylov(rng: np.random.Generator, truth: Truth, band: Band, damping: str):  # type: ignore[no-untyped-def]
    elastic, _, m = _counts(truth)
    shifts = [0.0, *sorted(float(f"{x:.5g}") for x in rng.uniform(0.2, 3, int(rng.integers(0, 2))) * truth.hz[0])]
    # Each shift beyond 0 gives two columns a load.
    moments = min(int(rng.integers(1, 4)), elastic // (m * (2 * len(shifts) - 1)))
    if not moments:
        shifts, moments = [0.0], 1
    lines = [f"shifts_hz = {shifts}", f"moments = {moments}"]
    lines += [f"tangential = {int(rng.integers(1, m + 1))}"] if rng.random() < 0.15 else []
    lines += ["inertia_loads = true"] if rng.random() < 0.1 and truth.model.nodes else []
    return lines, {}


def _order(rng: np.random.Generator, truth: Truth) -> int:
    elastic = len(truth.hz)
    return int(rng.integers(1, max(2, elastic // 3)))


def _gramian(rng: np.random.Generator, truth: Truth, band: Band, damping: str):  # type: ignore[no-untyped-def]
    lines = [f"band_hz = [{band[0]}, {band[1]}]"]
    lines.append(
        f"order = {_order(rng, truth)}" if rng.random() < 0.5 else f"tolerance = {10 ** rng.uniform(-5, -1):.2g}"
    )
    if truth.D is not None or rng.random() < 0.15:
        lines.append("direct = true")
    lines += ['weight = "velocity"'] if rng.random() < 0.2 else []
    return lines, {}


def _balanced(rng: np.random.Generator, truth: Truth, band: Band, damping: str):  # type: ignore[no-untyped-def]
    variant = str(rng.choice(["fv", "pv", "so", "p", "v", "vp"], p=[0.5, 0.2, 0.1, 0.1, 0.05, 0.05]))
    lines = [f'variant = "{variant}"']
    lines.append(
        f"order = {_order(rng, truth)}" if rng.random() < 0.5 else f"tolerance = {10 ** rng.uniform(-5, -1):.2g}"
    )
    banded = rng.random() < 0.6
    lines += [f"band_hz = [{band[0]}, {band[1]}]"] if banded else []
    why = ""
    if not banded and ("structural" in damping or damping == "none"):
        why = "all frequencies need a damping matrix"
    if banded and damping == "own":
        why = "a band needs proportional damping"
    return lines, {"why_not": why}


def _irka(rng: np.random.Generator, truth: Truth, band: Band, damping: str):  # type: ignore[no-untyped-def]
    why = "irka takes no damping matrix and no loss factor" if "structural" in damping or damping == "own" else ""
    return [f"order = {_order(rng, truth)}", f"band_hz = [{band[0]}, {band[1]}]"], {"why_not": why}
