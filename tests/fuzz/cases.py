"""Named jobs of defects that were found, which run before all others.

Each fills a folder, runs command lines, and says what must hold; the folder itself sees to inputs, warnings and
tracebacks, as it does for random jobs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import meshio
import numpy as np

from tests.fuzz.judge import judge
from tests.fuzz.models import Model, _beam
from tests.fuzz.solids import Solid, block
from tests.fuzz.trials import FAULTS, Folder, Outcome, reason
from tests.fuzz.truth import Damping, Port, Truth

CASES: dict[str, Callable[[Folder], None]] = {}
MODEL = '[model]\nfile = "part.model.h5"\n'
MESH = '[model]\nmesh = "{name}"\n[[material]]\nyoung = 2.1e11\npoisson = 0.3\ndensity = 7850.0\n'
END = '[[interface]]\nname = "end"\nnodes = "ids:{labels}"\n'
MODAL = '[[reduce]]\nmethod = "modal"\nmodes = 3\n'
OUTPUT = '[output]\npath = "body.h5"\n'


def case(function: Callable[[Folder], None]) -> Callable[[Folder], None]:
    """List a case by its name."""
    CASES[function.__name__.replace("_", "-")] = function
    return function


def run(name: str, folder: Path, *, keep: bool = False) -> Outcome:
    """The outcome of one case."""
    outcome = Outcome(name, features={"case": name}, command=f'make attack ARGS="jobs --case {name}"')
    place = Folder(folder / name, outcome)
    CASES[name](place)
    place.check()
    if outcome.result not in FAULTS and not keep:
        place.close()
    return outcome


def bar(
    scale: float = 1.0, cells: tuple[int, int, int] = (3, 1, 1), size: tuple[float, ...] = (0.3, 0.02, 0.03)
) -> Solid:
    """A steel bar of hexahedra."""
    xyz, elements = block("hex8", cells, np.array(size) * scale)
    return Solid(kind="hex8", xyz=xyz, cells=elements, young=2.1e11, poisson=0.3, density=7850.0)


def _write(place: Folder, name: str, solid: Solid) -> str:
    """A mesh file, and the table of an interface at its far end."""
    meshio.write(place.place / name, meshio.Mesh(solid.xyz, [("hexahedron", solid.cells)]))
    return _end(solid)


def _end(solid: Solid) -> str:
    rows = np.flatnonzero(solid.xyz[:, 0] >= solid.xyz[:, 0].max() - 1e-9) + 1
    return END.format(labels=",".join(map(str, rows)))


def _job(place: Folder, *tables: str, name: str = "job.toml") -> None:
    (place.place / name).write_text("\n".join(tables))
    place.seal()


def _gives(place: Folder, *arguments: str) -> bool:
    """Whether a command that must do its work did it."""
    ended = place.run(arguments)
    if ended.code == 2:
        place.outcome.fail("wrong", f"morembs {' '.join(arguments)}: refused though right: {reason(ended.errors)}")
    return ended.code == 0


def _refused(place: Folder, *arguments: str) -> None:
    """A command that must be refused."""
    if place.run(arguments).code == 0:
        place.outcome.fail("wrong", f"morembs {' '.join(arguments)}: taken though it must be refused")


def _expect(place: Folder, holds: bool, words: str) -> None:
    if not holds:
        place.outcome.fail("wrong", words)


def write_model(place: Folder, K: np.ndarray, M: np.ndarray, **more: object) -> None:
    """The model file of matrices."""
    from morembs import from_matrices
    from morembs.importers import model_file

    model_file.write_model(place.place / "part.model.h5", from_matrices(K, M, name="part", **more))


def _mass(place: Folder, name: str = "body.h5") -> float:
    with h5py.File(place.place / name) as file:
        return float(file["mass_properties/mass"][()])


@case
def link_retargeted_between_batches(place: Folder) -> None:
    end = _write(place, "one.vtk", bar())
    _write(place, "two.vtk", bar(2.0))
    link = place.place / "part.vtk"
    link.symlink_to("one.vtk")
    _job(place, MESH.format(name="part.vtk"), end, MODAL, OUTPUT)
    if not _gives(place, "batch", "job.toml", "--jobs", "1", "--quiet"):
        return
    before = _mass(place)
    link.unlink()
    link.symlink_to("two.vtk")
    del place.sums["part.vtk"]
    if _gives(place, "batch", "job.toml", "--jobs", "1", "--quiet"):
        _expect(
            place, abs(_mass(place) / before - 8) < 1e-6, "the body is that of the mesh that the link led to before"
        )


@case
def companion_of_a_mesh_as_output(place: Folder) -> None:
    end = _write(place, "part.xdmf", bar())
    _job(place, MESH.format(name="part.xdmf"), end, MODAL, '[output]\npath = "part.h5"\n')
    _refused(place, "reduce", "job.toml")


@case
def job_that_init_proposes_for_a_mesh_with_a_companion(place: Folder) -> None:
    end = _write(place, "part.xdmf", bar())
    place.seal()
    if _gives(place, "init", "part.xdmf", "-o", "job.toml"):
        proposed = (place.place / "job.toml").read_text()
        (place.place / "job.toml").write_text(proposed.replace("[[reduce]]", end + "[[reduce]]", 1))
        place.run(["reduce", "job.toml"])


@case
def import_onto_the_companion_of_its_mesh(place: Folder) -> None:
    _write(place, "part.xdmf", bar())
    place.seal()
    _refused(place, "import", "part.xdmf", "--material", "young=2e11,poisson=0.3,density=7850", "-o", "part.h5")


@case
def include_of_a_deck_as_output(place: Folder) -> None:
    solid = bar()
    rows = [f"{k}, " + ", ".join(repr(float(c)) for c in x) for k, x in enumerate(solid.xyz, 1)]
    (place.place / "nodes.h5").write_text("*NODE\n" + "\n".join(rows) + "\n")
    cells = [f"{k}, " + ", ".join(str(n + 1) for n in cell) for k, cell in enumerate(solid.cells, 1)]
    text = ["*INCLUDE, INPUT=nodes.h5", "*ELEMENT, TYPE=C3D8, ELSET=ALL", *cells]
    (place.place / "part.inp").write_text("\n".join(text) + "\n")
    mesh = MESH.format(name="part.inp").replace("[[material]]", 'dialect = "calculix"\n[[material]]')
    _job(place, mesh, _end(solid), MODAL, '[output]\npath = "nodes.h5"\n')
    _refused(place, "reduce", "job.toml")


def _judged(place: Folder, truth: Truth, **kinds: str) -> None:
    verdict = judge(
        place.place / "body.h5", truth, np.random.default_rng(1), exact=set(), tolerances={}, promised=kinds
    )
    place.outcome.proven, place.outcome.points = verdict.proven, verdict.points
    for sentence in verdict.wrong:
        place.outcome.fail("wrong", sentence)


def abstract(K: np.ndarray, M: np.ndarray, rows: tuple[int, ...]) -> Truth:
    """Coordinates without places, and the truth of direct interfaces at some."""
    model = Model(family="chain", support="clamped", K=K, M=M, xyz=np.zeros((len(K), 3)), node=np.arange(len(K)),
                  component=np.zeros(len(K), int), free=0, nodes=False)  # fmt: skip
    port = Port(name="end", nodes=np.array(rows), coupling="direct", point=np.zeros(3), components=(0,))
    return Truth(model, (port,), Damping())


@case
def band_from_above_zero_with_a_mode_below(place: Folder) -> None:
    n = 12
    K = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    write_model(place, K, np.eye(n))
    truth = abstract(K, np.eye(n), (n - 1,))
    f = truth.hz
    certify = f"[certify]\nband_hz = [{(f[1] + f[2]) / 2:.6g}, {(f[3] + f[4]) / 2:.6g}]\n"
    auto = certify.replace("[certify]", '[[reduce]]\nmethod = "auto"\ntolerance = 1e-3')
    _job(
        place,
        MODEL,
        END.format(labels=n) + 'coupling = "direct"\n',
        auto,
        certify,
        OUTPUT,
    )
    if _gives(place, "reduce", "job.toml"):
        _judged(place, truth, auto="auto")


@case
def modal_coordinates(place: Folder) -> None:
    K = np.diag((2 * np.pi * np.linspace(1.0, 60.0, 30)) ** 2)
    write_model(place, K, np.eye(30))
    truth = abstract(K, np.eye(30), (4, 9))
    _job(place, MODEL, END.format(labels="5,10") + 'coupling = "direct"\n', MODAL,
         "[certify]\nband_hz = [0.0, 25.1]\n", OUTPUT)  # fmt: skip
    if _gives(place, "reduce", "job.toml"):
        _judged(place, truth, modal="modal")


def _cantilever(place: Folder, n: int, held: tuple[int, ...]) -> None:
    xyz = np.column_stack([np.arange(n) * 0.2, np.zeros(n), np.zeros(n)])
    K = np.zeros((6 * n, 6 * n))
    for a in range(n - 1):
        at = np.arange(6 * a, 6 * a + 12)
        K[np.ix_(at, at)] += _beam(xyz[a], xyz[a + 1], 1e7, 2e3, 3e3, 1e3)
    keep = np.flatnonzero(~np.isin(np.repeat(np.arange(n), 6), held))
    M = np.diag(np.tile([1, 1, 1, 0.02, 0.03, 0.04], n))[np.ix_(keep, keep)]
    node, component = np.repeat(np.arange(n), 6)[keep], np.tile(np.arange(6), n)[keep]
    K = K[np.ix_(keep, keep)]
    write_model(place, K, M, nodes=xyz, node=node, component=component)
    tip = int(node[-1])
    _job(place, MODEL, END.format(labels=tip + 1) + 'coupling = "direct"\n',
         MODAL, "[certify]\nband_hz = [0.0, 40.0]\n", OUTPUT)  # fmt: skip
    model = Model(family="beams", support="clamped", K=K, M=M, xyz=xyz, node=node, component=component, free=0)
    port = Port(name="end", nodes=np.array([tip]), coupling="direct", point=xyz[tip], components=tuple(range(6)))
    if _gives(place, "reduce", "job.toml"):
        _judged(place, Truth(model, (port,), Damping()), modal="modal")


@case
def straight_clamped_cantilever(place: Folder) -> None:
    _cantilever(place, 8, (0,))


@case
def short_beam_clamped_at_both_ends(place: Folder) -> None:
    _cantilever(place, 4, (0, 3))


@case
def parameter_beta_from_zero(place: Folder) -> None:
    solid = bar()
    end = (
        _write(place, "part.vtk", solid) + END.format(labels="1").replace('"end"', '"corner"') + 'coupling = "direct"\n'
    )
    table = '[[parameter]]\nname = "b"\nproperty = "beta"\nnominal = 2e-7\nrange = [0.0, 3e-7]\n'
    method = '[[reduce]]\nmethod = "parametric"\nband_hz = [0.0, 9000.0]\ntolerance = 1e-4\ntraining = 8\n'
    _job(place, MESH.format(name="part.vtk"), end, table, method, OUTPUT)
    _gives(place, "reduce", "job.toml")


@case
def spring_beside_a_morph(place: Folder) -> None:
    solid = bar()
    end = _write(place, "part.vtk", solid)
    rows = [f"{k},{0.1 * x[0]!r},0,0" for k, x in enumerate(solid.xyz.tolist(), 1)]
    (place.place / "longer.csv").write_text("id,dx,dy,dz\n" + "\n".join(rows) + "\n")
    tables = '[[parameter]]\nname = "t"\nproperty = "morph"\ndisplacement = "longer.csv"\nrange = [-1.0, 1.0]\n'
    tables += ('[[parameter]]\nname = "k"\nproperty = "spring"\ninterface = "end"\nrange = [0.5, 2.0]\n'
               "stiffness = [1e6, 1e6, 1e6, 1e3, 1e3, 1e3]\n")  # fmt: skip
    method = '[[reduce]]\nmethod = "parametric"\nband_hz = [0.0, 2000.0]\ntolerance = 1e-2\ntraining = 8\n'
    _job(place, MESH.format(name="part.vtk"), end, tables, method, OUTPUT)
    _gives(place, "reduce", "job.toml")


@case
def hinge_between_two_free_bodies(place: Folder) -> None:
    solid = bar()
    end = _write(place, "part.vtk", solid)
    near = np.flatnonzero(solid.xyz[:, 0] <= 1e-9) + 1
    other = END.format(labels=",".join(map(str, near))).replace('"end"', '"root"')
    part = '[[reduce]]\nmethod = "craig-bampton"\nmodes = 4\n[output]\npath = "part.h5"\n'
    _job(place, MESH.format(name="part.vtk"), end, other, part, name="part.toml")
    if not _gives(place, "reduce", "part.toml"):
        return
    parts = ['[[substructure]]\nname = "a"\nbody = "part.h5"\n',
             '[[substructure]]\nname = "b"\nbody = "part.h5"\nposition = [0.3, 0.0, 0.0]\n']  # fmt: skip
    couple = '[[couple]]\nbetween = ["a:end", "b:root"]\ncomponents = [0, 1, 2, 3, 5]\n'
    base = '[[interface]]\nname = "base"\nnodes = "set:a:root"\n'
    _job(place, *parts, couple, base, MODAL, OUTPUT)
    ended = place.run(["reduce", "job.toml"])
    if ended.code == 2:
        _expect(place, "hinge" in ended.errors or "component" in ended.errors,
                f"the refusal does not say what is held where: {reason(ended.errors)}")  # fmt: skip


@case
def many_modes_of_a_free_block(place: Folder) -> None:
    end = _write(place, "part.vtk", bar(cells=(7, 7, 7), size=(0.1, 0.11, 0.123)))
    modes = '[[reduce]]\nmethod = "modal"\nmodes = 300\n'
    _job(place, MESH.format(name="part.vtk"), end, modes, OUTPUT, "[check]\nfull_modes = 0\n")
    _gives(place, "reduce", "job.toml")


@case
def nul_in_the_output_path(place: Folder) -> None:
    end = _write(place, "part.vtk", bar())
    _job(place, MESH.format(name="part.vtk"), end, MODAL, '[output]\npath = "a\\u0000b.h5"\n')
    _refused(place, "reduce", "job.toml")


@case
def immense_wrench(place: Folder) -> None:
    end = _write(place, "part.vtk", bar())
    _job(
        place,
        MESH.format(name="part.vtk"),
        end,
        MODAL,
        OUTPUT,
        "[preload]\nwrench = { end = [1e300, 0, 0, 0, 0, 0] }\n",
    )
    _refused(place, "reduce", "job.toml")


@case
def immense_acceleration(place: Folder) -> None:
    end = _write(place, "part.vtk", bar())
    table = '[preload]\nacceleration = [0, 0, 1e308]\nheld = ["end"]\n'
    _job(place, MESH.format(name="part.vtk"), end, MODAL, OUTPUT, table)
    _refused(place, "reduce", "job.toml")


@case
def inertia_modes_beyond_a_small_model(place: Folder) -> None:
    n = 8
    K = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    write_model(place, K, np.eye(n))
    interface = END.format(labels="1,2,3,4,5") + 'coupling = "direct"\n'
    table = '[[reduce]]\nmethod = "craig-bampton"\nmodes = 5\ninertia_modes = true\n'
    _job(place, MODEL, interface, table, OUTPUT)
    place.run(["reduce", "job.toml"])


@case
def undamped_mode_beside_dampers(place: Folder) -> None:
    # A damper in the middle, where modes that are antisymmetric do not move.
    n = 11
    K = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    write_model(place, K, np.eye(n), D=np.diag(5.0 * (np.arange(n) == n // 2)))
    _job(place, MODEL, END.format(labels="2,5") + 'coupling = "direct"\n', MODAL,
         "[certify]\nband_hz = [0.0, 60.0]\n", OUTPUT)  # fmt: skip
    place.run(["reduce", "job.toml"])


@case
def matrix_twice_in_one_archive(place: Folder) -> None:
    import io
    import warnings
    import zipfile

    def array(A: np.ndarray) -> bytes:
        buffer = io.BytesIO()
        np.save(buffer, A)
        return buffer.getvalue()

    with warnings.catch_warnings(), zipfile.ZipFile(place.place / "part.npz", "w") as file:
        warnings.simplefilter("ignore")
        for name, A in (("K", np.eye(3)), ("M", np.eye(3)), ("K", 4 * np.eye(3))):
            file.writestr(f"{name}.npy", array(A))
    place.seal()
    _refused(place, "import", "part.npz", "-o", "part.model.h5")


@case
def stiffness_of_a_body_times_four(place: Folder) -> None:
    end = _write(place, "part.vtk", bar())
    _job(place, MESH.format(name="part.vtk"), end, MODAL, OUTPUT)
    if not _gives(place, "reduce", "job.toml"):
        return
    with h5py.File(place.place / "body.h5", "r+") as file:
        del file["checksums"]
        file["bodies/modal/stiffness_matrix"][...] *= 4
    for target in ("statespace", "matrix-market", "c", "sid"):
        _refused(place, "export", "body.h5", "--to", target)
