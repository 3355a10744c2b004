"""Decks that MYSTRAN assembles: K and M of its elements, with couplings, springs and masses of the own reader."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import Positive, PositiveCount
from morembs.base.options import list_options
from morembs.base.types import Floats, Ints
from morembs.fem import DofMap, rigid_motion
from morembs.fem.constraints import Equations
from morembs.fem.handedness import right_handed
from morembs.fem.material import Material
from morembs.importers.abaqus.importer import read_abaqus_deck
from morembs.importers.ansys.cdb import read_ansys
from morembs.importers.decks.join import couplings_of, join
from morembs.importers.decks.labels import in_ranges
from morembs.importers.decks.materials import complete, find_lacking, problems_of_solids
from morembs.importers.decks.missing_middles import with_middles
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import Boundary, deck_options, lacking_problems
from morembs.importers.decks.problems import Problems
from morembs.importers.engines.mystran.cards import KNOWN, MystranText, lacked_elements, unscale
from morembs.importers.engines.mystran.program import Mystran, cores, mystran_path
from morembs.importers.engines.mystran.rotations import turning, with_springs
from morembs.importers.imported import Imported, nodes_of
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.importer import deck_of
from morembs.importers.nastran.restraints import held_equations
from morembs.importers.tolerances import TOL


def import_with_mystran(
    path: str | Path,
    *,
    format: str = "nastran",
    executable: str = "",
    density: float | dict[str, float] | None = None,
    skip: list[str] | str = "",
    boundary: str = "drop",
    timeout: float = TOL.engine_seconds,
    keep_files: str = "",
    grids: int = TOL.run_grids,
    jobs: int | None = None,
    allow_includes_outside: bool = False,
    dialect: str = "auto",
    contact: str = "refuse",
    materials: tuple[Material, ...] = (),
) -> Imported:
    """A deck as MYSTRAN assembles it, in the units of the file, along the basic axes.

    Args:
        format: "nastran", "abaqus" or "ansys".
        executable: the path of MYSTRAN; "" looks for it.
        density: of materials without one (before WTMASS), or set -> density, "all" standing for all.
        skip: cards to leave out, although stiffness or mass may depend on them.
        boundary: "drop" what SPC and PS hold, for a free body, or "keep" it.
        timeout: seconds for each run of MYSTRAN.
        keep_files: a folder for what MYSTRAN read and wrote.
        grids: of one run of MYSTRAN at most.
        jobs: runs at once; None for as many as there are cores.
        allow_includes_outside: INCLUDE may name files beyond the folder of the file.
        dialect: of an Abaqus deck, the program that it was written for.
        contact: of a deck of another program, "refuse" contact, "skip" it, or "tie" it.
        materials: of sets whose materials are not there or give no mass, or "all" of these.

    Peak memory: the entries of K and M several times, and what the runs at once take.

    Raises:
        DeckError: all that keeps the deck from becoming a model.
        InputError: no MYSTRAN, options that are not known, or a run that fails.
    """
    program = mystran_path(executable)
    check_value("--boundary", boundary, Boundary)
    check_value("--engine-timeout", timeout, Positive)
    check_value("grids", grids, PositiveCount)
    check_value("jobs", jobs, PositiveCount | None)
    keep = Path(keep_files) if keep_files else None
    reading = {"density": density, "skip": skip, "allow_includes_outside": allow_includes_outside}
    options = {**reading, "dialect": dialect, "contact": contact}
    deck = _Deck(Path(path), format, options, materials, is_held=boundary == "keep")
    with Mystran(
        program=program,
        file=deck.deck.name,
        blocks=deck.blocks,
        properties=deck.text.properties,
        ids=deck.deck.ids,
        xyz=deck.deck.xyz,
        seconds=timeout,
        jobs=jobs or cores(),
        keep=keep,
    ) as mystran:
        K, M = mystran.matrices(grids)
        return deck.convert(K, M, mystran.version)


def readable_by_mystran(
    path: Path,
    *,
    density: dict[str, float] | None = None,
    skip: list[str] | str = "",
    allow_includes_outside: bool = False,
    dialect: str = "auto",
    contact: str = "refuse",
    format: str = "nastran",
    materials: tuple[Material, ...] = (),
) -> None:
    """True if a deck can be written for MYSTRAN; it is not run.

    Raises:
        InputError: it cannot.
    """
    reading = {"density": density, "skip": skip, "allow_includes_outside": allow_includes_outside}
    _Deck(path, format, {**reading, "dialect": dialect, "contact": contact}, materials, is_held=False)


def _read(path: Path, format: str, options: Mapping[str, Any], *, is_held: bool) -> tuple[Deck, tuple[str, ...]]:
    """A deck of a format, and what its text warns of beside it.

    Raises:
        InputError: options that the format does not have, or supports that are not read.
    """
    if format == "nastran":
        other = "contact" if options["contact"] != "refuse" else "dialect" if options["dialect"] != "auto" else ""
        if other:
            raise InputError(
                f"--{other} was given with --engine mystran, and bulk data have none; leave it out", kind="conflict"
            )
        own = deck_options(options["density"], "refuse", options["skip"])
        bulk = Bulk(path, outside=options["allow_includes_outside"], options=own)
        return deck_of(bulk, is_held=is_held), bulk.text.warnings
    read: Callable[..., Deck] = {"abaqus": read_abaqus_deck, "ansys": read_ansys}[format]
    deck = read(path, **{key: value for key, value in options.items() if key in list_options(read)})
    if is_held and not len(deck.supports.nodes):
        raise InputError(
            f"--boundary keep was given for {path.name}, whose supports are not read; leave it out, and hold the model "
            "by [[interface]] of a job",
            kind="unsupported",
            keyword="boundary",
        )
    return deck, ()


class _Deck:
    """A deck as far as it is read without MYSTRAN; what is wrong with it is refused in one message."""

    def __init__(
        self, path: Path, format: str, options: Mapping[str, Any], materials: Sequence[Material], *, is_held: bool
    ) -> None:
        deck, self.warnings = _read(path, format, options, is_held=is_held)
        problems = Problems(deck.name, deck.options.flags)
        of_elements = [part.problem for part in deck.elements if part.problem]
        problems.entries = [problem for problem in deck.problems if problem not in of_elements]
        problems.entries += lacked_elements(deck)
        with problems.ending():
            self.deck, self.is_held = complete(with_middles(deck), materials), is_held
            self._mesh()
            problems.entries += problems_of_solids(self.deck, materials)
            without = self._without_mass(problems)
            refused = {problem.keyword for problem in problems.entries}
            parts = tuple(
                part for part in self.deck.elements if (part.kind, part.shape) in KNOWN and part.code not in refused
            )
            self.text = MystranText(unscale(replace(self.deck, elements=parts)), problems=problems, without=without)
        problems.refuse()
        self.blocks = self.text.blocks
        if not self.blocks:
            raise InputError(
                f"{deck.name} has no elements that MYSTRAN assembles; expected solids, shells, beams, rods",
                kind="missing",
            )

    def _mesh(self) -> None:
        """Nodes of the model, those of solids first, and the mesh of these."""
        deck = self.deck
        structures = [part for part in deck.elements if part.kind not in ("solid", "point", "none")]
        tied = couplings_of(deck)
        none = np.empty(0, dtype=np.int64)
        solids = join(deck, np.concatenate([none, nodes_of(tied.ties), *(part.nodes.ravel() for part in structures)]))
        self.labels, self.row, self.mesh = solids.labels, solids.row, solids.mesh
        self.notes = [*deck.notes, *solids.notes, *deck.remarks]
        self.whole = tied.on_rows(lambda labels: solids.labels.rows(labels, "couplings name"))
        if self.mesh is not None:
            self.mesh = right_handed(replace(self.mesh, warnings=()))
        sets = dict(solids.nodes.sets)
        for section in deck.sections:
            own = [part.nodes[in_ranges(part.ids, deck.ranges(section.set))].ravel() for part in structures]
            members = np.unique(np.concatenate([none, *own]))
            if section.kind != "solid" and len(members) and section.set not in sets:
                sets[section.set] = np.sort(self.row[self.labels.rows(members, "elements name")])
        self.nodes = replace(solids.nodes, sets=sets)

    def _without_mass(self, problems: Problems) -> set[str]:
        """Sets of shells, beams and trusses without stiffness. Sets without stiffness or mass are problems; bars of
        bulk data without mass are a warning where something else has some."""
        deck = self.deck
        kinds = {own.set: own.kind for own in deck.sections}
        lacking = {name: lack for name, lack in find_lacking(deck).items() if kinds[name] != "solid"}
        heavy = len(lacking) < len(deck.sections) or deck.masses or any(own.matrix == "M" for own in deck.discrete)
        soft = {name: lack for name, lack in lacking.items() if lack.stiffness is None}
        # Bars of bulk data without RHO stand for springs: these may hang on what has mass.
        light = ("beam", "truss") if heavy and deck.program == "Nastran" else ()
        wanted = {name: lack for name, lack in lacking.items() if name in soft or kinds[name] not in light}
        problems.entries += lacking_problems(deck.name, wanted)
        self.warnings += tuple(
            f"{lack.sentence} and gives no mass; --density fills it in [no-density]"
            for name, lack in lacking.items()
            if name not in wanted
        )
        # So it is where a problem says that its material is not there.
        lost = (own.set for own in deck.sections if own.material not in deck.materials and not own.plies)
        return {*soft, *(lost if problems.entries else ())}

    def convert(self, K: sp.csr_array, M: sp.csr_array, version: str) -> Imported:
        """The model with the matrices (6 n, 6 n) of all n nodes of the deck."""
        deck, whole = self.deck, self.whole
        shear = np.zeros((len(deck.ids), 6))
        shear[:, :3] = self.text.shear_masses[:, None]
        M = sp.csr_array(deck.mass_scale * (M + sp.diags_array(shear.ravel())))
        held = self._by_row()
        turned = turning(whole.ties, len(deck.ids))
        K, loose = with_springs(K, M, self.blocks, deck.xyz, turned, whole.masses, held)
        filled = np.diff(K.indptr) + np.diff(M.indptr)
        # Means are those of displacements along all axes, also of grids that nothing holds along one.
        filled.reshape(-1, 6)[nodes_of(whole.average), :3] += 1
        filled = np.flatnonzero(filled)
        K, M = (sp.csr_array(A[filled][:, filled]) for A in (K, M))
        equations = whole.equations + self._held_equations(held, filled)
        node, component = self.row[filled // 6], filled % 6
        solid = 0 if self.mesh is None else len(self.mesh.nodes)
        order = np.lexsort((component, node, (node >= solid) | (component > 2)))
        K, M = (sp.csr_array(A[order][:, order]) for A in (K, M))
        dofs = DofMap(node=node[order], component=component[order])
        mesh_warnings = () if self.mesh is None else self.mesh.warnings
        matrix_warnings = self._matrix_warnings(K, M, dofs)
        return replace(
            replace(whole, equations=equations).on_rows(self.row),
            K=K,
            M=M,
            nodes=self.nodes,
            dofs=dofs,
            mesh=self.mesh,
            notes=tuple(self._notes(version, loose)),
            warnings=tuple(
                dict.fromkeys(
                    [
                        *deck.warnings,
                        *mesh_warnings,
                        *self.warnings,
                        *self.text.warnings,
                        *matrix_warnings,
                        *self._list_differences(),
                    ]
                )
            ),
        )

    def _by_row(self) -> dict[int, Floats]:
        """Directions (k, 6) that are held, by rows of nodes."""
        supports = self.deck.supports
        if not self.is_held or not len(supports.nodes):
            return {}
        rows = self.labels.rows(supports.nodes, "supports name")
        order = np.argsort(rows, kind="stable")
        own, starts = np.unique(rows[order], return_index=True)
        return dict(zip(own.tolist(), np.split(supports.directions[order], starts[1:]), strict=True))

    def _held_equations(self, held: dict[int, Floats], filled: Ints) -> tuple[Equations, ...]:
        there = np.zeros((len(self.row), 6), dtype=bool)
        there.ravel()[filled] = True
        there[nodes_of(self.whole.ties)] = True
        equations = held_equations(held, there)
        return () if equations is None else (equations,)

    def _matrix_warnings(self, K: sp.csr_array, M: sp.csr_array, dofs: DofMap) -> Iterator[str]:
        """Warnings that follow from the matrices."""
        R = rigid_motion(self.nodes.xyz[dofs.node] - self.nodes.xyz.mean(axis=0), dofs.component)
        strain = float(np.abs(K @ R).max() / (abs(K) @ np.abs(R)).max())
        if strain > TOL.rigid_strain:
            yield (
                f"rigid motion strains the stiffness that MYSTRAN wrote by {strain:.1e} of its terms: its CQUAD4 "
                "resist rotation where their four grids are not in a plane [engine-rotation]"
            )
        along = [float(R[:, axis] @ (M @ R[:, axis])) for axis in range(3)]
        if max(along) - min(along) > TOL.uneven_mass * max(along):
            listed = ", ".join(f"{mass:.6g}" for mass in along)
            yield f"the mass that MYSTRAN wrote is {listed} along x, y and z; please report it [engine-map]"

    def _list_differences(self) -> list[str]:
        """In what the model differs from that of the deck, a sentence each."""
        warnings = [
            "MYSTRAN has formulations of its own, consistent masses of solids and lumped ones of other elements (also "
            "with PARAM COUPMASS): frequencies are those of Nastran as far as these agree [formulation-differs]"
        ]
        beams = sum(len(part.ids) for part in self.deck.elements if part.code == "CBEAM")
        if beams:
            warnings.append(f"{beams} CBEAM of constant section are assembled as CBAR [beam-as-bar]")
        return warnings

    def _notes(self, version: str, loose: int) -> list[str]:
        """Who assembled the model and what was left out, a sentence each."""
        notes = [f"The matrices of elements are those of MYSTRAN{' ' + version if version else ''}."]
        if loose:
            notes.append(
                f"{loose} {self.deck.node}s turn freely about an axis, such as the normal of flat shells; they follow "
                "the rotation of an element by springs that carry no force."
            )
        return [*notes, *self.notes]
