"""What a deck holds, and what its own program says of its frequencies: ccx of Abaqus decks, MYSTRAN of Nastran decks.

Bodies are free: what holds them is taken out of the deck, as the model of an import is free.
"""

from __future__ import annotations

import gzip
import re
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from morembs.base.errors import InputError
from morembs.fem import FEModel
from morembs.importers.engines.calculix.program import find_ccx
from morembs.importers.engines.mystran.program import mystran_path
from morembs.importers.matrices.calculix import read_calculix_matrices
from morembs.importers.matrices.op4 import read_op4

# Of steel in mm, t and s, where materials have none; eigenvalues that are computed and, behind rigid
# motions, compared; seconds of a run.
DENSITY, MODES, COMPARED, SECONDS = 7.8e-9, 40, 10, 60
# Digits that ccx writes of a stiffness; part of the largest eigenvalue that one of a rigid motion has; part of the
# largest reciprocal below which one is that of an infinite eigenvalue.
DIGITS, RIGID, TOLD = 1e-14, 1e-10, 1e-12
# The first eigenvalue of a held body, of the largest one that is looked at, at least.
HELD = 1e-9
# Rows up to which eigenvalues are those of whole matrices.
_DENSE = 400

_SOLID = ("C3D4", "C3D6", "C3D8", "C3D10", "C3D15", "C3D20", "C3D27")
_STRUCTURE = ("S3", "S4", "S6", "S8", "STRI", "SC6", "SC8", "B3", "M3D", "T3D", "PIPE3", "ELBOW", "FRAME3")
_POINTS = ("MASS", "ROTARYI", "SPRING", "DASHPOT", "DCOUP", "CONN", "SFM3D", "RB3D")
_NOT_LINEAR = re.compile(
    r"^\*(USER MATERIAL|HYPER|USER ELEMENT|DEFORMATION PLAST|CONDUCTIVITY\n\*SPECIFIC)", re.IGNORECASE | re.MULTILINE
)
_NASTRAN_SOLID = ("CHEXA", "CPENTA", "CTETRA")
_NASTRAN_STRUCTURE = {
    *("CQUAD4", "CQUAD8", "CQUADR", "CQUAD", "CTRIA3", "CTRIA6", "CTRIAR", "CSHEAR", "CPYRAM"),
    *("CBAR", "CBEAM", "CBEAM3", "CBEND", "CROD", "CTUBE", "CONROD"),
}
# Cards that make a structure; what holds or loads it is left out.
_NASTRAN_MODEL = re.compile(
    r"GRID|GRDSET|SPOINT|CORD[12][RCS]|C(HEXA|PENTA|TETRA|QUAD4|TRIA3|SHEAR|BAR|BEAM|ROD|TUBE|ONROD|BUSH|ELAS[1-4])|"
    r"BAROR|BEAMOR|P(SOLID|SHELL|SHEAR|COMP|COMPG|BAR|BARL|BEAM|BEAML|ROD|TUBE|ELAS|BUSH)|MAT[1289]|RBE[23]|RBAR|"
    r"CONM[12]|CMASS[1-4]|PMASS|MPC|MPCADD",
    re.IGNORECASE,
)
_ANSYS_SOLID = {"45", "73", "92", "95", "185", "186", "187", "285"}
_PACKED, _ENDINGS = (
    ".gz",
    {".inp": "abaqus", ".bdf": "nastran", ".nas": "nastran", ".fem": "nastran", ".cdb": "ansys"},
)
_CONTACT = {
    *("*CONTACTPAIR", "*SURFACEINTERACTION", "*SURFACEBEHAVIOR", "*FRICTION", "*CLEARANCE", "*CONTACTDAMPING"),
    *("*GAPCONDUCTANCE", "*CYCLICSYMMETRYMODEL", "*SELECTCYCLICSYMMETRYMODES"),
}
_SUPPORT = {"*BOUNDARY", "*BOUNDARYF", "*SUBMODEL"}


@dataclass(frozen=True, kw_only=True)
class Holds:
    """What a deck holds: ``format``; whether it is a ``structure`` in space that is linear, of ``solids`` alone, and
    ``complete``: with materials, properties and all files that it includes."""

    format: str
    structure: bool
    solids: bool
    complete: bool


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """The deck, of one that is packed a copy beside copies of its neighbors."""
    if path.suffix != _PACKED:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        stem = path.name.split(".")[0]
        for other in (path, *path.parent.glob(f"{stem}.*{_PACKED}"), *_included(path)):
            (Path(folder) / other.name.removesuffix(_PACKED)).write_bytes(gzip.decompress(other.read_bytes()))
        yield Path(folder) / path.stem


def _included(path: Path) -> list[Path]:
    names = re.findall(rb"(?im)^\*INCLUDE.*INPUT *= *\"?([^\s\",]+)", gzip.decompress(path.read_bytes()))
    files = [path.with_name(name.decode("latin-1") + _PACKED) for name in names]
    return [file for file in files if file.is_file()]


def decks_of(folder: Path, megabytes: float) -> list[Path]:
    """All files of a folder that look like decks, of at most so many megabytes."""
    found = []
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        packed = path.name.removesuffix(_PACKED)
        text = (
            (gzip.decompress(path.read_bytes()) if packed != path.name else path.read_bytes())
            if (Path(packed).suffix.lower() in (*_ENDINGS, ".dat") and path.stat().st_size <= megabytes * 1e6)
            else b""
        )
        wanted = {".inp": rb"^\*(NODE|PART|INCLUDE)\b|^GRID", ".cdb": rb"^(NBLOCK|N,)"}
        if re.search(wanted.get(Path(packed).suffix.lower(), rb"^GRID"), text, re.MULTILINE | re.IGNORECASE):
            found.append(path)
    return found


def holds(path: Path) -> Holds:
    """What a deck holds, by its words alone."""
    text = path.read_text(encoding="latin-1")
    format = _ENDINGS.get(path.suffix.lower(), "nastran")
    if format == "abaqus" and re.search(r"(?m)^\*", text) is None:
        format = "nastran"
    return {"abaqus": _abaqus, "nastran": _nastran, "ansys": _ansys}[format](path, text)


def _abaqus(path: Path, text: str) -> Holds:
    types = {code.upper() for code in re.findall(r"(?im)^\*ELEMENT\b[^*\n]*TYPE *= *\"?([A-Z0-9]+)", text)}
    files = re.findall(r"(?im)^\*INCLUDE.*INPUT *= *\"?([^\s\",]+)", text)
    there = all((path.parent / name).is_file() for name in files)
    solid, other = ({code for code in types if code.startswith(kinds)} for kinds in (_SOLID, _STRUCTURE))
    rest = types - solid - other - {code for code in types if code.startswith(_POINTS)}
    known = bool(solid | other) and not rest and not _NOT_LINEAR.search(text)
    sections = re.search(r"(?im)^\*(SOLID|SHELL|BEAM|MEMBRANE|BEAM GENERAL|SHELL GENERAL) *SECTION", text)
    elastic = re.search(r"(?im)^\*ELASTIC", text)
    return Holds(
        format="abaqus",
        structure=known,
        solids=known and not other,
        complete=known and there and bool(sections and elastic),
    )


def _nastran(path: Path, text: str) -> Holds:
    cards = {word.upper() for word in re.findall(r"(?m)^([A-Za-z][A-Za-z0-9]*)[*, ]", text)}
    solid, other = cards & set(_NASTRAN_SOLID), cards & _NASTRAN_STRUCTURE
    files = [
        next(filter(None, names)) for names in re.findall(r"(?im)^INCLUDE *(?:'([^']+)'|\"([^\"]+)\"|(\S+))", text)
    ]
    there = all((path.parent / name).is_file() for name in files)
    known = bool(solid | other)
    materials = bool(cards & {"MAT1", "MAT2", "MAT8", "MAT9"})
    return Holds(format="nastran", structure=known, solids=known and not other, complete=known and materials and there)


def _ansys(path: Path, text: str) -> Holds:
    types = set(re.findall(r"(?im)^ET *, *\d+ *, *(?:[A-Z]+)?(\d+)", text))
    materials = re.search(r"(?im)^MP(DATA|TEMP)?,.*EX", text) is not None
    known = bool(re.search(r"(?im)^(EBLOCK|EN,)", text))
    solids = known and bool(types) and types <= {*_ANSYS_SOLID, "21", "14", "154"}
    return Holds(format="ansys", structure=known, solids=solids, complete=known and materials and bool(types))


def as_frequency(text: str, kind: str, *, held: bool = False) -> str:
    """An Abaqus deck without contact and sectors, its steps replaced by *FREQUENCY of a ``kind``, densities filled in;
    free, or ``held`` by what *BOUNDARY of the model and of the first step holds."""
    blocks, boundary, in_step, steps, was_held = [], [], False, 0, False
    for block in re.split(r"(?m)^(?=\*[A-Za-z])", re.sub(r"(?m)^\*\*.*(\n|$)", "", text)):
        word = re.sub(r"\s", "", block.split("\n", 1)[0].split(",")[0]).upper()
        steps += word == "*STEP"
        in_step = in_step or word == "*STEP"
        if held and word == "*BOUNDARY" and steps < 2:
            # The first one of the step may let go of what the model holds.
            if steps and not was_held and re.match(r"\*[^\n]*,\s*OP\s*=\s*NEW\b", block, re.IGNORECASE):
                boundary.clear()
            was_held = was_held or steps > 0
            rows = [row for row in block.split("\n")[1:] if row.strip()]
            boundary.append("\n".join(["*BOUNDARY", *(",".join(row.split(",")[:3]) for row in rows)]) + "\n")
        elif not in_step and word not in _CONTACT | _SUPPORT:
            blocks.append(block if block.endswith("\n") else block + "\n")
        in_step = in_step and word != "*ENDSTEP"
    modes = COMPARED if held else MODES
    return f"{_with_densities(blocks)}{''.join(boundary)}*STEP\n*FREQUENCY{kind}\n{modes}\n*END STEP\n"


def _with_densities(blocks: list[str]) -> str:
    result: list[str] = []
    words = [block.upper().replace(" ", "") for block in blocks]
    materials = [i for i, word in enumerate(words) if word.startswith("*MATERIAL")]
    for i, block in enumerate(blocks):
        result.append(block)
        if i in materials:
            end = next((j for j in materials if j > i), len(blocks))
            if not any(word.startswith("*DENSITY") for word in words[i:end]):
                result.append(f"*DENSITY\n{DENSITY}\n")
    return "".join(result)


def of_ccx(path: Path) -> Spectrum:
    """Eigenvalues of the matrices that ccx makes of an Abaqus deck as it stands, in its *FREQUENCY step.

    Raises:
        InputError: it makes none.
    """
    with _by_ccx(path, ", SOLVER=MATRIXSTORAGE", held=False) as (stem, said):
        if not (stem.with_suffix(".sti").is_file() and stem.with_suffix(".sti").stat().st_size):
            raise InputError(f"ccx makes no matrices: {said}")
        read = read_calculix_matrices(stem, several=True)
        return spectrum(read.K, read.M)


def of_held_ccx(path: Path) -> Spectrum:
    """Eigenvalues that ccx prints for an Abaqus deck that its boundary holds.

    Raises:
        InputError: it prints none, or rigid motion is left.
    """
    with _by_ccx(path, "", held=True) as (stem, said):
        values: list[float] = []
        for line in stem.with_suffix(".dat").read_text(errors="replace").splitlines():
            fields = line.split()
            if len(fields) == 5 and fields[0].isdigit():
                values.append(float(fields[1]))
            elif values and "P A R T I C" in line:
                break
        if not values or min(values) <= HELD * max(values):
            raise InputError(f"ccx prints no frequencies of a held body: {said}")
        return Spectrum(values=np.array(values), error=0.0)


@contextmanager
def _by_ccx(path: Path, kind: str, *, held: bool) -> Iterator[tuple[Path, str]]:
    """The files of a run of ccx on a deck with one step *FREQUENCY, and what it says at last."""
    with tempfile.TemporaryDirectory() as folder:
        for other in path.parent.iterdir():
            if other.is_file() and other.suffix.lower() in (".inp", ".msh", ".nam", ".dat", ".sur", ".mpc"):
                (Path(folder) / other.name).symlink_to(other.resolve())
        stem = Path(folder) / "own_of_deck"
        text = as_frequency(path.read_text(encoding="latin-1"), kind, held=held)
        stem.with_suffix(".inp").write_text(text, "latin-1")
        yield stem, _run([find_ccx().path, stem.name], folder)


def of_mystran(path: Path) -> Spectrum:
    """Eigenvalues of the matrices that MYSTRAN makes of the free structure of Nastran bulk data as they stand.

    Raises:
        InputError: it makes none.
    """
    text = path.read_text(encoding="latin-1")
    begin = re.search(r"(?im)^\s*BEGIN\s+BULK.*$", text)
    bulk = text[begin.end() + 1 :] if begin else text
    kept, is_kept = [], False
    for line in bulk.splitlines():
        name = re.match(r"[A-Za-z][A-Za-z0-9]*", line)
        is_kept = is_kept if name is None else _NASTRAN_MODEL.fullmatch(name[0]) is not None
        kept += [line] if is_kept or line.startswith("$") else []
    # The matrices that it has left behind multi-point constraints and grids that nothing turns: of a free body with
    # rotations without mass its own eigenvalues are not those of these.
    head = "ID A,B\nSOL 103\nOUTPUT4 KLL,MLL,,,//0/21 $\nCEND\nMETHOD = 7654321\nBEGIN BULK\nEIGRL,7654321,,,1\n"
    with tempfile.TemporaryDirectory() as folder:
        bulk = "\n".join([*kept, "PARAM,AUTOSPC,Y", "ENDDATA"])
        (Path(folder) / "own.bdf").write_text(f"{head}{bulk}\n", "latin-1")
        _run([mystran_path(), "own.bdf"], folder)
        output, log = (Path(folder) / f"own.{end}" for end in ("OU1", "ERR"))
        if output.is_file() and output.stat().st_size:
            read = read_op4(output, ("KLL", "MLL"))
            K, M = (sp.csr_array(read[name].matrix) for name in ("KLL", "MLL"))
            return spectrum(K, M)
        said = log.read_text(errors="replace").splitlines() if log.is_file() else []
        errors = [line.strip() for line in said if "*ERROR" in line]
        raise InputError(f"MYSTRAN makes no matrices: {(errors or ['it says nothing'])[0][:120]}")


def _run(command: list[Path | str], folder: str) -> str:
    """The last error that a program prints, or its last line."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return "it did not finish"
    lines = [line.strip() for line in done.stdout.decode("latin-1").splitlines() if line.strip()]
    errors = [line for line in lines if "*ERROR" in line]
    return (errors or lines or [f"exit status {done.returncode}"])[-1][:120]


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectrum:
    """The lowest eigenvalues (k,) of a body that may be free, ascending, with those of rigid motion, and the ``error``
    that the digits of its stiffness leave in each."""

    values: np.ndarray
    error: float

    @property
    def frequencies(self) -> list[float]:
        """The first ten that are no rigid motion, in Hz of the units of the deck."""
        elastic = self.values[self.values > self.error][:COMPARED]
        return [float(f"{hz:.8g}") for hz in np.sqrt(elastic) / (2 * np.pi)]


def spectrum_of(model: FEModel) -> Spectrum:
    """Eigenvalues of the dofs of a model that follow no others."""
    K, M = model.K, model.M
    if model.dependent is not None:
        T = sp.csr_array(model.dependent.S[:, np.flatnonzero(model.dependent.owner < 0)])
        K, M = sp.csr_array(T.T @ K @ T), sp.csr_array(T.T @ M @ T)
    return spectrum(K, M)


def spectrum(K: sp.csr_array, M: sp.csr_array) -> Spectrum:
    """Eigenvalues of a pencil whose rows may be empty, or without mass.

    Raises:
        InputError: there are none.
    """
    rows = np.flatnonzero(np.abs(K.diagonal()) + np.abs(M.diagonal()) > 0)
    K, M = (sp.csc_array(A[rows][:, rows]) for A in (K, M))
    heavy = M.diagonal() > 0
    if not heavy.any():
        raise InputError("no row has a mass")
    ratios = K.diagonal()[heavy] / M.diagonal()[heavy]
    try:
        first = _shifted(K, M, 1e-7 * float(np.median(ratios)))
        values = _shifted(K, M, 1e-2 * float(np.abs(first[: 2 * COMPARED]).max()))
    except (RuntimeError, ValueError, sl.LinAlgError, sla.ArpackError) as error:
        raise InputError(f"no eigenvalues: {error}") from error
    return Spectrum(values=values, error=max(DIGITS * float(ratios.max()), RIGID * float(values[-1])))


def _shifted(K: sp.csc_array, M: sp.csc_array, shift: float) -> np.ndarray:
    B = sp.csc_array(K + shift * M)
    count = min(MODES, K.shape[0])
    if K.shape[0] <= _DENSE:
        theta = sl.eigh(M.toarray(), B.toarray(), eigvals_only=True)[::-1][:count]
    else:
        start = np.random.default_rng(1).standard_normal(K.shape[0])
        inverse = sla.splu(B, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        operator = sla.LinearOperator(B.shape, inverse.solve)
        theta = np.sort(sla.eigsh(M, count, M=B, Minv=operator, v0=start, return_eigenvectors=False))[::-1]
    # Of rows without mass there are infinite ones.
    return np.sort(1.0 / theta[theta > TOLD * theta[0]] - shift)


def difference(ours: Spectrum, theirs: Spectrum) -> float:
    """The largest relative difference of the first frequencies beyond what digits leave."""
    count = min(len(ours.values), len(theirs.values))
    error = max(ours.error, theirs.error)
    a, b = ours.values[:count], theirs.values[:count]
    rigid = int((np.maximum(a, b) <= error).sum())
    a, b = (np.maximum(values, error)[rigid : rigid + COMPARED] for values in (a, b))
    if not len(a):
        return 0.0
    return float((np.maximum(np.abs(a - b) - error, 0.0) / (2 * b)).max())
