"""Small valid files of every format that is read, with the command that reads them: what is damaged."""

from __future__ import annotations

import gzip
import io
import itertools
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import scipy.io
import scipy.sparse as sp

from benchmarks.attack import forked, scenarios
from benchmarks.attack.forked import program
from benchmarks.attack.scenarios import ROOT

sys.path.insert(0, str(ROOT))

from morembs.exporters.abaqus_matrices import write_abaqus_matrix
from morembs.exporters.dmig import write_dmig
from morembs.exporters.op4 import write_op4
from morembs.fem import FEModel
from morembs.importers.matrices.dmig import DmigMatrix
from morembs.importers.matrices.from_matrices import from_matrices
from morembs.importers.model_file import write_model
from tests.importers import test_abaqus_deck as abaqus_decks
from tests.importers import test_ansys as ansys_files
from tests.importers import test_nastran_deck as nastran_decks
from tests.importers import test_unv as universal_files
from tests.support import decks, mesh_decks
from tests.support.meshes import box, steel

STEEL = "young=2.1e11,poisson=0.3,density=7850"
SHARED = ROOT.parent / "shared" / "data"
Files = Mapping[str, bytes]


@dataclass(frozen=True)
class Seed:
    """Files, those of them that are damaged, what reads them, and what it writes (None: it only prints)."""

    files: Files
    targets: tuple[str, ...]
    work: Callable[[], object]
    output: str | None


def _imported(files: Files, *arguments: str, targets: tuple[str, ...] | None = None) -> Seed:
    """``morembs import`` of files; the first argument is the main file, or an option."""
    work = program(["import", *arguments, "-o", "out.model.h5", "--check", "--json"])
    return Seed(files, targets or tuple(files), work, "out.model.h5")


class _Workshop:
    """Writes files to a folder and takes them back as bytes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.model: FEModel = steel(box("hex8", (2, 1, 1), (0.2, 0.1, 0.08)))
        self.names = {"K": self.model.K, "M": self.model.M}

    def written(self, name: str, write: Callable[[Path], object]) -> bytes:
        path = self.folder / name
        write(path)
        return path.read_bytes()

    def decks(self) -> dict[str, list[Seed]]:
        hexes, tets = box("hex8", (2, 1, 1), (0.2, 0.1, 0.08)), box("tet10", (1, 1, 1), (0.2, 0.1, 0.08))
        section = abaqus_decks.STEEL_LINES + "*SOLID SECTION, ELSET=Body, MATERIAL=Steel\n,\n"
        nodes, elements = mesh_decks.abaqus_mesh(hexes).split("*ELEMENT")
        main = "*INCLUDE, INPUT=nodes.inc\n*ELEMENT" + elements + section
        grids = "BEGIN BULK\n" + nastran_decks.MAT1
        abaqus = [abaqus_decks.FULL, mesh_decks.abaqus_mesh(hexes) + section, mesh_decks.abaqus_mesh(tets) + section]
        # Its bar of a rigid element makes a node follow two elements, which models refuse.
        nastran = [nastran_decks.FULL.replace("RBAR,3,500,600,123456,,,\n", "")]
        for form in ("small", "large", "free"):
            nastran.append(grids + mesh_decks.nastran_mesh(hexes, form) + "ENDDATA\n")
        nastran += [nastran_decks.WEIGHTED + ",UM,600,123,10,1,20,23\n", nastran_decks.TIED]
        archives = [
            mesh_decks.ansys_archive(hexes, form=form, plain=plain)
            for form, plain in (("(3i9,6e21.13e3)", False), ("(3i8,6e20.13)", True))
        ]
        universal = [universal_files.universal(mesh, old=old) for mesh, old in ((hexes, False), (tets, True))]
        seeds = {
            "unv": [_imported({"part.unv": text.encode()}, "part.unv", "--material", STEEL) for text in universal],
            "abaqus": [_imported({"part.inp": text.encode()}, "part.inp") for text in abaqus],
            "nastran": [_imported({"part.bdf": text.encode()}, "part.bdf") for text in nastran],
            "ansys": [_imported({"part.cdb": text.encode()}, "part.cdb", "--material", STEEL) for text in archives],
        }
        seeds["ansys"] += [
            _imported({"part.cdb": text.encode()}, "part.cdb") for text in (ansys_files.BEAMS, ansys_files.SPRINGS)
        ]
        seeds["abaqus"].append(_imported({"part.inp": main.encode(), "nodes.inc": nodes.encode()}, "part.inp"))
        others = ("nastran", "finetools/twoblocks.nas", "--material", STEEL), ("ansys", "mapdl_reader/HexBeam.cdb")
        for name, where, *more in others:
            if (SHARED / where).is_file():
                ending = Path(where).suffix
                data = {f"other{ending}": (SHARED / where).read_bytes()}
                seeds[name].append(_imported(data, f"other{ending}", *more))
        return seeds

    def meshes(self) -> dict[str, list[Seed]]:
        mesh = self.model.mesh
        assert mesh is not None  # noqa: S101
        plain = meshio.Mesh(mesh.nodes.xyz, [("hexahedron", mesh.blocks[0].nodes)])
        seeds: dict[str, list[Seed]] = {}
        formats: list[tuple[str, str, dict[str, Any]]] = [
            ("msh", "gmsh", {"binary": False}),
            ("msh", "gmsh22", {"binary": False}),
            ("msh", "gmsh", {"binary": True}),
            ("vtk", "vtk", {"binary": False}),
            ("vtu", "vtu", {}),
            ("mesh", "medit", {}),
        ]
        for ending, form, options in formats:
            name = f"part.{ending}"
            data = self.written(name, lambda path, f=form, o=options: meshio.write(path, plain, f, **o))
            seeds.setdefault(ending, []).append(_imported({name: data}, name, "--material", STEEL))
        # MED turns its bricks the other way round.
        turned = meshio.Mesh(mesh.nodes.xyz, [("hexahedron", mesh.blocks[0].nodes[:, [0, 3, 2, 1, 4, 7, 6, 5]])])
        data = self.written("part.med", lambda path: meshio.write(path, turned))
        seeds["med"] = [_imported({name: data}, name, "--material", STEEL) for name in ("part.med", "part.rmed")]
        for small in ("wedge.msh", "block.msh"):
            data = (ROOT / "data" / "small_meshes" / small).read_bytes()
            seeds["msh"].append(_imported({small: data}, small, "--material", STEEL))
        data = self.written("part.xdmf", lambda path: meshio.write(path, plain))
        both = {"part.xdmf": data, "part.h5": (self.folder / "part.h5").read_bytes()}
        seeds["xdmf"] = [_imported(both, "part.xdmf", "--material", STEEL)]
        return seeds

    def matrices(self) -> dict[str, list[Seed]]:
        K, M = self.model.K, self.model.M
        node, dof = self.model.nodes.ids[self.model.dofs.node], self.model.dofs.component + 1
        two = ("--stiffness", "k.mtx", "--mass", "m.mtx")

        def market(matrix: Any) -> bytes:
            stream = io.BytesIO()
            scipy.io.mmwrite(stream, matrix, symmetry="symmetric", precision=17)
            return stream.getvalue()

        def abaqus(matrix: Any) -> bytes:
            return self.written("k.abq", lambda path: write_abaqus_matrix(path, matrix, node, dof))

        def upper(matrix: Any) -> bytes:
            part = sp.coo_array(sp.triu(matrix))
            rows = zip(*part.coords, part.data, strict=True)
            return "".join(f"{i + 1} {j + 1} {v:.16e}\n" for i, j, v in rows).encode()

        labels = np.column_stack((node, dof))
        symmetric = {"rows": labels, "columns": labels, "form": 6}
        dmig = {name: DmigMatrix(matrix=A, **symmetric) for name, A in (("KAAX", K), ("MAAX", M))}
        rows = "node,dof\n" + "".join(f"{a},{b}\n" for a, b in labels)
        calculix = {
            "job.sti": upper(K),
            "job.mas": upper(M),
            "job.dof": "".join(f"{a}.{b}\n" for a, b in labels).encode(),
        }
        deck = mesh_decks.abaqus_mesh(self.model.mesh).encode()

        def labelled(files: Files, *arguments: str) -> Seed:
            return _imported({**files, "n.inp": deck}, *arguments, "--nodes", "n.inp", targets=tuple(files))

        both = {"k.mtx": market(K), "m.mtx": market(M)}
        packed = {"k.mtx.gz": gzip.compress(both["k.mtx"], mtime=0), "m.mtx": both["m.mtx"]}
        named = [{"binary": True}, {"binary": False}, {"binary": True, "sparse": "dense", "bits": 64}]
        seeds = {
            "matrix-market": [_imported(both, *two), _imported(packed, "--stiffness", "k.mtx.gz", "--mass", "m.mtx")],
            "dofs": [
                _imported(
                    {**both, "n.inp": deck, "d.csv": rows.encode()},
                    *two,
                    "--nodes",
                    "n.inp",
                    "--dofs",
                    "d.csv",
                    targets=("d.csv",),
                )
            ],
            "abaqus-matrix": [labelled({"k.mtx": abaqus(K), "m.mtx": abaqus(M)}, *two)],
            "calculix-matrix": [labelled(calculix, "job.sti")],
            "op4": [
                _imported({"a.op4": self.written("a.op4", lambda p, o=o: write_op4(p, self.names, **o))}, "a.op4")
                for o in named
            ],
            "dmig": [labelled({"a.pch": self.written("a.pch", lambda path: write_dmig(path, dmig))}, "a.pch")],
        }
        return seeds

    def ansys(self) -> dict[str, list[Seed]]:
        labels, xyz = self.model.nodes.ids, self.model.nodes.xyz
        nodes = self.written("n.lis", lambda path: ansys_files.write_nodes(path, labels, xyz))
        dof = np.tile([1, 2, 3], len(labels))
        full = self.written(
            "a.full", lambda path: ansys_files.write_full(path, self.names, labels, dof, [3] * len(labels))
        )
        rows = [(label, name) for label in labels for name in ("UX", "UY", "UZ")]
        mapping = "  Matrix Eqn     Node     DOF\n" + "".join(
            f"{i:10d}{n:10d}   {d}\n" for i, (n, d) in enumerate(rows, start=1)
        )
        files = {
            "K": self.written("K", lambda path: ansys_files.boeing(path, self.model.K)),
            "M": self.written("M", lambda path: ansys_files.market(path, self.model.M)),
            "K.mapping": mapping.encode(),
            "n.lis": nodes,
        }
        options = ("--set", "mass=M", "--set", "mapping=K.mapping", "--set", "nodes=n.lis")
        return {
            "ansys-full": [_imported({"a.full": full, "n.lis": nodes}, "a.full", "--set", "nodes=n.lis")],
            "ansys-matrices": [_imported(files, "K", "--format", "ansys-matrices", *options)],
        }

    def binary(self) -> dict[str, list[Seed]]:
        K, M, mesh = self.model.K, self.model.M, self.model.nodes.xyz
        dense = {"K": K.toarray(), "M": M.toarray()}

        def exudyn(path: Path) -> None:
            with h5py.File(path, "w") as file:
                file["type"], file["fileVersion"], file["nodes/Position"] = "FEMinterface", 4, mesh
                for name, A in (("stiffnessMatrix", K), ("massMatrix", M)):
                    for part in ("data", "indices", "indptr"):
                        file[f"{name}/{part}"] = getattr(A, part)
                    file[f"{name}/shape"] = A.shape

        def groups(path: Path) -> None:
            with h5py.File(path, "w") as file:
                for name, A in self.names.items():
                    for part in ("data", "indices", "indptr"):
                        file[f"{name}/{part}"] = getattr(A, part)
                    file[f"{name}/shape"] = A.shape

        def saved(**options: Any) -> Callable[[Path], object]:
            held: Any = dense if options.get("format") == "4" else {k: sp.csc_array(v) for k, v in self.names.items()}
            return lambda path: scipy.io.savemat(path, held, **options)

        def imported(name: str, write: Callable[[Path], object], *more: str) -> Seed:
            return _imported({name: self.written(name, write)}, name, *more)

        archives = {}
        for name, A in (("k.npz", K), ("m.npz", M)):
            archives[name] = self.written(name, lambda path, A=A: sp.save_npz(path, sp.csc_array(A)))
        versions = {"format": "4"}, {}, {"do_compression": True}
        B, C = np.eye(len(dense["K"]), 2), np.eye(1, len(dense["K"]), 5)
        system = from_matrices(K, M, D=1e-5 * K, B=B, C=C, names={"B": ["drive", "brake"], "C": ["path"]})
        named = ("--set", "B=B", "--set", "C=C", "--set", "B_names=drive,brake")
        return {
            "npz": [
                imported("a.npz", lambda path: np.savez(path, **dense)),
                _imported(archives, "--stiffness", "k.npz", "--mass", "m.npz"),
            ],
            "matlab": [imported("a.mat", saved(**options)) for options in versions],
            "hdf5": [imported("a.h5", groups)],
            "exudyn": [imported("fem.h5", exudyn, "--format", "exudyn")],
            "native": [imported("a.model.h5", lambda path: write_model(path, self.model))],
            "inputs": [
                imported("a.model.h5", lambda path: write_model(path, system)),
                imported("a.mat", lambda path: scipy.io.savemat(path, {**dense, "B": B, "C": C}), *named),
            ],
        }

    def bodies(self) -> dict[str, list[Seed]]:
        """Job files, body files, motions."""
        deck = decks.deck(tuple(itertools.product(range(3), range(1), range(1)))).encode()
        more = {
            "certify": "band_hz = [0, 20000]\npoints = 3",
            "stress": "",
            "damping": "modal = 0.02",
            "reduce2": 'name = "guyan"\nmethod = "guyan"',
        }
        texts = [decks.job(), decks.job(more)]
        reduce = program(["reduce", "job.toml", "--json"])
        jobs = [Seed({"job.toml": text.encode(), "part.inp": deck}, ("job.toml",), reduce, "part.h5") for text in texts]
        for name, data in (("part.inp", deck), ("job.toml", texts[1].encode())):
            (self.folder / name).write_bytes(data)
        ended = forked.run(program(["reduce", "job.toml", "-q", "--json"]), self.folder, self.folder / "logs")
        if ended.code:
            raise SystemExit(f"the body that is to be damaged cannot be made: {ended.errors}")
        with h5py.File(self.folder / "part.h5") as file:
            width = file["bodies/cb/basis"].shape[1]
        body = (self.folder / "part.h5").read_bytes()
        motion = np.array([[1e-6 * (i + 1) * (k + 1) for i in range(width)] for k in range(4)])
        times = 0.1 * np.arange(4.0)
        heading = "time," + ",".join(f"q{i + 1}" for i in range(width)) + "\n"
        rows = [",".join(map(repr, row)) for row in np.column_stack((times, motion)).tolist()]
        archive = self.written("m.npz", lambda path: np.savez(path, time=times, coordinates=motion))
        motions = {"m.csv": (heading + "\n".join(rows) + "\n").encode(), "m.npz": archive}

        def verb(*arguments: str, output: str | None, files: Files, target: str) -> Seed:
            return Seed(files, (target,), program(arguments), output)

        recover = {name: ("recover", "part.h5", name, "-o", "out.vtkhdf", "--body", "cb", "--json") for name in motions}
        exported = ("export", "part.h5", "--body", "cb", "--to")
        return {
            "job": jobs,
            "motion": [
                verb(*recover[name], output="out.vtkhdf", files={"part.h5": body, name: data}, target=name)
                for name, data in motions.items()
            ],
            "body": [
                verb("info", "part.h5", "--json", output=None, files={"part.h5": body}, target="part.h5"),
                verb(*exported, "op4", "-o", "out.op4", output="out.op4", files={"part.h5": body}, target="part.h5"),
                verb(
                    *exported,
                    "sid",
                    "-o",
                    "out.SID_FEM",
                    output="out.SID_FEM",
                    files={"part.h5": body},
                    target="part.h5",
                ),
                verb(
                    *recover["m.csv"],
                    output="out.vtkhdf",
                    files={"part.h5": body, "m.csv": motions["m.csv"]},
                    target="part.h5",
                ),
            ],
        }

    def gmp(self) -> dict[str, list[Seed]]:
        """Members with large deflections, and the checkpoint of their offline stage."""
        ended = forked.run(scenarios.offline(1), self.folder, self.folder / "logs")
        if ended.code:
            raise SystemExit(f"the member that is to be damaged cannot be made: {ended.errors}")
        member, kept = ((self.folder / name).read_bytes() for name in ("member.h5", "kept.h5"))
        return {
            "gmp": [
                Seed({"member.h5": member}, ("member.h5",), _as_command(_members), "out.h5"),
                Seed({"kept.h5": kept}, ("kept.h5",), _as_command(scenarios.offline(1)), "member.h5"),
            ]
        }


def _members() -> None:
    from morembs.dynamics.gmp.stored import read_members, write_members

    write_members("out.h5", read_members("member.h5"))


def _as_command(work: Callable[[], object]) -> Callable[[], None]:
    """A function that ends as a command does: its errors are one message and exit code 2."""

    def command() -> None:
        from morembs.app.cli.terminal import messages

        failed: list[str] = []
        with messages(failed):
            work()
        raise SystemExit(2 if failed else 0)

    return command


# Formats by the method that makes their files.
_MAKERS: dict[Callable[[_Workshop], dict[str, list[Seed]]], tuple[str, ...]] = {
    _Workshop.decks: ("abaqus", "nastran", "ansys", "unv"),
    _Workshop.meshes: ("msh", "vtk", "vtu", "mesh", "med", "xdmf"),
    _Workshop.matrices: ("matrix-market", "dofs", "abaqus-matrix", "calculix-matrix", "op4", "dmig"),
    _Workshop.ansys: ("ansys-full", "ansys-matrices"),
    _Workshop.binary: ("npz", "matlab", "hdf5", "exudyn", "native", "inputs"),
    _Workshop.bodies: ("job", "motion", "body"),
    _Workshop.gmp: ("gmp",),
}
FORMATS = tuple(format for formats in _MAKERS.values() for format in formats)
# Those whose runs take several times as long as an import, and get fewer trials.
SLOW = ("job", "motion", "body", "gmp")


def seeds(folder: Path, formats: Sequence[str]) -> dict[str, list[Seed]]:
    """The files of formats, in the order in which they are asked for."""
    folder.mkdir(parents=True)
    shop = _Workshop(folder)
    of_format: dict[str, list[Seed]] = {}
    for make, provided in _MAKERS.items():
        if set(provided) & set(formats):
            of_format |= make(shop)
    return {format: of_format[format] for format in formats}
