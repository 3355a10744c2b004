"""Named jobs of defects that were found, which run before all others.

Each fills a folder, runs command lines, and says what must hold; the folder itself sees to inputs, warnings and
tracebacks, as it does for random jobs.
"""

from __future__ import annotations

import io
import warnings
import zipfile

import h5py
import numpy as np

# Their cases are in the register once they are imported.
from tests.fuzz import model_cases as model_cases
from tests.fuzz.stage import CASES as CASES
from tests.fuzz.stage import MESH, MODAL, OUTPUT, bar, case, gives, refused, write_job, write_mesh
from tests.fuzz.stage import run as run
from tests.fuzz.trials import Folder


@case
def immense_wrench(place: Folder) -> None:
    end = write_mesh(place, "part.vtk", bar())
    write_job(
        place,
        MESH.format(name="part.vtk"),
        end,
        MODAL,
        OUTPUT,
        "[preload]\nwrench = { end = [1e300, 0, 0, 0, 0, 0] }\n",
    )
    refused(place, "reduce", "job.toml")


@case
def immense_acceleration(place: Folder) -> None:
    end = write_mesh(place, "part.vtk", bar())
    table = '[preload]\nacceleration = [0, 0, 1e308]\nheld = ["end"]\n'
    write_job(place, MESH.format(name="part.vtk"), end, MODAL, OUTPUT, table)
    refused(place, "reduce", "job.toml")


@case
def matrix_twice_in_one_archive(place: Folder) -> None:
    def array(A: np.ndarray) -> bytes:
        buffer = io.BytesIO()
        np.save(buffer, A)
        return buffer.getvalue()

    with warnings.catch_warnings(), zipfile.ZipFile(place.place / "part.npz", "w") as file:
        warnings.simplefilter("ignore")
        for name, A in (("K", np.eye(3)), ("M", np.eye(3)), ("K", 4 * np.eye(3))):
            file.writestr(f"{name}.npy", array(A))
    place.seal()
    refused(place, "import", "part.npz", "-o", "part.model.h5")


@case
def stiffness_of_a_body_times_four(place: Folder) -> None:
    end = write_mesh(place, "part.vtk", bar())
    write_job(place, MESH.format(name="part.vtk"), end, MODAL, OUTPUT)
    if not gives(place, "reduce", "job.toml"):
        return
    with h5py.File(place.place / "body.h5", "r+") as file:
        del file["checksums"]
        file["bodies/modal/stiffness_matrix"][...] *= 4
    for target in ("statespace", "matrix-market", "c", "sid"):
        refused(place, "export", "body.h5", "--to", target)
