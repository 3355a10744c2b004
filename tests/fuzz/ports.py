"""Interfaces at random, and their tables in a job."""

from __future__ import annotations

import numpy as np

from tests.fuzz.files import UNITS
from tests.fuzz.models import Floats, Ints, Model
from tests.fuzz.truth import Port

# Loads beyond which a body says little about a model this small.
MOST_INPUTS = 20


def draw_ports(rng: np.random.Generator, model: Model) -> tuple[Port, ...]:
    """One to three interfaces that share no nodes."""
    if model.inputs is not None:
        columns = model.inputs.shape[1]
        return tuple(
            Port(
                name=f"in{k + 1}",
                nodes=np.array([0]),
                coupling="matrix",
                point=np.zeros(3),
                components=(6,),
                vector=model.inputs[:, k],
            )
            for k in range(int(rng.integers(1, columns + 1)))
        )
    ports: list[Port] = []
    used: set[int] = set()
    wanted = int(rng.choice([1, 2, 3], p=[0.35, 0.5, 0.15]))
    for attempt in range(40):
        port = _one(rng, model, used, f"port{len(ports) + 1}", attempt)
        if port is None:
            continue
        inputs = sum(len(p.components) * (len(p.nodes) if p.coupling == "direct" else 1) for p in (*ports, port))
        frames = [p for p in (*ports, port) if p.coupling == "rigid" and len(p.nodes) > 1]
        left = sum(np.isin(model.node, p.nodes).sum() - 6 for p in frames)
        if inputs > MOST_INPUTS or len(model.K) - left - inputs - model.free < 3:
            continue
        ports.append(port)
        used |= set(port.nodes.tolist())
        if len(ports) == wanted:
            break
    return tuple(ports)


def _one(rng: np.random.Generator, model: Model, used: set[int], name: str, attempt: int) -> Port | None:
    count = np.bincount(model.node, minlength=len(model.xyz))
    full = 6 if model.family == "beams" else 3 if model.nodes else 1
    there = np.array([n for n in np.flatnonzero(count == full) if n not in used], dtype=np.int64)
    if not len(there):
        there = np.array([n for n in np.flatnonzero(count) if n not in used], dtype=np.int64)
        coupling = "direct"
    else:
        coupling = str(rng.choice(["rigid", "average", "direct"])) if model.nodes else "direct"
    if not len(there):
        return None
    if coupling == "direct" or attempt > 30:
        return _direct(rng, model, there, name)
    nodes = _patch(rng, model, there, coupling)
    if nodes is None:
        return None
    weights = model.weights(nodes)
    point = weights @ model.xyz[nodes] / weights.sum()
    if rng.random() < 0.3:
        point = np.round(point + rng.uniform(-0.2, 0.2, 3) * np.ptp(model.xyz, axis=0).max(), 5)
    components = tuple(range(6))
    if rng.random() < 0.2:
        components = tuple(sorted(rng.choice(6, int(rng.integers(1, 6)), replace=False).tolist()))
    return Port(name=name, nodes=nodes, coupling=coupling, point=point, components=components)


def _direct(rng: np.random.Generator, model: Model, there: Ints, name: str) -> Port:
    nodes = np.sort(rng.choice(there, min(int(rng.choice([1, 1, 2, 4])), len(there)), replace=False))
    common = set.intersection(*({int(c) for c in model.component[model.node == n]} for n in nodes))
    components = tuple(sorted(common))
    if not components:
        nodes = nodes[:1]
        components = tuple(sorted(model.component[model.node == nodes[0]].tolist()))
    if rng.random() < 0.3:
        components = tuple(
            sorted(rng.choice(components, int(rng.integers(1, len(components) + 1)), replace=False).tolist())
        )
    return Port(name=name, nodes=nodes, coupling="direct", point=model.xyz[nodes].mean(axis=0), components=components)


def _patch(rng: np.random.Generator, model: Model, there: Ints, coupling: str) -> Ints | None:
    """Nodes that a frame may hold or follow."""
    along = model.xyz[there, 0]
    if model.solid is not None and rng.random() < 0.75:
        end = along.min() if rng.random() < 0.5 else along.max()
        nodes = there[np.abs(along - end) < 1e-9]
    elif model.family == "beams" and coupling == "rigid":
        nodes = rng.choice(there, min(len(there), int(rng.integers(1, 3))), replace=False)
    else:
        nodes = rng.choice(there, min(len(there), int(rng.integers(4, 7))), replace=False)
    nodes = np.sort(nodes)
    turns = model.family == "beams" and coupling == "rigid"
    if not turns and (len(nodes) < 3 or _flatness(model, nodes) < 0.1):
        return None
    return nodes


def _flatness(model: Model, nodes: Ints) -> float:
    """How far nodes are from one line, those without weight left out."""
    w = model.weights(nodes)
    x = model.xyz[nodes[w > 0]]
    if len(x) < 3:
        return 0.0
    s = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    return float(s[1] / s[0])


def port_tables(ports: tuple[Port, ...], model: Model, units: str) -> str:
    """``[[interface]]`` of a job."""
    length, tables = UNITS[units][0], []
    for k, port in enumerate(ports):
        lines = [f'[[interface]]\nname = "{port.name}"']
        if port.vector is not None:
            lines.append(f'matrix = "B:{k + 1}"')
        else:
            labels = ",".join(str(n + 1) for n in port.nodes)
            lines += [f'nodes = "ids:{labels}"', f'coupling = "{port.coupling}"']
            lines.append(f"components = {list(port.components)}")
            if port.coupling != "direct" and not np.allclose(port.point, _centroid(model, port), atol=1e-12):
                lines.append(f"point = {[float(x * length) for x in port.point]}")
        tables.append("\n".join(lines))
    return "\n".join(tables)


def _centroid(model: Model, port: Port) -> Floats:
    weights = model.weights(port.nodes)
    return np.asarray(weights @ model.xyz[port.nodes] / weights.sum())
