"""Checksums in files: what they are, what they find, and that damage of any byte is found or changes nothing."""

import hashlib
import random
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.base.errors import InputError
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.body.floating.frame import floating_frame
from morembs.body.stress_shapes import stress_recovery
from morembs.body.vtkhdf_series import read_grid, stored_recovery
from morembs.dynamics.gmp.checkpoint import Checkpoint
from morembs.fem.interface import make_interface
from morembs.importers.model_file import read_model, write_model
from morembs.problem import Problem
from morembs.reducers import CraigBampton
from morembs.storage.checksums import Checksums, seal
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal


@pytest.fixture(scope="module")
def body(tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = steel(box("hex8", (2, 1, 1), (0.4, 0.05, 0.04)))
    faces = [make_interface(model, name=n, nodes=where(model, 0, x)) for n, x in (("root", 0.0), ("tip", 0.4))]
    with Problem(model, faces) as problem:
        reduced = CraigBampton(modes=2).reduce(problem, "cb")
        part = elastic_body(problem, reduced, make_part(problem), floating=floating_frame(problem, reduced))
        part = replace(part, recovery=stress_recovery(problem, reduced))
        return write_body(tmp_path_factory.mktemp("body") / "beam.h5", [part], provenance={"checksums": {"names": 1}})


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_model(tmp_path_factory.mktemp("model") / "a.model.h5", steel(box("hex8", (1, 1, 1), (0.1, 0.1, 0.1))))


def rows(group: Any) -> dict[str, str]:
    names, sums = (group[f"checksums/{part}"].asstr()[()].tolist() for part in ("names", "sha256"))
    return dict(zip(names, sums, strict=True))


def expected(item: Any, by_columns: bool) -> str:
    """As docs/reference/schema/conventions.md says it."""

    def kind(value: Any) -> bytes:
        return f"{value.dtype.kind}{value.dtype.itemsize} {value.shape}\n".encode()

    words = kind(item) if isinstance(item, h5py.Dataset) else b"group\n"
    for name in sorted(item.attrs):
        value = np.asarray(item.attrs[name])
        words += name.encode() + b" " + kind(value) + value.tobytes()
    if isinstance(item, h5py.Dataset) and not by_columns:
        words += item[()].tobytes()
    return hashlib.sha256(words).hexdigest()


def test_sums_are_those_of_the_documentation(body: Path, model: Path) -> None:
    for path in (body, model):
        with h5py.File(path) as file:
            sums, columns = rows(file), 0
            for name, held in sums.items():
                above, _, number = name.rpartition("/")
                if name in file:
                    assert held == expected(file[name], f"{name}/0" in sums), name
                else:
                    values, columns = file[above][:, int(number)], columns + 1
                    assert (
                        held
                        == hashlib.sha256(
                            f"f{values.itemsize} {values.shape}\n".encode() + values.tobytes()
                        ).hexdigest()
                    )
            every: list[str] = []
            file.visititems(lambda name, item, every=every: every.append(name) if hasattr(item, "shape") else None)
            outside = {name for name in every if not name.startswith(("checksums/", "provenance/"))}
            assert outside <= set(sums) and {name.split("/")[0] for name in sums}.isdisjoint({"provenance"})
            # Basis; stress and jumps of the coordinates; stress, jumps and displacements of the static correction.
            assert columns == (3 * 14 + 3 * 12 if path is body else 0)
    assert read_body(body, whole=True).provenance["checksums_"] == {"names": 1}
    assert "checksums" not in read_body(body).provenance


def test_files_without_their_checksums_are_read_with_a_warning(body: Path, model: Path, tmp_path: Path) -> None:
    """Files of 0.1, which had none, are read without a word."""
    for source, read, mark in ((body, read_body, "check/warnings"), (model, read_model, "source/warnings")):
        path = Path(shutil.copy(source, tmp_path))
        assert not any("checksums" in warning for warning in read(path).warnings)
        with h5py.File(path, "r+") as file:
            del file["checksums"]
        assert [f"{path.name} has no group checksums" in warning for warning in read(path).warnings][-1:] == [True]
        with h5py.File(path, "r+") as file:
            del file[mark]
        assert not any("checksums" in warning for warning in read(path).warnings)


def used(path: Path) -> list[Any]:
    """All that a body file holds."""
    stored = read_body(path)
    part = stored.bodies["cb"]
    recovery, grid = stored_recovery(path, "cb"), read_grid(path)
    return [stored, part.basis(), vars(recovery), vars(grid)]


def changed(value: Any) -> Any:
    """Another value of the same kind that no other check would mind."""
    value = np.array(value)
    if value.dtype.kind == "f":
        return np.nextafter(value, np.inf)
    return value[::-1].copy() if value.ndim else value


def test_the_least_change_is_named(body: Path, tmp_path: Path) -> None:
    path = tmp_path / "bad.h5"
    names = (
        "bodies/cb/stiffness_matrix",
        "bodies/cb/basis",
        "bodies/cb/recovery/stress",
        "nodes/ids",
        "bodies/cb/floating_frame/integrals/C4",
        "nodes/coordinates",
        "VTKHDF/Connectivity",
    )
    for name in names:
        shutil.copy(body, path)
        with h5py.File(path, "r+") as file:
            file[name][...] = changed(file[name][()])
        with refusal("file", "bad.h5", name):
            used(path)
        result = CliRunner().invoke(app, ["info", str(path)])
        assert (
            result.exit_code == 2 and len(result.stderr.strip().splitlines()) == 1 and "Traceback" not in result.stderr
        )
        assert "remove the group /checksums" in result.stderr
        with h5py.File(path, "r+") as file:
            seal(file, excluded=["provenance"])
        used(path)


def test_units_and_missing_parts_are_named(body: Path, tmp_path: Path) -> None:
    def units(file: Any) -> None:
        file["nodes/coordinates"].attrs["units"] = np.bytes_("mm")

    def created(file: Any) -> None:
        file["provenance/created"][()] = b"2"

    changes: dict[str, Callable[[Any], None]] = {
        "/nodes/coordinates": units,
        "/bodies/cb/floating_frame/De": lambda file: file.__delitem__("bodies/cb/floating_frame"),
        "/bodies/cb/recovery/correction": lambda file: file.__delitem__("bodies/cb/recovery/correction"),
        "/provenance/created /provenance/checksums": created,
        "/checksums cannot be read": lambda file: file.__delitem__("checksums/sha256"),
    }
    for words, change in changes.items():
        path = shutil.copy(body, tmp_path / "bad.h5")
        with h5py.File(path, "r+") as file:
            change(file)
        with refusal("file", "bad.h5", *words.split()):
            read_body(path)


def test_other_layouts_of_the_same_values_pass(body: Path, tmp_path: Path) -> None:
    """Packed, in other pieces, or with the highest byte first; and files of others, who write no checksums."""
    path = shutil.copy(body, tmp_path / "other.h5")
    with h5py.File(path, "r+") as file:
        for name in ("bodies/cb/basis", "bodies/cb/mass_matrix", "nodes/ids"):
            item = file[name]
            values, attributes = item[()], dict(item.attrs)
            del file[name]
            new = file.create_dataset(
                name, data=values, dtype=item.dtype.newbyteorder(">"), compression="gzip", chunks=values.shape
            )
            new.attrs.update(attributes)
    read_body(path, whole=True)
    assert np.array_equal(used(path)[1], used(body)[1])
    with h5py.File(path, "r+") as file:
        del file["checksums"]
    read_body(path, whole=True)
    with h5py.File(path, "r+") as file:
        file["bodies/cb/mass_matrix"][0, 0] *= 2
    with refusal("file", "other.h5"):
        read_body(path)


def plain(value: Any) -> Any:
    """What two readings of one file must share."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if hasattr(value, "indptr"):
        return [plain(part) for part in (value.data, value.indices, value.indptr)]
    if not hasattr(value, "__dict__") or callable(value):
        return repr(type(value) or value)
    # A body knows its file, which has the body.
    return plain({name: inner for name, inner in vars(value).items() if name != "file"})


@pytest.mark.parametrize("kind", ["body", "model", "equilibria"])
def test_any_damaged_byte_is_found_or_changes_nothing(
    request: pytest.FixtureRequest, tmp_path: Path, kind: str
) -> None:
    def equilibria(path: Path) -> Any:
        held = Checkpoint(path, signature=np.arange(3.0), options="all")
        return [held.reach, held.notes, held.equilibria]

    read: Callable[[Path], Any] = {"body": used, "model": read_model, "equilibria": equilibria}[kind]
    path = tmp_path / f"{kind}.h5"
    if kind == "equilibria":
        checkpoint = Checkpoint(path, signature=np.arange(3.0), options="all")
        checkpoint.begin(0.4, ("a note",))
        checkpoint.add((1, 2, 0, 1), X=np.ones(4), W=2.0, moments=np.ones(2), modes=np.ones((4, 2)))
        checkpoint.save()
    else:
        shutil.copy(request.getfixturevalue(kind), path)
    whole, first, chance, refused = path.read_bytes(), plain(read(path)), random.Random(7), 0
    for _ in range(25):
        at = chance.randrange(len(whole))
        path.write_bytes(whole[:at] + bytes([whole[at] ^ chance.randrange(1, 256)]) + whole[at + 1 :])
        try:
            assert plain(read(path)) == first, at
        except InputError:
            refused += 1
    assert refused > 5


def test_files_without_a_table_have_nothing_to_compare(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = np.ones(3)
        Checksums("a.h5", file).verify()
        seal(file)
        assert list(rows(file)) == ["x"]
        file["x"][0] = 2
        with refusal("file", "a.h5"):
            Checksums("a.h5", file).verify()
