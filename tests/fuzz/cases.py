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
from tests.fuzz.stage import (
    MESH,
    MODAL,
    OUTPUT,
    bar,
    case,
    end_of,
    expect,
    gives,
    mass_of,
    refused,
    write_job,
    write_mesh,
)
from tests.fuzz.stage import run as run
from tests.fuzz.trials import Folder


@case
def link_retargeted_between_batches(place: Folder) -> None:
    end = write_mesh(place, "one.vtk", bar())
    write_mesh(place, "two.vtk", bar(2.0))
    link = place.place / "part.vtk"
    link.symlink_to("one.vtk")
    write_job(place, MESH.format(name="part.vtk"), end, MODAL, OUTPUT)
    if not gives(place, "batch", "job.toml", "--jobs", "1", "--quiet"):
        return
    before = mass_of(place)
    link.unlink()
    link.symlink_to("two.vtk")
    del place.sums["part.vtk"]
    if gives(place, "batch", "job.toml", "--jobs", "1", "--quiet"):
        expect(
            place, abs(mass_of(place) / before - 8) < 1e-6, "the body is that of the mesh that the link led to before"
        )


@case
def companion_of_a_mesh_as_output(place: Folder) -> None:
    end = write_mesh(place, "part.xdmf", bar())
    write_job(place, MESH.format(name="part.xdmf"), end, MODAL, '[output]\npath = "part.h5"\n')
    refused(place, "reduce", "job.toml")


@case
def job_that_init_proposes_for_a_mesh_with_a_companion(place: Folder) -> None:
    end = write_mesh(place, "part.xdmf", bar())
    place.seal()
    if gives(place, "init", "part.xdmf", "-o", "job.toml"):
        proposed = (place.place / "job.toml").read_text()
        (place.place / "job.toml").write_text(proposed.replace("[[reduce]]", end + "[[reduce]]", 1))
        place.run(["reduce", "job.toml"])


@case
def import_onto_the_companion_of_its_mesh(place: Folder) -> None:
    write_mesh(place, "part.xdmf", bar())
    place.seal()
    refused(place, "import", "part.xdmf", "--material", "young=2e11,poisson=0.3,density=7850", "-o", "part.h5")


@case
def include_of_a_deck_as_output(place: Folder) -> None:
    solid = bar()
    rows = [f"{k}, " + ", ".join(repr(float(c)) for c in x) for k, x in enumerate(solid.xyz, 1)]
    (place.place / "nodes.h5").write_text("*NODE\n" + "\n".join(rows) + "\n")
    cells = [f"{k}, " + ", ".join(str(n + 1) for n in cell) for k, cell in enumerate(solid.cells, 1)]
    text = ["*INCLUDE, INPUT=nodes.h5", "*ELEMENT, TYPE=C3D8, ELSET=ALL", *cells]
    (place.place / "part.inp").write_text("\n".join(text) + "\n")
    mesh = MESH.format(name="part.inp").replace("[[material]]", 'dialect = "calculix"\n[[material]]')
    write_job(place, mesh, end_of(solid), MODAL, '[output]\npath = "nodes.h5"\n')
    refused(place, "reduce", "job.toml")


@case
def nul_in_the_output_path(place: Folder) -> None:
    end = write_mesh(place, "part.vtk", bar())
    write_job(place, MESH.format(name="part.vtk"), end, MODAL, '[output]\npath = "a\\u0000b.h5"\n')
    refused(place, "reduce", "job.toml")


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
