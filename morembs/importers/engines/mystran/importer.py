"""Decks that MYSTRAN assembles: K and M of its elements, with couplings, springs and masses of the own reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import Positive, PositiveCount
from morembs.base.types import Floats, Ints
from morembs.fem import DofMap, rigid_motion
from morembs.fem.constraints import Equations
from morembs.fem.handedness import right_handed
from morembs.fem.material import Material
from morembs.importers.decks.join import couplings_of, join
from morembs.importers.decks.missing_middles import with_middles
from morembs.importers.decks.options import Boundary, DeckOptions, deck_options, lacking_problems
from morembs.importers.decks.problems import Problem
from morembs.importers.decks.tables import DeckTables, Supports
from morembs.importers.engines.mystran.bulk import as_bulk
from morembs.importers.engines.mystran.elements import STRUCTURES, Structures, solid_cards
from morembs.importers.engines.mystran.program import Mystran, cores, mystran_path
from morembs.importers.engines.mystran.rotations import turning, with_springs
from morembs.importers.engines.mystran.sections import CARDS, Sections
from morembs.importers.imported import Imported, nodes_of
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.importer import deck_of, grids_of, notes_of, skipped_warnings, solid_elements, tied
from morembs.importers.nastran.restraints import held_equations, supports_of
from morembs.importers.tolerances import TOL

# Cards beside those of the own reader.
CARDS_READ = (
    *STRUCTURES,
    *(name for names in CARDS.values() for name in names if name != "PSOLID"),
    "MAT2",
    "MAT8",
    "BAROR",
    "BEAMOR",
)


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

    Bulk data are read card by card; decks of other programs are written as bulk data first.

    Args:
        format: "nastran" or "abaqus".
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
        materials: isotropic ones of sets of properties whose materials are not there, or "all" of these.

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
    other = "contact" if contact != "refuse" else "dialect" if dialect != "auto" else ""
    if format == "nastran" and other:
        raise InputError(f"--{other} was given with --engine mystran, and bulk data have none; leave it out")
    reading = {"density": density, "skip": skip, "allow_includes_outside": allow_includes_outside}
    with as_bulk(Path(path), format, {**reading, "dialect": dialect, "contact": contact}, materials) as source:
        if boundary == "keep" and source.deck is not None and not len(source.deck.supports.nodes):
            raise InputError(
                f"--boundary keep was given for {Path(path).name}, whose supports are not read; leave it out, and hold "
                "the model by [[interface]] of a job"
            )
        options = deck_options(source.density(density), "refuse", skip if format == "nastran" else "")
        deck = _Deck(source.bulk, options, boundary == "keep", allow_includes_outside, source.materials)
        return source.whole(_assembled(deck, program, timeout, jobs, keep, grids))


def _assembled(deck: _Deck, program: Path, timeout: float, jobs: int | None, keep: Path | None, grids: int) -> Imported:
    """The model of a deck that was read, by runs of MYSTRAN."""
    with Mystran(
        program=program,
        file=deck.bulk.file,
        blocks=deck.blocks,
        properties=deck.properties,
        ids=deck.bulk.grids.ids,
        xyz=deck.bulk.grids.xyz,
        seconds=timeout,
        jobs=jobs or cores(),
        keep=keep,
    ) as mystran:
        K, M = mystran.matrices(grids)
        return deck.imported(K, M, mystran.version)


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
    """Whether a deck can be written for MYSTRAN; it is not run.

    Raises:
        InputError: it cannot.
    """
    reading = {"density": density, "skip": skip, "allow_includes_outside": allow_includes_outside}
    with as_bulk(path, format, {**reading, "dialect": dialect, "contact": contact}, materials) as source:
        options = deck_options(source.density(density), "refuse", skip if format == "nastran" else "")
        _Deck(source.bulk, options, False, allow_includes_outside, source.materials)


class _Deck:
    """A deck as far as it is read without MYSTRAN; what is wrong with it is refused in one message."""

    def __init__(
        self, path: Path, options: DeckOptions, keep: bool, outside: bool, materials: tuple[Material, ...]
    ) -> None:
        self.bulk = bulk = Bulk(path, outside=outside, options=options, more=CARDS_READ)
        self.notes: list[str] = []
        self.warnings: list[str] = []
        with bulk.problems.ending():
            self.scale, self.keep = bulk.mass_scale(), keep
            self.sections = Sections(bulk, materials, self.scale)
            self.structures = Structures(bulk, self.sections)
            parts = solid_elements(bulk)
            solid = grids_of(bulk, parts)
            for block in self.structures.blocks:
                solid[block.nodes] = False
            ties, springs = tied(bulk, solid, self.scale)
            self.held = _by_row(bulk, supports_of(bulk)) if keep else {}
            own = np.concatenate([bulk.grids.ids[:0], *(block.nodes.ravel() for block in self.structures.blocks)])
            self._mesh(deck_of(bulk, parts, ties, springs, more=own), own)
            self.properties = self._properties(options)
        bulk.problems.refuse()

    def _mesh(self, deck: DeckTables, own: Ints) -> None:
        """Nodes of the model, those of solids first, and all elements; ``own`` rows of grids are of other elements."""
        bulk, before = self.bulk, deck
        deck = with_middles(deck)
        bulk.grids.extend(deck.ids[len(before.ids) :], deck.xyz[len(before.ids) :])
        tied = couplings_of(deck)
        solids = join(deck, np.concatenate([nodes_of(tied.ties), deck.ids[own]]))
        self.whole = tied.on_rows(lambda labels: solids.labels.rows(labels, "couplings name"))
        self.row, self.mesh, nodes = solids.row, solids.mesh, solids.nodes
        self.blocks = list(self.structures.blocks)
        self.notes += [*deck.notes[len(before.notes) :], *solids.notes, *deck.remarks]
        if self.mesh is not None:
            self.mesh = right_handed(replace(self.mesh, warnings=()))
            self.warnings += self.mesh.warnings
            self.blocks += solid_cards(bulk, self.mesh, self.sections)
        self.warnings += bulk.text.warnings
        if not self.blocks:
            raise InputError(
                f"{bulk.file} has no elements that MYSTRAN assembles; expected solids, {', '.join(STRUCTURES)}"
            )
        sets = dict(nodes.sets)
        for block in self.structures.blocks:
            for pid in np.unique(block.properties).tolist():
                members = self.row[block.nodes[block.properties == pid]]
                name = self.sections.sets[pid - 1]
                sets[name] = np.union1d(sets.get(name, np.empty(0, dtype=np.int64)), members)
        self.nodes = replace(nodes, sets=sets)

    def _properties(self, options: DeckOptions) -> list[tuple[str, ...]]:
        """The cards of properties, with the densities that were given; sets without any are problems."""
        bulk = self.bulk
        filled, lacking, said = options.completed((), self.sections.lacking())
        self.warnings += said
        solid = {name: lack for name, lack in lacking.items() if name.startswith("PSOLID")}
        heavy = len(lacking) < len(set(self.sections.sets)) or bool(self.whole.masses)
        heavy = heavy or any(element.matrix == "M" for element in self.whole.discrete)
        # What has no stiffness is no element; what has no mass may hang on what has.
        soft = {name: lack for name, lack in lacking.items() if lack.stiffness is None}
        wanted = solid | soft if heavy else lacking
        bulk.problems.entries += lacking_problems(bulk.file, wanted)
        self.warnings += [
            f"{lack.sentence} and gives no mass; --density fills it in [no-density]"
            for name, lack in lacking.items()
            if name not in wanted
        ]
        cards = self.sections.cards({material.set: material.density for material in filled}, without=soft)
        self.warnings += self.sections.warnings
        for sentence in self.sections.misgiven():
            bulk.problems.add(Problem(what=sentence, file=bulk.file, keyword="MATERIAL"))
        return cards

    def imported(self, K: sp.csr_array, M: sp.csr_array, version: str) -> Imported:
        """The model with the matrices (6 n, 6 n) of all n grids of the deck."""
        grids, whole = self.bulk.grids, self.whole
        M = sp.csr_array(self.scale * (M + self._shear_masses()))
        turned = turning(whole.ties, len(grids.ids))
        K, loose = with_springs(K, M, self.blocks, grids.xyz, turned, self.held)
        filled = np.diff(K.indptr) + np.diff(M.indptr)
        # Means are those of displacements along all axes, also of grids that nothing holds along one.
        filled.reshape(-1, 6)[nodes_of(whole.average), :3] += 1
        filled = np.flatnonzero(filled)
        K, M = (sp.csr_array(A[filled][:, filled]) for A in (K, M))
        equations = whole.equations + self._held(filled)
        node, component = self.row[filled // 6], filled % 6
        solid = 0 if self.mesh is None else len(self.mesh.nodes)
        order = np.lexsort((component, node, (node >= solid) | (component > 2)))
        K, M = (sp.csr_array(A[order][:, order]) for A in (K, M))
        dofs = DofMap(node=node[order], component=component[order])
        self._tell(K, M, dofs)
        return replace(
            replace(whole, equations=equations).on_rows(self.row),
            K=K,
            M=M,
            nodes=self.nodes,
            dofs=dofs,
            mesh=self.mesh,
            notes=tuple(self._said(version, loose, len(filled))),
            warnings=tuple(dict.fromkeys([*self.warnings, *self._differing()])),
        )

    def _held(self, filled: Ints) -> tuple[Equations, ...]:
        there = np.zeros((len(self.row), 6), dtype=bool)
        there.ravel()[filled] = True
        there[nodes_of(self.whole.ties)] = True
        equations = held_equations(self.held, there)
        return () if equations is None else (equations,)

    def _shear_masses(self) -> sp.csr_array:
        """Masses of shear panels, a quarter at each grid; MYSTRAN gives them none."""
        diagonal = np.zeros(6 * len(self.row))
        for block in self.structures.blocks:
            if block.card == "CSHEAR":
                x = self.bulk.grids.xyz[block.nodes]
                area = np.linalg.norm(np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]), axis=1) / 2
                mass = area * np.array([self.sections.shear_mass(pid) for pid in block.properties.tolist()])
                for axis in range(3):
                    np.add.at(diagonal, 6 * block.nodes + axis, mass[:, None] / 4)
        return sp.csr_array(sp.diags_array(diagonal))

    def _tell(self, K: sp.csr_array, M: sp.csr_array, dofs: DofMap) -> None:
        """Warnings that follow from the matrices."""
        R = rigid_motion(self.nodes.xyz[dofs.node] - self.nodes.xyz.mean(axis=0), dofs.component)
        strain = float(np.abs(K @ R).max() / (abs(K) @ np.abs(R)).max())
        if strain > TOL.rigid_strain:
            self.warnings.append(
                f"rigid motion strains the stiffness that MYSTRAN wrote by {strain:.1e} of its terms: its CQUAD4 "
                "resist rotation where their four grids are not in a plane [engine-rotation]"
            )
        along = [float(R[:, axis] @ (M @ R[:, axis])) for axis in range(3)]
        if max(along) - min(along) > TOL.uneven_mass * max(along):
            listed = ", ".join(f"{mass:.6g}" for mass in along)
            self.warnings.append(
                f"the mass that MYSTRAN wrote is {listed} along x, y and z; please report it [engine-map]"
            )

    def _differing(self) -> list[str]:
        """In what the model differs from that of the deck, a sentence each."""
        said = [
            "MYSTRAN has formulations of its own, consistent masses of solids and lumped ones of all else (also with "
            "PARAM COUPMASS): frequencies are those of Nastran as far as these agree [formulation-differs]"
        ]
        if self.structures.beams:
            said.append(f"{self.structures.beams} CBEAM of constant section are assembled as CBAR [beam-as-bar]")
        return [*said, *skipped_warnings(self.bulk)]

    def _said(self, version: str, loose: int, rows: int) -> list[str]:
        """What was left out, a sentence each."""
        notes = [f"The matrices of elements are those of MYSTRAN{' ' + version if version else ''}."]
        if loose:
            notes.append(
                f"{loose} grids turn freely about an axis, such as the normal of flat shells; they follow the "
                "rotation of an element by springs that carry no force."
            )
        notes += notes_of(self.bulk, self.scale, is_held=self.keep)
        return [*notes, *self.notes]


def _by_row(bulk: Bulk, supports: Supports) -> dict[int, Floats]:
    """Directions (k, 6) that are held, by rows of grids."""
    rows, starts = np.unique(bulk.grids.rows(supports.nodes, "SPC"), return_index=True)
    return dict(zip(rows.tolist(), np.split(supports.directions, starts[1:]), strict=True)) if len(rows) else {}
