"""Matrix Market files (.mtx, .mtx.gz): one matrix each."""

from __future__ import annotations

from pathlib import Path

import scipy.io

from morembs.errors import InputError
from morembs.imported import Imported
from morembs.importers.named import square_csr


def import_matrix_market(path: Path) -> Imported:
    """The matrix of the file, as K: real, complex or pattern-free, general, symmetric, skew or Hermitian.

    Raises:
        InputError: not such a file, cut off, or a matrix that is not square.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            packed = file.read(2) == b"\x1f\x8b"
            file.seek(0)
            if not packed and not file.read(14).lower().startswith(b"%%matrixmarket"):
                raise InputError(f"{path.name} does not begin with %%MatrixMarket; expected a Matrix Market file")
        if scipy.io.mminfo(path)[4] == "pattern":
            raise InputError(f"{path.name} holds a pattern without values; expected real or complex values")
        matrix = scipy.io.mmread(path)
    except InputError:
        raise
    except (OSError, ValueError, TypeError, OverflowError, IndexError, EOFError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{path.name} cannot be read as a Matrix Market file ({reason}); write it again") from error
    return Imported(source=path.name, K=square_csr(path.name, "the matrix", matrix))
