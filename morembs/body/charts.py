"""Charts of bodies: receptances, modal density, MAC, Campbell diagram, and what stages cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from morembs.base.charts import Bars, Chart, Curve, Dash, Matrix, Panel
from morembs.base.errors import InputError, quote_value
from morembs.base.tolerances import TOL as BASE
from morembs.base.types import Complexes, Floats
from morembs.body.floating.spin import Spinning, campbell
from morembs.body.tolerances import TOL


class Charted(Spinning, Protocol):
    """What charts take of a body; the fields are those of ``Body``."""

    @property
    def frequencies_hz(self) -> Floats: ...

    @property
    def rigid_count(self) -> int: ...

    @property
    def input_matrix(self) -> Floats: ...

    @property
    def output_matrix(self) -> Floats: ...

    def frequency_response(self, frequencies_hz: Any) -> Complexes:
        """Transfer matrices (nf, m, m)."""
        ...

    def modes(self, count: int) -> Floats:
        """Shapes (k, n, 3)."""
        ...


def response_chart(body: Charted, frequencies_hz: Any, entries: Sequence[tuple[int, int]] | None) -> Chart:
    """Size and phase of entries (motion, load) of the transfer matrix, counted from 1; see ``Body.plot_response``.

    Raises:
        InputError: an entry that the body does not have, or no frequencies.
    """
    motions, loads = body.output_matrix.shape[0], body.input_matrix.shape[1]
    if entries is None:
        entries = [(k, k) for k in range(1, 1 + min(motions, loads, TOL.drawn_receptances))]
    if not entries:
        raise InputError(
            f"no entries were given, or body {body.name!r} has no interfaces; expected pairs (motion, load)",
            kind="missing",
            keyword="entries",
        )
    for i, j in entries:
        if not (1 <= i <= motions and 1 <= j <= loads):
            raise InputError(
                f"the entry {(i, j)} was given; body {body.name!r} has motions 1 to {motions} and loads 1 to {loads}",
                keyword="entries",
            )
    hz = _frequencies(body) if frequencies_hz is None else _check_frequencies(frequencies_hz)
    H = body.frequency_response(hz)
    named = {f"motion {i} by load {j}": H[:, i - 1, j - 1] for i, j in entries}
    sizes = [Curve(name=name, x=hz, y=np.abs(h), color=k) for k, (name, h) in enumerate(named.items())]
    phases = [
        Curve(name=name, x=hz, y=np.degrees(np.unwrap(np.angle(h))), color=k)
        for k, (name, h) in enumerate(named.items())
    ]
    return Chart(
        title=f"Frequency response of {body.name}",
        panels=(
            Panel(y_label="size in m/N, rad/N, rad/(Nm)", curves=sizes),
            Panel(y_label="phase in degrees", curves=phases, y_log=False),
        ),
    )


def _check_frequencies(frequencies_hz: Any) -> Floats:
    """Frequencies (nf,) that were asked for; an axis of ratios has no place for 0."""
    try:
        hz = np.atleast_1d(np.asarray(frequencies_hz, dtype=float))
    except (TypeError, ValueError):
        hz = np.empty(0)
    if hz.ndim != 1 or not (hz > 0).any() or not ((hz >= 0) & (hz < BASE.largest_hz)).all():
        raise InputError(
            f"frequencies_hz = {quote_value(frequencies_hz)} was given; expected a row of frequencies in Hz below "
            f"{BASE.largest_hz:g}, one of them above 0",
            keyword="frequencies_hz",
        )
    return hz[hz > 0]


def _frequencies(body: Charted) -> Floats:
    """From a tenth of the first elastic frequency to twice the last, as close at each as resonances need."""
    elastic = body.frequencies_hz[body.rigid_count :]
    if not len(elastic):
        raise InputError(f"body {body.name!r} has no elastic modes; give frequencies_hz")
    return np.union1d(np.geomspace(elastic[0] / 10, 2 * elastic[-1], TOL.drawn_frequencies), elastic)


def density_chart(bodies: Mapping[str, Floats], full: Floats | None = None) -> Chart:
    """Modes below each frequency, and modes in each third of an octave over its width.

    Args:
        bodies: elastic frequencies (k,) in Hz by name, ascending.
        full: those of the full model, as far as they are known.
    """
    known = ({} if full is None else {"full model": full}) | dict(bodies)
    unknown = sum(int((~np.isfinite(hz)).sum()) for hz in known.values())
    known = {name: hz[(hz > 0) & np.isfinite(hz)] for name, hz in known.items()}
    known = {name: hz for name, hz in known.items() if len(hz)}
    if not known:
        raise InputError("no elastic frequencies were given; keep at least one mode", kind="missing", keyword="modes")
    colors: dict[str, int | None] = {name: number for number, name in enumerate(bodies)} | {"full model": None}
    low, high = (end(hz) for end, hz in ((min, [f[0] for f in known.values()]), (max, [f[-1] for f in known.values()])))
    # Thirds of octaves as in acoustics (IEC 61260), from the first mode on.
    edges = low * 2.0 ** ((np.arange(2 + np.ceil(3 * np.log2(high / low))) - 0.5) / 3)
    counts, densities = [], []
    for name, hz in known.items():
        dash: Dash = "solid" if colors[name] is None else "dashed"
        steps = np.repeat(np.arange(len(hz) + 1.0), 2)[1:-1]
        counts.append(Curve(name=name, x=np.repeat(hz, 2), y=steps, color=colors[name], dash=dash))
        share = np.histogram(hz, edges)[0] / np.diff(edges)
        share = np.where(share > 0, share, np.nan)
        densities.append(
            Curve(name=name, x=np.repeat(edges, 2)[1:-1], y=np.repeat(share, 2), color=colors[name], dash=dash)
        )
    return Chart(
        title="Modes over frequency",
        panels=(
            Panel(y_label="modes below", curves=counts, y_log=False),
            Panel(y_label="modes per Hz, thirds of octaves", curves=densities),
        ),
        note=f"{unknown} frequencies that are NaN or infinite are left out" if unknown else "",
    )


def mac(one: Floats, two: Floats) -> Floats:
    """Modal assurance criterion (k1, k2) of shapes (k1, n, 3) and (k2, n, 3) (Allemang and Brown 1982).

    >>> mac(np.eye(3)[:, None], np.ones((1, 1, 3))).round(3).tolist()
    [[0.333], [0.333], [0.333]]
    """
    a, b = (shapes.reshape(len(shapes), -1) for shapes in (one, two))
    both = (a**2).sum(axis=1)[:, None] * (b**2).sum(axis=1)
    return np.asarray((a @ b.T) ** 2 / np.maximum(both, np.finfo(float).tiny))


def mac_chart(body: Charted, other: Charted | None, modes: int) -> Chart:
    """Modal assurance criterion of the first elastic ``modes`` of a body with those of another at the same nodes.

    Raises:
        InputError: bodies at other nodes, or without modes there, or something else than a body.
    """
    if other is not None and not hasattr(other, "modes"):
        raise InputError(
            f"other = {quote_value(other)} was given; expected a body, and a number of modes as modes=10",
            keyword="other",
        )
    second = body if other is None else other
    one, two = body.modes(modes), second.modes(modes)
    if not one.size or not two.size or one.shape[1] != two.shape[1]:
        raise InputError(
            f"{body.name!r} keeps {len(one)} modes at {one.shape[1]} nodes, {second.name!r} {len(two)} at "
            f"{two.shape[1]}; MAC needs modes of both at the same nodes",
            kind="conflict",
            keyword="nodes",
        )
    names = [
        [f"{hz:,.2f} Hz" for hz in each.frequencies_hz[each.rigid_count :][: len(shapes)]]
        for each, shapes in ((body, one), (second, two))
    ]
    return Chart(
        title="Modal assurance criterion",
        panels=(
            Matrix(
                row_label=body.name, column_label=second.name, rows=names[0], columns=names[1], values=mac(one, two)
            ),
        ),
    )


def campbell_chart(body: Charted, speeds: Sequence[float] | None, count: int) -> Chart:
    """The ``count`` lowest damped frequencies over the speed, in the frame that turns, by the direction of the whirl.

    Raises:
        InputError: a body without spin matrices, or a speed out of range.
    """
    if speeds is None and body.spin is not None:
        speeds = np.linspace(body.spin.speeds.min(), body.spin.speeds.max(), TOL.drawn_speeds).tolist()
    whirls = campbell(body, speeds or [0.0], count)
    found: dict[str, list[tuple[float, float]]] = {}
    for whirl in whirls:
        for s, word in zip(whirl.eigenvalues, whirl.whirl, strict=True):
            found.setdefault(word or "modes", []).append((whirl.speed, float(s.imag) / (2 * np.pi)))
    curves = []
    for number, (word, points) in enumerate(sorted(found.items())):
        x, y = np.array(points).T
        curves.append(Curve(name=word, x=x, y=y, color=number, dash="dots"))
    reached = [whirl.speed for whirl in whirls]
    ends = np.array([min(reached), max(reached)])
    curves.append(Curve(name="speed", x=ends, y=ends / (2 * np.pi), dash="dashed"))
    panel = Panel(
        x_label="speed in rad/s",
        y_label="frequency in the frame that turns, Hz",
        curves=curves,
        x_log=False,
        y_log=False,
    )
    return Chart(title=f"Campbell diagram of {body.name}", panels=(panel,))


def cost_chart(seconds: Mapping[str, float], peak_memory_bytes: Mapping[str, float]) -> Chart:
    """Time and peak memory of the process by stage, in the order given."""
    names = list(seconds)
    time = np.array([seconds[name] for name in names], dtype=float)
    memory = np.array([peak_memory_bytes.get(name, 0) for name in names], dtype=float) / 1e6
    return Chart(
        title="Time and memory by stage",
        panels=(
            Bars(label="seconds", names=names, values=time, texts=[f"{t:,.2f} s" for t in time]),
            Bars(
                label="peak memory of the process in MB",
                names=names,
                values=memory,
                texts=[f"{m:,.0f} MB" for m in memory],
            ),
        ),
    )
