"""Certificates proven again by a program that believes nothing: witness, verdicts, false certificates."""

import ast
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse as sp
from typer.testing import CliRunner

from benchmarks.certificates import dense_errors
from benchmarks.verification import TAMPERS, answer, cases, reseal, tamper
from morembs.app.cli import commands as cli
from morembs.base.errors import SolverError
from morembs.body import elastic_body, make_part
from morembs.body.file import write_body
from morembs.certificate import morembs_verify
from morembs.certificate.certify import certify
from morembs.certificate.witness import write_witness
from morembs.fem.interface import make_interface
from morembs.importers.model_file import read_model, write_model
from morembs.problem import Damping, Problem
from morembs.reducers import BalancedTruncation, CraigBampton, FreeInterface
from tests.responses.test_direct import dense_response
from tests.support.meshes import beam as beam_of_blocks
from tests.support.meshes import box, ends, steel, where
from tests.support.refusals import refusal

RUNNER = CliRunner()
PROGRAM = Path(morembs_verify.__file__)
ROOT = Path(__file__).parents[2]
DOCS, MESHES = ROOT / "docs" / "background" / "verification.md", ROOT / "data" / "small_meshes"
BAND = (0.0, 3000.0)
VERIFIED = re.compile(r"verified: error <= (\S+) at every frequency from 0 to 3000 Hz")


def beam(damping):
    model = steel(box("hex20", (6, 1, 1), (0.5, 0.05, 0.03)))
    ends = [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling=coupling)
        for name, x, coupling in (("left", 0.0, "rigid"), ("right", 0.5, "average"))
    ]
    return Problem(model, ends, damping=damping)


def written(folder, damping, reducers):
    files = tuple(folder / f"{name}.h5" for name in ("body", "model", "witness"))
    with beam(damping) as problem:
        bodies = [reducer.reduce(problem) for reducer in reducers]
        certificates = certify(problem, bodies, BAND, points=5)
        part = make_part(problem)
        parts = [elastic_body(problem, *each[:1], part, each[1]) for each in zip(bodies, certificates, strict=True)]
        write_body(files[0], parts)
        write_model(files[1], problem.model)
        write_witness(files[2], problem, BAND, body=files[0], model=files[1])
    return files, certificates


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return written(tmp_path_factory.mktemp("sound"), Damping(alpha=2.0, beta=4e-7), [FreeInterface(modes=8)])


@pytest.mark.parametrize(
    ("damping", "reducers"),
    [
        (Damping(modal=0.01), [CraigBampton(modes=6), BalancedTruncation(order=30, band_hz=list(BAND))]),
        (Damping(structural=0.02), [FreeInterface(modes=8)]),
        (Damping(), [FreeInterface(modes=8)]),
    ],
)
def test_stated_limits_are_proven_again(tmp_path, damping, reducers):
    files, certificates = written(tmp_path, damping, reducers)
    found = []
    belongs, proven, said = morembs_verify.verify(*map(str, files), found)
    assert belongs and proven, said
    assert [float(x) for x in VERIFIED.findall(said)] == pytest.approx(
        [each.limit.upper for each in certificates], rel=1e-5
    )
    # Its own limits are not empty either.
    assert all((each > 0.9).all() and (each <= 1).all() for each in found)


def test_the_program_runs_alone(sound):
    files, _ = sound
    imported = set()
    for node in ast.walk(ast.parse(PROGRAM.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add(str(node.module))
    known = {"h5py", "numpy", "scipy", *sys.stdlib_module_names}
    assert {name.partition(".")[0] for name in imported} <= known
    run = subprocess.run([sys.executable, PROGRAM, *files], capture_output=True, text=True, check=False)
    assert run.returncode == 0 and VERIFIED.search(run.stdout), run
    shown = RUNNER.invoke(cli.app, ["verify", *map(str, files)])
    assert shown.exit_code == 0


def test_every_altered_byte_is_refused(sound, tmp_path):
    files, _ = sound
    rng = np.random.default_rng(4)
    for changed in range(3):
        copies = [shutil.copy(file, tmp_path) for file in files]
        data = Path(copies[changed]).read_bytes()
        for at in [0, 511, 512, len(data) - 1, *rng.integers(len(data), size=8)]:
            other = bytearray(data)
            other[at] ^= 1 << int(rng.integers(8))
            Path(copies[changed]).write_bytes(other)
            try:
                # What HDF5 itself cannot read is refused too.
                assert morembs_verify.belong(*map(str, copies)), (changed, at)
            except (OSError, KeyError, ValueError):
                continue


def test_new_digests_do_not_prove_a_false_limit(sound, tmp_path):
    files, (certificate,) = sound
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    place = next(iter(h5py.File(copies[0])["bodies"]))
    with h5py.File(copies[0], "r+") as file:
        file[f"bodies/{place}/certificate/limits/envelope"][1] = 0.999 * certificate.limit.lower
    changed = RUNNER.invoke(cli.app, ["verify", *map(str, copies)])
    assert changed.exit_code == 1 and "belongs: no, the body was changed" in changed.stdout
    reseal(*copies)
    shown = RUNNER.invoke(cli.app, ["verify", *map(str, copies)])
    assert shown.exit_code == 1 and "belongs: yes" in shown.stdout
    assert "not verified: lemma cells-of-the-band fails: the envelope error at" in shown.stdout


@pytest.mark.parametrize(
    ("name", "value", "lemma"),
    [
        ("rigid", np.nan, "ritz-values"),
        ("vectors", np.inf, "ritz-values"),
        ("solutions", 0.0, "cells-of-the-band"),
        ("shift", 1.0, "complement-bound"),
        ("modes_below", 2, "ritz-values"),
    ],
)
def test_a_witness_is_not_believed(sound, tmp_path, name, value, lemma):
    files, _ = sound
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    with h5py.File(copies[2], "r+") as file:
        file[name][...] = value
    reseal(*copies)
    belongs, proven, said = morembs_verify.verify(*map(str, copies))
    assert belongs and not proven and f"not verified: lemma {lemma} fails" in said


def put(name, change):
    """Another dataset in the place of one."""

    def altered(file, place):
        at = name.format(place)
        value = change(file[at][()])
        del file[at]
        file[at] = value

    return altered


def scaled(factor, *at):
    def change(value):
        value[at] *= factor
        return value

    return change


def sheared(value):
    value[0, -1] += 0.5 * np.abs(value).max()
    return value


def without_a_mode(file, _):
    # As many modes are said to lie below the shift, one of which is not there.
    for name in ("vectors", "coefficients"):
        put(name, lambda value: np.delete(value[:, :6], 2, axis=1))(file, "")


LIMITS, CERTIFICATE = "bodies/{}/certificate/limits/", "bodies/{}/certificate/"


def refuse_changed(files, folder, which, change, lemma):
    """One of the ``files``, changed and sealed anew, is refused by its lemma."""
    copies = [Path(shutil.copy(file, folder)) for file in files]
    with h5py.File(copies[0]) as file:
        place = next(iter(file["bodies"]))
    with h5py.File(copies[which], "r+") as file:
        change(file, place)
    reseal(*copies)
    belongs, proven, said = morembs_verify.verify(*map(str, copies))
    assert belongs and not proven and f"not verified: lemma {lemma} fails" in said, said


CELLS = "cells-of-the-band"


@pytest.mark.parametrize(
    ("which", "change", "lemma"),
    [
        (0, put(LIMITS + "envelope", lambda value: np.r_[value[0], -np.inf, value[2]]), CELLS),
        (0, put(LIMITS + "envelope", lambda value: np.r_[value[0], np.nan, value[2]]), CELLS),
        (0, put(LIMITS + "peak", lambda value: -value), CELLS),
        (0, put(LIMITS + "peak", lambda value: 0.0 * value), CELLS),
        (0, put(CERTIFICATE + "band_hz", lambda value: value[::-1].copy()), CELLS),
        (0, put(CERTIFICATE + "band_hz", lambda value: value - 1.0), CELLS),
        (0, put(CERTIFICATE + "band_hz", lambda value: np.array([0.0, np.nextafter(3000.0, 4000.0)])), CELLS),
        (0, put(CERTIFICATE + "cells_hz", scaled(np.nan, 3)), "complement-bound"),
        (0, put(CERTIFICATE + "cells_hz", scaled(1 - 2**-53, 3, 1)), CELLS),
        (0, put(CERTIFICATE + "cells_hz", lambda value: value[:, ::-1].copy()), CELLS),
        (0, put(CERTIFICATE + "cells_hz", scaled(10.0, -1, 1)), "complement-bound"),
        (0, put(CERTIFICATE + "damping_floor", lambda _: np.nan), "damping"),
        (0, put("bodies/{}/mass_matrix", scaled(1.001, slice(6), slice(6))), "rigid-motions"),
        (0, put("bodies/{}/damping_matrix", sheared), "rigid-motions"),
        (0, put("bodies/{}/mass_matrix", lambda value: -value), "body-response"),
        (0, put("bodies/{}/input_matrix", lambda value: value[:, :1]), "body-response"),
        (0, put("inputs/component", lambda value: value[::-1].copy()), "interface-map"),
        (0, put("inputs/interface_index", lambda value: 1 - value), "interface-map"),
        (0, put("interfaces/right/axes", lambda value: value[[1, 2, 0]]), "interface-map"),
        (0, put("interfaces/right/components", lambda value: value - 1), "interface-map"),
        (1, put("matrices/K/data", scaled(1.01, 5)), "interface-map"),
        (1, put("matrices/K/data", scaled(np.nan, 5)), "interface-map"),
        (1, put("dofs/node", scaled(-1, slice(None))), "interface-map"),
        (1, lambda file, _: file.copy("matrices/M", "matrices/D"), "ritz-values"),
        (1, lambda file, _: file.copy("matrices/M", "matrices/G"), "interface-map"),
        (2, without_a_mode, "sturm-count"),
        (2, put("modes_below", lambda value: value + 1000), "sturm-count"),
        (2, put("modes_below", lambda _: -1), "sturm-count"),
        (2, put("vectors", lambda value: value[:, [0, 0, *range(2, value.shape[1])]]), "ritz-values"),
        (2, put("vectors", lambda value: value[:, ::-1].copy()), "ritz-values"),
        (2, put("vectors", lambda value: value[1:]), "ritz-values"),
        (2, put("shift", lambda value: 4.0 * value), "ritz-values"),
        (2, put("damping", lambda value: np.bytes_(value.replace(b"2.0", b"900.0"))), CELLS),
    ],
)
def test_what_is_false_by_hand_is_refused_by_its_lemma(sound, tmp_path, which, change, lemma):
    refuse_changed(sound[0], tmp_path, which, change, lemma)


def test_negative_mass_hides_no_mode(sound, tmp_path):
    files, _ = sound
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    with h5py.File(copies[1], "r+") as file:
        # One more dof, with a stiffness and a mass below zero: a mode in the band, but never below the shift.
        size = 1e-9 * file["matrices/M/data"][()].max()
        n = len(file["dofs/node"])
        for name, value in (("K", -size * (2 * np.pi * 300) ** 2), ("M", -size)):
            put(f"matrices/{name}/data", lambda data, value=value: np.r_[data, value])(file, "")
            put(f"matrices/{name}/indices", lambda each: np.r_[each, n])(file, "")
            put(f"matrices/{name}/indptr", lambda each: np.r_[each, each[-1] + 1])(file, "")
            put(f"matrices/{name}/shape", lambda each: each + 1)(file, "")
        put("dofs/node", lambda each: np.r_[each, each.max() + 1])(file, "")
        put("dofs/component", lambda each: np.r_[each, 0])(file, "")
        put("nodes/ids", lambda each: np.r_[each, each.max() + 1])(file, "")
        put("nodes/coordinates", lambda each: np.r_[each, each[-1:]])(file, "")
    with h5py.File(copies[2], "r+") as file:
        for name in ("rigid", "vectors", "solutions"):
            # Six dofs of the frame come last.
            put(name, lambda each: np.insert(each, len(each) - 6, 0.0, axis=0))(file, "")
    reseal(*copies)
    said = morembs_verify.verify(*map(str, copies))[2]
    assert "lemma complement-bound fails: the mass is not known to be semidefinite" in said, said


def test_peaks_outside_of_the_band_count_for_nothing(sound, tmp_path):
    files, (certificate,) = sound
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    with h5py.File(copies[0], "r+") as file:
        place = next(iter(file["bodies"]))
        cells = file[f"bodies/{place}/certificate/cells_hz"][()]
        # The softest resonance lies in cells that are kept, but no longer in the band.
        put(CERTIFICATE + "band_hz", lambda _: np.array([cells[-6, 0], 3000.0]))(file, place)
    reseal(*copies)
    assert certificate.limits["peak"].upper < 1
    assert "lemma cells-of-the-band fails: the peak error" in morembs_verify.verify(*map(str, copies))[2]


def linked(file, name, made):
    del file[name]
    file[name] = made


def duplicated(file):
    # 1e20 + x - 1e20 is no sum that may be rounded.
    data, indices, indptr = (file[f"matrices/K/{part}"][()] for part in ("data", "indices", "indptr"))
    indptr[1:] += 2
    put("matrices/K/data", lambda _: np.r_[1e20, -1e20, data])(file, "")
    put("matrices/K/indices", lambda _: np.r_[indices[0], indices[0], indices])(file, "")
    put("matrices/K/indptr", lambda _: indptr)(file, "")


@pytest.mark.parametrize(
    ("which", "change"),
    [
        (1, lambda file: linked(file, "matrices/K", h5py.ExternalLink("other.h5", "matrices/K"))),
        (1, lambda file: linked(file, "matrices/K/data", h5py.SoftLink("/matrices/M/data"))),
        (1, lambda file: put("matrices/K/indices", scaled(10**6, slice(None)))(file, "")),
        (1, lambda file: put("matrices/K/indptr", lambda value: value[::-1].copy())(file, "")),
        (1, lambda file: put("matrices/K/data", lambda value: value * (1 + 1j))(file, "")),
        (
            2,
            lambda file: (
                file.pop("vectors"),
                file.create_dataset("vectors", (10**9, 10**6), dtype=float, chunks=(9, 9)),
            ),
        ),
        (2, lambda file: put("damping", lambda _: 10**15)(file, "")),
        (2, lambda file: put("damping", lambda _: np.bytes_("[" * 10**5))(file, "")),
        (2, lambda file: put("damping", lambda _: np.bytes_("[1]"))(file, "")),
        (2, lambda file: file.pop("shift")),
    ],
)
def test_files_of_attackers_are_one_message(sound, tmp_path, which, change):
    files, _ = sound
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    shutil.copy(files[1], tmp_path / "other.h5")
    with h5py.File(copies[which], "r+") as file:
        change(file)
    reseal(*copies)
    shown = RUNNER.invoke(cli.app, ["verify", *map(str, copies)])
    assert shown.exit_code == 2 and shown.stderr.startswith("error: ") and shown.stderr.count("\n") == 1, shown.output


def test_entries_that_are_there_twice_are_refused(sound, tmp_path):
    files, _ = sound
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    with h5py.File(copies[1], "r+") as file:
        duplicated(file)
    reseal(*copies)
    assert "lemma interface-map fails: a matrix has an entry twice" in morembs_verify.verify(*map(str, copies))[2]


def test_names_cannot_say_what_is_not_proven(sound, tmp_path):
    files, _ = sound
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    with h5py.File(copies[2], "r+") as file:
        given = json.loads(file["damping"][()]) | {"x": 1}
        put("damping", lambda _: np.bytes_(json.dumps(given).replace('"x"', '\n"verified: error <= 0"')))(file, "")
    reseal(*copies)
    assert 'error <= 0"' not in morembs_verify.verify(*map(str, copies))[2]


def test_limits_that_are_no_numbers_prove_nothing(sound, tmp_path):
    files, (certificate,) = sound
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    place = next(iter(h5py.File(copies[0])["bodies"]))
    with h5py.File(copies[0], "r+") as file:
        # The limit of the band holds for cells without one.
        file[f"bodies/{place}/certificate/cell_limit"][...] = np.nan
        file[f"bodies/{place}/certificate/limits/envelope"][1] = 0.99 * certificate.limit.lower
    reseal(*copies)
    assert not morembs_verify.verify(*map(str, copies))[1]


@pytest.mark.parametrize("number", range(10))
def test_random_certificates_are_proven_and_false_ones_are_not(tmp_path, number):
    rng, kinds = np.random.default_rng(number), [TAMPERS[(3 * number + j) % len(TAMPERS)] for j in range(3)]
    for case in cases(20, number, tmp_path):
        assert case.certificate.kind == "proven"
        holds, said = answer(case)
        assert holds, (case.words, said)
        kept = [file.read_bytes() for file in case.files]
        for kind in kinds:
            if tamper(case, kind, rng):
                holds, said = answer(case)
                assert not holds, (case.words, kind)
                assert kind != "mode" or "lemma sturm-count fails" in said
            for file, data in zip(case.files, kept, strict=True):
                file.write_bytes(data)


@pytest.mark.parametrize("shift", [0.3, 1.7123, 4.9371])
def test_negative_eigenvalues_are_counted_front_by_front(shift):
    line = sp.diags_array([2.0, -1.0, -1.0], offsets=[0, 1, -1], shape=(40, 40))
    A = sp.csr_array(sp.kronsum(line, line) - shift * sp.eye_array(1600)).tolil()
    # A frame is coupled with many.
    A[-1, ::7] = A[::7, [-1]] = 0.05
    A = sp.csr_array(A)
    blocks = list(morembs_verify.dissect(abs(sp.csr_array(A != 0)).astype(np.int32), np.arange(1599)))
    assert np.array_equal(np.sort(np.concatenate(blocks)), np.arange(1599)) and max(map(len, blocks)) < 200
    negative, rho = morembs_verify.count_negative(A)
    values = np.linalg.eigvalsh(A.toarray())
    # Whatever the matrix is that was counted, it is no further away.
    assert (values < -rho).sum() <= negative <= (values < rho).sum()
    assert negative == (values < 0).sum() and 0 < rho < 1e-5


def test_a_singular_pivot_is_met_at_another_shift(monkeypatch):
    line = sp.csr_array(sp.diags_array([2.0, -1.0, -1.0], offsets=[0, 1, -1], shape=(40, 40)))
    # The first pivot block is the whole matrix, which is singular at its own eigenvalue.
    shift = float(np.linalg.eigvalsh(line.toarray())[3])
    with pytest.raises(morembs_verify.NotVerifiedError, match="a pivot is too small"):
        morembs_verify.count_negative(sp.csr_array(line - shift * sp.eye_array(40)))
    moved, negative, rho = morembs_verify.count_below(line, shift)
    assert moved == 0.83 * shift and negative == 3 and rho < 1e-12
    with pytest.raises(morembs_verify.NotVerifiedError, match="a pivot is too small"):
        morembs_verify.count_below(sp.csr_array((40, 40)), 0.0)


@pytest.mark.parametrize(
    ("low", "high"), [(0.0, 1e-9), (1.0, 1.0 + 3e-16), (18849.555921538759, 18849.55592153877), (1e5, 3e5)]
)
def test_cells_lie_between_their_centres_and_half_widths(low, high):
    m, h = (Fraction(float(each[0])) for each in morembs_verify.halve_cells(np.array([low]), np.array([high])))
    assert m - h <= Fraction(low) and Fraction(high) <= m + h


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("zeta", [1e-7, 0.02, 1 - 1e-9, 1.0, 1 + 1e-9, 40.0])
@pytest.mark.parametrize("w", [0.0, 0.4, 1.0, 1.0 + 1e-7, 3.0])
def test_solutions_on_cells_are_as_good_as_they_say(zeta, w, coupled):
    # At rest, beside a resonance, critical damping with its double root, and beyond.
    one, two = np.longdouble(2 * zeta), np.longdouble(0.3 * zeta)
    parts = np.array([1.0]), np.array([2 * zeta]), np.array([1.0])
    if coupled:
        parts = np.diag([1.0, 5.0]), np.array([[2 * zeta, 0.3 * zeta], [0.3 * zeta, zeta]]), np.eye(2)
    n = len(parts[0])
    pencil = morembs_verify.Pencil(0.0, *parts, [np.zeros((n, n))] * 3)
    h = 0.1 * float(np.abs(w - pencil.poles()).min())
    x = pencil.solve(np.array([w]), np.array([h]), np.eye(n)[:, :1])
    for t in np.array([-1.0, -0.3, 0.0, 0.7, 1.0], dtype=np.longdouble):
        at = np.longdouble(w) + h * t
        a = (1 - at) * (1 + at) + 1j * at * one
        # What the second mode takes from the first.
        exact = 1 / (a + (at * two) ** 2 / (5 - at * at + 1j * at * zeta)) if coupled else 1 / a
        found = (x.y[0, :, 0, 0].astype(np.clongdouble) * t ** np.arange(x.y.shape[1])).sum()
        # b'A^-1 b - b'y is y'r + r'A^-1 r for what is left, r.
        lost = (x.sizes * x.left).sum() + x.norm[0] * ((x.weights * x.left) ** 2).sum()
        assert abs(found - exact) <= lost < 1e-6 * abs(exact)
        assert abs(exact) <= x.sizes[0, 0] + lost and abs(exact) <= x.norm[0] / (x.weights[0, 0] ** -2) * (1 + 1e-9)


def test_modal_damping_of_vectors_that_are_not_orthonormal_is_covered():
    rng = np.random.default_rng(6)
    values, zeta = np.array([1.0, 9.0, 900.0]), 0.04
    # M = I, K and D diagonal; vectors that are off by a ten-thousandth, and longer than one.
    V = (np.eye(3) + 1e-4 * rng.standard_normal((3, 3))) * [1.0, 1.001, 1.002]
    theta = np.einsum("ip,i,ip->p", V, values, V)
    proof = object.__new__(morembs_verify.Proof)
    proof.theta, proof.ratio, proof.k, proof.alpha, proof.beta, proof.D = theta, zeta, 3, 0.0, 0.0, None
    proof.dK, proof.dM = np.abs(V.T @ (values[:, None] * V) - np.diag(theta)), np.abs(V.T @ V - np.eye(3))
    proof.T = (values[:, None] * V - V * theta) / theta / np.sqrt(values)[:, None]
    proof.tau, proof.lost_T, proof.b = np.linalg.norm(proof.T, axis=0), np.zeros(3), np.ones((3, 1))
    proof.respond(0.0)
    exact = np.abs(V.T @ (2 * zeta * np.sqrt(values)[:, None] * V) - np.diag(2 * zeta * np.sqrt(theta)))
    found = proof.pencil.off[1]
    assert (exact <= found + 1e-15).all() and (found.diagonal() < 4 * exact.diagonal() + 1e-5).all()


def test_what_is_not_covered_is_said(sound):
    said = morembs_verify.verify(*map(str, sound[0]))[2]
    assert said.splitlines()[-1] == morembs_verify.NOT_CHECKED and "block_limit" in said


def job(folder, more="", damping="rayleigh = { alpha = 5.0, beta = 4e-7 }"):
    path = folder / "part.toml"
    path.write_text(
        f"""[model]
mesh = "{MESHES / "beam.msh"}"
units = "mm-t-s"
[[material]]
young = 210e3
poisson = 0.3
density = 7.85e-9
[[interface]]
name = "left"
nodes = "set:TIP"
[damping]
{damping}
[[reduce]]
method = "craig-bampton"
modes = 6
[certify]
band_hz = [0, 3000]
points = 5
witness = true
{more}
[output]
path = "part.h5"
""",
        encoding="utf-8",
    )
    return path


def test_a_job_writes_a_witness_and_the_command_writes_the_same(tmp_path):
    path = job(tmp_path)
    checked = RUNNER.invoke(cli.app, ["check", str(path)])
    assert checked.exit_code == 0 and "size of the witness" in checked.stdout, checked.output
    (forecast,) = json.loads(RUNNER.invoke(cli.app, ["check", str(path), "--json"]).stdout)
    shown = RUNNER.invoke(cli.app, ["reduce", str(path), "--json"])
    assert shown.exit_code == 0, shown.output
    files = [str(tmp_path / name) for name in ("part.h5", "part.model.h5", "part.witness.h5")]
    assert not any("witness" in sentence for sentence in forecast["warnings"])
    # Within a factor of two.
    assert 0.5 < Path(files[2]).stat().st_size / forecast["witness_bytes"] < 2
    shown = RUNNER.invoke(cli.app, ["verify", *files])
    assert shown.exit_code == 0 and VERIFIED.search(shown.stdout), shown.output
    again = tmp_path / "again.h5"
    made = RUNNER.invoke(cli.app, ["certify", files[0], "--model", files[1], "--witness", str(again), "--json"])
    assert made.exit_code == 0 and json.loads(made.stdout)[0]["written"] == [str(again)], made.output
    assert again.read_bytes() == Path(files[2]).read_bytes()
    # A job that reads its model file takes that one.
    text = path.read_text(encoding="utf-8")
    other = tmp_path / "other.toml"
    text = re.sub(r'mesh = ".*"', f'file = "{files[1]}"', text).replace("part.h5", "other.h5")
    other.write_text(re.sub(r"\[\[material\]\]\n(\w+ = .*\n)+", "", text), encoding="utf-8")
    assert RUNNER.invoke(cli.app, ["reduce", str(other)]).exit_code == 0
    assert not (tmp_path / "other.model.h5").exists()
    files = [str(tmp_path / "other.h5"), files[1], str(tmp_path / "other.witness.h5")]
    assert RUNNER.invoke(cli.app, ["verify", *files]).exit_code == 0


@pytest.mark.parametrize(
    ("more", "damping", "words"),
    [
        ("bound = false", "modal = 0.01", "witness = true was given with bound = false"),
        ("", "modal = [[0, 0.01], [1000, 0.02]]", "a modal damping table that jumps"),
    ],
)
def test_what_is_not_proven_has_no_witness(tmp_path, more, damping, words):
    shown = RUNNER.invoke(cli.app, ["check", str(job(tmp_path, more, damping))])
    assert shown.exit_code == 2 and words in " ".join(shown.stderr.split())


def test_files_that_cannot_be_read_are_told(sound, tmp_path):
    files, _ = sound
    shown = RUNNER.invoke(cli.app, ["verify", str(files[0]), str(files[1]), str(tmp_path / "none.h5")])
    assert shown.exit_code == 2 and "error:" in shown.stderr and "Traceback" not in shown.output
    made = RUNNER.invoke(cli.app, ["certify", str(files[0]), "--model", str(files[1]), "--witness", "w.h5"])
    assert made.exit_code == 2 and "has no record of the damping" in " ".join(made.stderr.split())


def with_damper(folder, size):
    # A damper to the ground and some of the stiffness, with more dofs than the space of the reference has.
    files = tuple(folder / f"{name}.h5" for name in ("body", "model", "witness"))
    model = beam_of_blocks((16, 2, 2))
    row = model.dofs.of_nodes(where(model, 0, 0.5)[:1])[0][2]
    v = sp.csr_array((np.ones(1), ([row], [0])), shape=(model.size, 1))
    model = replace(model, D=sp.csr_array(size * (v @ v.T) + 1e-6 * model.K))
    with Problem(model, ends(model)) as problem:
        body = FreeInterface(modes=8).reduce(problem)
        (certificate,) = certify(problem, [body], BAND, points=5)
        write_body(files[0], [elastic_body(problem, body, make_part(problem), certificate)])
        write_model(files[1], problem.model)
        write_witness(files[2], problem, BAND, body=files[0], model=files[1])
        at = [limit.at_hz for limit in certificate.limits.values()]
        exact = dense_errors(problem, body, BAND, at)[1][:, 0].max() if size < 0 else np.nan
    return files, certificate, exact


@pytest.fixture(scope="module")
def dashpot(tmp_path_factory):
    return with_damper(tmp_path_factory.mktemp("dashpot"), 300.0)[:2]


def test_a_damper_that_drives_has_limits_of_its_response_but_none_of_its_stability(tmp_path):
    files, certificate, exact = with_damper(tmp_path, -30.0)
    assert certificate.kind == "estimate" and "drives some motions" in certificate.notes[0]
    _, proven, said = morembs_verify.verify(*map(str, files))
    assert proven and 0.9 * certificate.limit.upper < exact < certificate.limit.upper, said
    assert "not checked" in said.splitlines()[-1] and "stability" in said.splitlines()[-1]


@pytest.mark.parametrize("size", [3e6, 3e13])
def test_a_damper_that_holds_its_dof_is_named(tmp_path, size):
    with pytest.raises(SolverError) as refusal:
        with_damper(tmp_path, size)
    # The number is what a user looks for in the deck.
    assert f"{size:.1e} N s/m" in str(refusal.value)


def test_limits_of_a_model_with_dashpots_are_proven_again(dashpot):
    files, certificate = dashpot
    found = []
    belongs, proven, said = morembs_verify.verify(*map(str, files), found)
    assert certificate.kind == "proven" and belongs and proven, said
    with h5py.File(files[2]) as file:
        n, q = file["solutions"].shape
        assert q == 2 * file["vectors"].shape[1] < n
    assert (found[0] > 0.9).all() and (found[0] <= 1).all()


@pytest.mark.parametrize(
    ("which", "change", "lemma"),
    [
        (0, put(LIMITS + "envelope", scaled(0.97, 1)), CELLS),
        (1, put("matrices/D/data", scaled(1.5, slice(None))), CELLS),
        (1, lambda file, _: file["matrices"].pop("D"), "ritz-values"),
        (1, put("matrices/D/data", scaled(1.01, 5)), "interface-map"),
        (2, put("solutions", scaled(0.0, slice(None))), CELLS),
        (2, put("coefficients", lambda value: -value), CELLS),
        (2, put("damping", lambda value: np.bytes_(value.replace(b'"modal": 0.0', b'"modal": 0.1'))), "damping"),
    ],
)
def test_false_limits_of_dashpots_are_refused_by_their_lemma(dashpot, tmp_path, which, change, lemma):
    refuse_changed(dashpot[0], tmp_path, which, change, lemma)


def test_damping_that_couples_the_vectors_with_the_complement_counts(dashpot, tmp_path):
    # u v' + v u' with V'u = 0 adds nothing to V'D V; 1e3 N s/m of it change the response by an eighth of its peak.
    files, certificate = dashpot
    copies = [Path(shutil.copy(file, tmp_path)) for file in files]
    with h5py.File(files[2]) as file:
        V = file["vectors"][...]
    model = read_model(files[1])
    with Problem(model, ends(model)) as problem:
        T = problem.coupling.T.tocsc()
        free = np.flatnonzero(np.diff(T.indptr) == 1)
        u = np.random.default_rng(3).standard_normal(len(free))
        u -= V[free] @ np.linalg.lstsq(V[free], u)[0]
        v = T[:, free] @ V[free, 5]
        u = T[:, free] @ (u / np.linalg.norm(u))
        coupled = sp.csr_array(1e3 * (np.outer(u, v) + np.outer(v, u)))
        omega = 2 * np.pi * np.linspace(*BAND, 60)[1:]
        H = [dense_response(problem, omega, (T.T @ D @ T).toarray()) for D in (model.D, model.D + coupled)]
    off = np.linalg.norm(H[1] - H[0], axis=(1, 2)).max() / np.linalg.norm(H[0], axis=(1, 2)).max()
    assert off > 100 * certificate.limits["peak"].upper
    write_model(copies[1], replace(model, D=model.D + coupled))
    reseal(*copies)
    _, proven, said = morembs_verify.verify(*map(str, copies))
    assert not proven and f"lemma {CELLS} fails" in said, said


@pytest.mark.parametrize("number", range(3))
def test_random_dashpots_are_proven_and_false_ones_are_not(tmp_path, number):
    rng = np.random.default_rng(number)
    for case in cases(21, number, tmp_path, own=1.0):
        assert case.certificate.kind == "proven" and case.problem.D is not None
        holds, said = answer(case)
        assert holds, (case.words, said)
        kept = [file.read_bytes() for file in case.files]
        for kind in ("limit", "damping", "no damping"):
            if tamper(case, kind, rng):
                assert not answer(case)[0], (case.words, kind)
            for file, data in zip(case.files, kept, strict=True):
                file.write_bytes(data)


def test_a_gyroscopic_matrix_has_no_witness(tmp_path):
    with beam(Damping()) as problem:
        n = problem.model.size
        G = sp.csr_array((np.array([1.0, -1.0]), ([0, 1], [1, 0])), shape=(n, n))
        own = replace(problem.model, G=G)
        with Problem(own, problem.interfaces) as spun, refusal("unsupported", "witness"):
            write_witness(tmp_path / "w.h5", spun, BAND, body=tmp_path, model=tmp_path)


def test_lemmas_have_sections():
    lemmas = set(re.findall(r'"([a-z]+(?:-[a-z]+)+)"', PROGRAM.read_text(encoding="utf-8"))) | {"damping"}
    pages = sorted(DOCS.parent.glob("verification*.md"))
    headings = {name for page in pages for name in re.findall(r"(?m)^### (\S+)$", page.read_text(encoding="utf-8"))}
    assert {"sturm-count", "cells-of-the-band"} <= lemmas <= headings
