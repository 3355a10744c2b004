"""Fixed cases of models that were refused though right, or not solved."""

from __future__ import annotations

import numpy as np

from tests.fuzz.models import Model, beam
from tests.fuzz.stage import (
    END,
    MESH,
    MODAL,
    MODEL,
    OUTPUT,
    abstract,
    bar,
    case,
    expect,
    gives,
    judged,
    write_job,
    write_mesh,
    write_model,
)
from tests.fuzz.trials import Folder, reason
from tests.fuzz.truth import Damping, Port, Truth


@case
def band_from_above_zero_with_a_mode_below(place: Folder) -> None:
    n = 12
    K = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    write_model(place, K, np.eye(n))
    truth = abstract(K, np.eye(n), (n - 1,))
    f = truth.hz
    certify = f"[certify]\nband_hz = [{(f[1] + f[2]) / 2:.6g}, {(f[3] + f[4]) / 2:.6g}]\n"
    auto = certify.replace("[certify]", '[[reduce]]\nmethod = "auto"\ntolerance = 1e-3')
    write_job(place, MODEL, END.format(labels=n) + 'coupling = "direct"\n', auto, certify, OUTPUT)
    if gives(place, "reduce", "job.toml"):
        judged(place, truth, auto="auto")


@case
def modal_coordinates(place: Folder) -> None:
    K = np.diag((2 * np.pi * np.linspace(1.0, 60.0, 30)) ** 2)
    write_model(place, K, np.eye(30))
    truth = abstract(K, np.eye(30), (4, 9))
    write_job(
        place,
        MODEL,
        END.format(labels="5,10") + 'coupling = "direct"\n',
        MODAL,
        "[certify]\nband_hz = [0.0, 25.1]\n",
        OUTPUT,
    )
    if gives(place, "reduce", "job.toml"):
        judged(place, truth, modal="modal")


def cantilever(place: Folder, n: int, held: tuple[int, ...]) -> None:
    xyz = np.column_stack([np.arange(n) * 0.2, np.zeros(n), np.zeros(n)])
    K = np.zeros((6 * n, 6 * n))
    for a in range(n - 1):
        at = np.arange(6 * a, 6 * a + 12)
        K[np.ix_(at, at)] += beam(xyz[a], xyz[a + 1], 1e7, 2e3, 3e3, 1e3)
    keep = np.flatnonzero(~np.isin(np.repeat(np.arange(n), 6), held))
    M = np.diag(np.tile([1, 1, 1, 0.02, 0.03, 0.04], n))[np.ix_(keep, keep)]
    node, component = np.repeat(np.arange(n), 6)[keep], np.tile(np.arange(6), n)[keep]
    K = K[np.ix_(keep, keep)]
    write_model(place, K, M, nodes=xyz, node=node, component=component)
    tip = int(node[-1])
    write_job(
        place,
        MODEL,
        END.format(labels=tip + 1) + 'coupling = "direct"\n',
        MODAL,
        "[certify]\nband_hz = [0.0, 40.0]\n",
        OUTPUT,
    )
    model = Model(family="beams", support="clamped", K=K, M=M, xyz=xyz, node=node, component=component, free=0)
    port = Port(name="end", nodes=np.array([tip]), coupling="direct", point=xyz[tip], components=tuple(range(6)))
    if gives(place, "reduce", "job.toml"):
        judged(place, Truth(model, (port,), Damping()), modal="modal")


@case
def straight_clamped_cantilever(place: Folder) -> None:
    cantilever(place, 8, (0,))


@case
def short_beam_clamped_at_both_ends(place: Folder) -> None:
    cantilever(place, 4, (0, 3))


@case
def hinge_between_two_free_bodies(place: Folder) -> None:
    solid = bar()
    end = write_mesh(place, "part.vtk", solid)
    near = np.flatnonzero(solid.xyz[:, 0] <= 1e-9) + 1
    other = END.format(labels=",".join(map(str, near))).replace('"end"', '"root"')
    part = '[[reduce]]\nmethod = "craig-bampton"\nmodes = 4\n[output]\npath = "part.h5"\n'
    write_job(place, MESH.format(name="part.vtk"), end, other, part, name="part.toml")
    if not gives(place, "reduce", "part.toml"):
        return
    parts = [
        '[[substructure]]\nname = "a"\nbody = "part.h5"\n',
        '[[substructure]]\nname = "b"\nbody = "part.h5"\nposition = [0.3, 0.0, 0.0]\n',
    ]
    couple = '[[couple]]\nbetween = ["a:end", "b:root"]\ncomponents = [0, 1, 2, 3, 5]\n'
    base = '[[interface]]\nname = "base"\nnodes = "set:a:root"\n'
    write_job(place, *parts, couple, base, MODAL, OUTPUT)
    ended = place.run(["reduce", "job.toml"])
    if ended.code == 2:
        expect(
            place,
            "hinge" in ended.errors or "component" in ended.errors,
            f"the refusal does not say what is held where: {reason(ended.errors)}",
        )


@case
def inertia_modes_beyond_a_small_model(place: Folder) -> None:
    n = 8
    K = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    write_model(place, K, np.eye(n))
    interface = END.format(labels="1,2,3,4,5") + 'coupling = "direct"\n'
    table = '[[reduce]]\nmethod = "craig-bampton"\nmodes = 5\ninertia_modes = true\n'
    write_job(place, MODEL, interface, table, OUTPUT)
    place.run(["reduce", "job.toml"])


@case
def undamped_mode_beside_dampers(place: Folder) -> None:
    # A damper in the middle, where modes that are antisymmetric do not move.
    n = 11
    K = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    write_model(place, K, np.eye(n), D=np.diag(5.0 * (np.arange(n) == n // 2)))
    write_job(
        place,
        MODEL,
        END.format(labels="2,5") + 'coupling = "direct"\n',
        MODAL,
        "[certify]\nband_hz = [0.0, 60.0]\n",
        OUTPUT,
    )
    place.run(["reduce", "job.toml"])
