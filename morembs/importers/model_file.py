"""The model file that ``morembs import`` writes and jobs read. HDF5, SI units: docs/reference/formats/model_file.md.

The reader of the file itself is ``morembs.importers.native``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from morembs.base import progress
from morembs.base.arguments import check_value
from morembs.base.errors import InputError, OverwriteError
from morembs.fem import FEModel
from morembs.fem.model_terms import ModelTerms
from morembs.importers.native import FORMAT, MODEL, ModelFile, import_native
from morembs.importers.to_model import model_of
from morembs.importers.tolerances import TOL
from morembs.storage.contents import own_files
from morembs.storage.hdf5 import holds_format
from morembs.storage.writer import writing

# What makes a model of something else.
_MODELS = {"Deck": "deck.to_model(units)", "Mesh": "assemble(mesh, materials)"}


def write_model(
    path: str | Path,
    model: FEModel,
    *,
    files: Sequence[Path] = (),
    importer: str = "",
    units: str = "",
    findings: Sequence[str] = (),
    terms: ModelTerms | None = None,
) -> Path:
    """Write a model (SI); an interrupted or failed run leaves the old file or none.

    A model file of that name is replaced, any other file is kept.

    Args:
        files: sources of the model; their names and SHA-256 are kept.
        importer: the name of the format they were read as, ``units`` their units.
        findings: sentences of the examination.
        terms: those of a model with parameters, of which ``model`` is that of nominal values.

    Raises:
        InputError: something else than a model, or a source file that cannot be read.
        OverwriteError: ``path`` is a file of another kind, such as the deck that the model was read from.
        OutputError: the file cannot be written.

    >>> write_model("bar.model.h5", model).name
    'bar.model.h5'
    """
    check_value("write_model: path", path, str | Path)
    if not isinstance(model, FEModel):
        kind = type(model).__name__
        raise InputError(
            f"a {kind} was given; expected a model: {_MODELS.get(kind, 'import_model(path)')}", keyword="model"
        )
    target = Path(path)
    with own_files():
        is_other = target.is_file() and target.stat().st_size > 0 and not is_model_file(target)
    if is_other:
        raise OverwriteError(f"{path} is there and is no model file, so it was kept; give the model another name")
    return save_model(target, model, files=files, importer=importer, units=units, findings=findings, terms=terms)


def save_model(
    target: Path,
    model: FEModel,
    *,
    files: Sequence[Path] = (),
    importer: str = "",
    units: str = "",
    findings: Sequence[str] = (),
    terms: ModelTerms | None = None,
) -> Path:
    """As ``write_model``, in place of whatever file is there."""
    progress.stage(f"writing {target.name}")
    content = ModelFile(
        model=model,
        files=tuple(file.name for file in files),
        sha256=tuple(map(sha256, files)),
        importer=importer or "none",
        units=units or "m-kg-s",
        findings=tuple(findings),
        terms=terms,
    )
    with writing(target) as out:
        out.rows("", MODEL, content)
    return target


def read_model(path: str | Path) -> FEModel:
    """The model of a native file, bit by bit as it was written. Peak memory: that of the matrices.

    Args:
        path: model file.

    Raises:
        InputError: no such file, another kind of file, one of a newer version, or one that is damaged.

    >>> read_model(write_model("bar.model.h5", model)).size == model.size
    True
    """
    check_value("read_model: path", path, str | Path)
    if holds_format(Path(path), "morembs-body"):
        raise InputError(
            f"{path} is a body file, the result of a reduction; expected a model file: give what morembs import wrote",
            kind="unsupported",
            keyword=Path(path).name,
        )
    return model_of(import_native(Path(path)))


def is_model_file(path: Path) -> bool:
    """True if ``path`` is a model file of ours, sound or not."""
    return holds_format(path, FORMAT)


def sha256(path: Path) -> str:
    """Checksum of a file in hexadecimal digits.

    Raises:
        InputError: it cannot be read.
    """
    total = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(TOL.hashed_bytes):
                total.update(block)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}); check the path", kind="file", keyword=Path(path).name
        ) from error
    return total.hexdigest()
