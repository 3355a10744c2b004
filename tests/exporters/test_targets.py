"""The connecting rod through every target in one loop, and back by a client of each, as the documents have them.

A client gives the frequencies of the free rod as it has them, or, where it runs, how far its motion is off.
"""

import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.linalg as sl

from morembs import (
    assemble,
    elastic_body,
    isotropic,
    make_interface,
    make_part,
    read_body,
    read_mesh,
    select_nodes,
    state_space,
    write_body,
)
from morembs.exporters import EXPORTERS, export_body
from morembs.exporters.sid import read_sid
from morembs.importers.matrices.abaqus import align, read_abaqus_matrix
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton
from tests.support.exports import extptfm_file, mbdyn_groups, simulated_modelica

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def rod(tmp_path_factory):
    """Files that every target makes of the rod, and its body."""
    folder = tmp_path_factory.mktemp("rod")
    model = assemble(
        read_mesh(ROOT / "data" / "small_meshes" / "conrod.msh", "mm-t-s"),
        [isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)],
    )
    ends = [
        make_interface(model, name=name, nodes=select_nodes(model, f"set:{name}")) for name in ("BIGEND", "SMALLEND")
    ]
    with Problem(model, ends, damping=Damping(beta=2e-7)) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "rod")
        source = write_body(folder / "rod.h5", [elastic_body(problem, reduced, make_part(problem, nodes="skin"))])
    done = {to: export_body(source, to) for to in EXPORTERS}
    return read_body(source), {to: written.paths for to, written in done.items()}


def frequencies(K, M):
    return np.sqrt(np.maximum(sl.eigvalsh(K, M), 0.0)) / (2 * np.pi)


def exudyn(source, paths):
    fem = pytest.importorskip("exudyn.FEM", reason="Exudyn is not installed: pip install exudyn")
    cms = fem.ObjectFFRFreducedOrderInterface()
    cms.LoadFromFile(str(paths[0]))
    return frequencies(np.asarray(cms.stiffnessMatrixReduced), np.asarray(cms.massMatrixReduced))


def sid(source, paths):
    file = read_sid(paths[0])
    return frequencies(file.Ke.M0, file.Me.M0)


def simscape(source, paths):
    values = scipy.io.loadmat(paths[0])
    return frequencies(values["K"], values["M"])


def mbdyn(source, paths):
    records = mbdyn_groups(paths[0])
    n = int(records[1][2])
    return frequencies(*(np.array(records[k], dtype=float).reshape(n, n) for k in (10, 9)))


def op4(source, paths):
    reader = pytest.importorskip("pyyeti.nastran.op4", reason="pyYeti is not installed: pip install pyyeti")
    file = reader.load(str(paths[0]))
    return frequencies(file["k"][0], file["m"][0])


def dmig(source, paths):
    nastran = pytest.importorskip("pyyeti.nastran", reason="pyYeti is not installed: pip install pyyeti")
    file = nastran.rddmig(str(paths[0]))
    return frequencies(file["kaax"].to_numpy(), file["maax"].to_numpy())


def abaqus(source, paths):
    matrices, *_ = align(*(read_abaqus_matrix(path) for path in paths[1:3]))
    M, K = (A.toarray() for A in matrices)
    return frequencies(K, M)


def matrix_market(source, paths):
    M, K = (np.asarray(scipy.io.mmread(path)) for path in paths[:2])
    return frequencies(K, M)


def statespace(source, paths):
    control = pytest.importorskip("control", reason="python-control is not installed: pip install control")
    with np.load(paths[0]) as file:
        system = control.ss(*(file[key] for key in "ABCD"))
    poles = system.poles()
    return np.sort(np.abs(poles[poles.imag >= 0])) / (2 * np.pi)


def extptfm(source, paths):
    _, matrices = extptfm_file(paths[0])
    return frequencies(matrices["stiffness matrix"], matrices["mass matrix"])


def modelica(source, paths):
    """Motion of the small end 0.2 ms after it is pushed."""
    text = paths[0].read_text()
    text += "model T rod.Linear b(SMALLEND_force = {0, 1, 1, 0, 0, 0}, BIGEND_force = zeros(6)); end T;\n"
    motion = simulated_modelica(text, "T", 2e-4, [f"b.SMALLEND_motion[{axis}]" for axis in range(1, 7)])
    system = state_space(source, ["SMALLEND:force:y+z"], ["SMALLEND:displacement"]).discrete(2e-4)
    wanted = system.C @ system.B @ [1.0, 1.0]
    return float(np.abs(motion - wanted).max() / np.abs(wanted).max())


def mujoco(source, paths):
    """Motion of the small end while it is pushed for 50 us, against the exact one of small motion."""
    engine = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")
    model = engine.MjModel.from_xml_path(str(paths[0]))
    data = engine.MjData(model)
    model.opt.gravity[:] = 0
    end, tip, step = 5e-5, model.body("rod:SMALLEND").id, model.opt.timestep
    engine.mj_kinematics(model, data)
    start = data.xpos[tip].copy()
    data.xfrc_applied[tip, :3] = [0.0, 100.0, 100.0]
    for _ in range(round(end / step)):
        engine.mj_step(model, data)
    engine.mj_kinematics(model, data)
    system = state_space(source, ["SMALLEND:force:y+z"], ["SMALLEND:displacement:x+y+z"])
    system = system.discrete(data.time + 0.5 * step)
    wanted = system.C @ system.B @ [100.0, 100.0]
    return float(np.abs(data.xpos[tip] - start - wanted).max() / np.abs(wanted).max())


def gltf(source, paths):
    """Its own tests have what the validator and VTK say."""
    content = paths[0].read_bytes()
    (size,) = struct.unpack_from("<I", content, 12)
    modes = np.array(json.loads(content[20 : 20 + size])["extras"]["frequencies_hz"])
    # A file has no more modes than the body, and here all of them.
    assert len(modes) == 10
    return modes


CLIENTS = {
    "gltf": gltf,
    "exudyn": exudyn,
    "sid": sid,
    "simscape": simscape,
    "mbdyn": mbdyn,
    "op4": op4,
    "dmig": dmig,
    "abaqus": abaqus,
    "matrix-market": matrix_market,
    "statespace": statespace,
    "modelica": modelica,
    "extptfm": extptfm,
    "mujoco": mujoco,
}


def table():
    """Rows of the table in docs/howto/simulators.md: target -> its cells by column."""
    text = (ROOT / "docs" / "howto" / "simulators.md").read_text()
    (head, _, *rows) = re.search(r"(\| target \|.*?)\n\n", text, re.DOTALL).group(1).splitlines()
    columns = [cell.strip() for cell in head.strip("|").split("|")]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    return {row[0].strip("`"): dict(zip(columns, row, strict=True)) for row in cells}


@pytest.mark.parametrize("to", EXPORTERS)
def test_the_client_of_each_target_has_the_rod(rod, to):
    source, files = rod
    assert files[to] and all(path.stat().st_size > 100 for path in files[to])
    if to not in CLIENTS:
        pytest.skip(f"no client of {to} is here; its own tests say what was checked")
    difference = CLIENTS[to](source, files[to])
    if not isinstance(difference, float):
        body = source.bodies["rod"]
        wanted = body.frequencies_hz[6:]
        difference = float(np.abs(difference[-len(wanted) :] / wanted - 1).max())
    shown = float(table()[to]["difference"])
    assert difference < shown, difference


def test_the_table_says_what_every_target_holds():
    rows = table()
    assert set(EXPORTERS) <= set(rows)
    for to in EXPORTERS:
        for part in ("damping", "stiffening"):
            assert (rows[to][part] == "yes") == (part in EXPORTERS[to].holds), (to, part)
        assert (rows[to]["forces"] == "yes") == ("forces" in EXPORTERS[to].holds), to
