"""A first job for a mesh or a model file, with comments: what has to be looked at, and what else there is."""

from __future__ import annotations

import json
import shlex
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from morembs.app.jobs.proposals import Proposal, propose_interfaces
from morembs.app.jobs.tolerances import TOL
from morembs.app.kinds import DECKS, MATRIX_FILE, kind_of
from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.base.units import Units, parse_units
from morembs.body.diagnostics.units import unit_findings
from morembs.examples import EXAMPLES
from morembs.fem import FEModel, Mesh
from morembs.fem.fe_model import has_places
from morembs.fem.material import Material, isotropic
from morembs.importers import format_of, import_file, read_deck, read_mesh
from morembs.importers.advice import advising
from morembs.importers.decks.problems import DeckError, Form
from morembs.importers.model_file import is_model_file, read_model
from morembs.importers.to_model import model_of
from morembs.storage.contents import keeping_ledger, same_place
from morembs.storage.safefile import replacing

_ROLES = ("stiffness", "mass", "damping")
NONE: Ints = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeDeck:
    """A deck that becomes a model by itself: its mesh, its complete materials, how many there are in all, the names of
    its couplings, rows of nodes that follow others, and the element sets whose materials lack a density."""

    mesh: Mesh
    complete: tuple[Material, ...]
    materials: int
    couplings: tuple[str, ...]
    followers: Ints
    without_density: tuple[str, ...]
    # The largest modulus, in units of the deck.
    modulus: float


def job_text(file: Path, folder: Path, units: Units | None = None, *, picture: bool = False) -> str:
    """A job in ``folder`` that reduces the mesh or model ``file``; numbers of a mesh are in ``units``.

    Without ``units`` they are guessed by the size of the mesh, and the job says so. With ``picture`` the job draws one.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        path = file.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        path = file.resolve().as_posix()
    with keeping_ledger() as ledger:
        if is_model_file(file):
            model = read_model(file)
            head = _model(path, model.size, len(model.nodes))
            if has_places(model):
                head[1:1] = [
                    "# Numbers of this job, such as corners of a box, are in m, kg and s, as those of a model file."
                ]
            followers = NONE if model.dependent is None else model.dofs.node[model.dependent.owner >= 0]
            interfaces = _choose(model, model.mesh, tuple(model.couplings), followers, parse_units("m-kg-s"))
            interfaces = _with_matrices(interfaces, model)
            dofs = model.size
        elif kind_of(file) is MATRIX_FILE:
            model = _with_columns(file)
            head = _model(path, model.size, 0)
            roles = [role for role, held in (("B", model.inputs), ("C", model.outputs)) if held is not None]
            if roles:
                head[-1:] = [f"set = {{ {', '.join(f'{role} = {_quote(role)}' for role in roles)} }}", ""]
            if units is not None:
                head[-1:] = [f"units = {_quote(units.name)}", ""]
            interfaces = _with_matrices(_choose(model, None, (), NONE, parse_units("m-kg-s")), model)
            dofs = model.size
        else:
            deck = _whole_deck(file)
            with advising(Form()):
                mesh = _plain_mesh(file) if deck is None else deck.mesh
            size = np.ptp(mesh.nodes.xyz, axis=0).max()
            is_metres = size <= TOL.longest_in_metres if deck is None else deck.modulus >= TOL.least_pascals
            known = units or parse_units("m-kg-s" if is_metres else "mm-t-s")
            _warn_of_units(mesh, () if deck is None else deck.complete, known)
            source = "size" if deck is None else "moduli"
            head = _mesh(path, mesh, known, "" if units else f": guessed from its {source}", deck)
            if deck is None and format_of(file) in DECKS:
                head[1:1] = ["# Nodes and elements alone; the key file in place of mesh reads all that the deck holds."]
            couplings, followers = ((), NONE) if deck is None else (deck.couplings, deck.followers)
            interfaces = _choose(mesh, mesh, couplings, followers, known)
            dofs = 3 * len(mesh.nodes)
    name = file.name.removesuffix(".gz").removesuffix(".h5").removesuffix(".model").partition(".")[0]
    while any(same_place(folder / f"{name}.h5", opened) for opened in ledger.opened):
        name += "-body"  # a companion of the mesh, or the mesh itself, has the name
    return "\n".join([*head, *interfaces.lines(), *_reduction(interfaces, dofs), *_rest(name, picture), ""])


@dataclass(frozen=True, kw_only=True)
class Interfaces:
    """Interfaces of a job, others that it names in comments, and what is said above them."""

    chosen: Sequence[Proposal]
    others: Sequence[Proposal]
    about: str

    def lines(self) -> list[str]:
        """Their tables; those of the others as comments."""
        lines = [self.about]
        for one in self.chosen:
            lines += [*([f"# {one.about}"] if one.about else []), *_table(one), ""]
        plain = [one.nodes for one in self.others if not one.about]
        if plain:
            lines += [f"# There are too: {', '.join(plain)}", ""]
        proposed = [one for one in self.others if one.about]
        for one in proposed[: TOL.proposed_others]:
            lines += [f"# {one.about}", *(f"# {line}" for line in _table(one)), ""]
        if len(proposed) > TOL.proposed_others:
            lines += [f"# Lesser ones that are left out: {len(proposed) - TOL.proposed_others}", ""]
        if not self.chosen and not self.others:
            lines += ["# [[interface]]", '# name = "tip"', '# nodes = "box:0,0,0,1,1,1"', ""]
        return lines


def _table(one: Proposal) -> list[str]:
    name = "_".join(one.name.replace("/", "_").split()).lstrip(".") or "interface"
    if one.matrix:
        return ["[[interface]]", f"name = {_quote(name)}", f"matrix = {_quote(one.matrix)}"]
    lines = ["[[interface]]", f"name = {_quote(name)}", f"nodes = {_quote(one.nodes)}"]
    if one.nodes.startswith("coupling:"):
        return lines
    if one.follows:
        return [*lines, 'coupling = "average"       # not "rigid": some of these nodes follow others']
    return [*lines, 'coupling = "rigid"         # or "average", "direct"']


def _choose(
    source: Mesh | FEModel, mesh: Mesh | None, couplings: tuple[str, ...], followers: Ints, units: Units
) -> Interfaces:
    """Couplings of a source, else its node sets, else what is found in the skin of its mesh.

    Args:
        followers: rows of nodes that follow others, as those of shells do, and cannot follow an interface too.
    """
    about = "# Where other bodies touch the part. Instead of a set: box:x0,y0,z0,x1,y1,z1, sphere:x,y,z,r, ids:1,2,3"
    named = [Proposal(name, f"coupling:{name}", "", NONE) for name in couplings]
    chosen, others = _mark_followers(followers, *_node_sets(source))
    if named:
        first, more = named[: TOL.template_interfaces], named[TOL.template_interfaces :]
        return Interfaces(chosen=first, others=[*more, *chosen, *others], about=about)
    if chosen or mesh is None:
        return Interfaces(chosen=chosen, others=others, about=about)
    proposed, more = _mark_followers(followers, *propose_interfaces(mesh, units))
    about = "# Where other bodies touch the part, as holes and plane faces of its skin suggest. Keep what is touched."
    return Interfaces(chosen=proposed, others=[*others, *more], about=about)


def _mark_followers(followers: Ints, *lists: list[Proposal]) -> list[list[Proposal]]:
    """The same proposals, with the word which of them hold nodes that follow others."""
    return [[replace(one, follows=bool(np.isin(one.rows, followers).any())) for one in each] for each in lists]


def _whole_deck(file: Path) -> WholeDeck | None:
    """What a deck holds that has its materials; None for other decks, and for files that are no deck."""
    if format_of(file) not in DECKS:
        return None
    with suppress(DeckError):
        found = import_file(file)
        materials = len(found.materials) + len(found.incomplete)
        known = [lack.stiffness for lack in found.incomplete.values() if lack.stiffness is not None]
        if found.mesh is not None and materials and len(known) == len(found.incomplete):
            follow = [each.nodes for each in found.equations] + [each.slaves for each in found.rigid]
            return WholeDeck(
                mesh=found.mesh,
                complete=found.materials,
                materials=materials,
                couplings=(*(tie.name for tie in found.rigid), *(tie.name for tie in found.average)),
                followers=np.unique(np.concatenate([NONE, *follow])),
                without_density=tuple(found.incomplete),
                modulus=max(float(np.max(C)) for C in (*(each.stiffness for each in found.materials), *known)),
            )
    return None


def _plain_mesh(file: Path) -> Mesh:
    """Nodes and elements of a file.

    Raises:
        InputError: it cannot be read, or is a deck that another program has to assemble; the message says how.
    """
    try:
        return read_mesh(file)
    except InputError as error:
        if not _has_structures(file):
            raise
        quoted = shlex.quote(str(file))
        raise error.restate(
            f"{error}; another program may assemble it: morembs import {quoted} --engine auto -o part.model.h5, then: "
            "morembs init part.model.h5"
        ) from error


def _warn_of_units(mesh: Mesh, materials: Sequence[Material], units: Units) -> None:
    """Warn of sizes and materials that no body in ``units`` has, as an import does; without materials of steel."""
    steel = isotropic(
        set="all",
        young=TOL.steel_young / units.stress,
        poisson=TOL.steel_poisson,
        density=TOL.steel_density / units.density,
    )
    extent = np.ptp(mesh.nodes.xyz, axis=0)
    for finding in unit_findings(None, materials or [steel], extent, units, declared=units):
        if finding.severity == "warning":
            warnings.warn(f"{finding.sentence}; {finding.cure}", stacklevel=2)


def _has_structures(file: Path) -> bool:
    """True if a file is a deck with shells, beams or bars."""
    if format_of(file) not in DECKS:
        return False
    with suppress(InputError):
        return any(part.kind not in ("solid", "point", "none") for part in read_deck(file).elements)
    return False


def _mesh(path: str, mesh: Mesh, units: Units, guessed: str, deck: WholeDeck | None) -> list[str]:
    size = " x ".join(f"{length:.4g}" for length in np.ptp(mesh.nodes.xyz, axis=0))
    extent = f"{size} {units.name.partition('-')[0]}"
    sets = ", ".join(mesh.element_sets) or "none"
    key, holder = ("mesh", "mesh") if deck is None else ("file", "deck")
    head = [
        "[model]",
        f"{key} = {_quote(path)}",
        f"units = {_quote(units.name)}        # of all numbers here and in the {holder} ({extent}){guessed}",
        "",
    ]
    if deck is not None:
        steel = f"{TOL.steel_density / units.density:.6g}"
        density = f"density = {steel:<16}# of the deck's materials that have none: steel is assumed"
        return [
            *head[:-1],
            *([density] if deck.without_density else []),
            f"# The deck brings its materials ({deck.materials}), masses, springs and couplings.",
            "",
        ]
    return [
        *head,
        f"[[material]]                # steel is assumed; one table a material. Element sets of the mesh: {sets}",
        'set = "all"',
        f"young = {TOL.steel_young / units.stress:.6g}",
        f"poisson = {TOL.steel_poisson}",
        f"density = {TOL.steel_density / units.density:.6g}",
        "",
    ]


def _model(path: str, size: int, nodes: int) -> list[str]:
    held = f"{size:,} dofs" + (f" at {nodes:,} nodes" if nodes else " without nodes")
    return ["[model]", f"file = {_quote(path)}        # {held}", ""]


def _with_columns(file: Path) -> FEModel:
    """The model of a file of matrices, with the B and C that it holds."""
    plain = import_file(file)
    roles = {role: role for role in ("B", "C") if any(f"--set {role}=" in note for note in plain.notes)}
    return model_of(import_file(file, options=roles) if roles else plain)


def _with_matrices(interfaces: Interfaces, model: FEModel) -> Interfaces:
    """Inputs and outputs of a model before its sets."""
    held = {"B": model.inputs, "C": model.outputs}
    named = [Proposal(role, "", "", NONE, matrix=role) for role, columns in held.items() if columns is not None]
    if not named:
        return interfaces
    about = '# Inputs (columns of B) and outputs (rows of C); some of them by name: matrix = "B:NAME,NAME".'
    return Interfaces(chosen=named, others=[*interfaces.chosen, *interfaces.others], about=about)


def _node_sets(source: Mesh | FEModel) -> tuple[list[Proposal], list[Proposal]]:
    """Node sets: the smallest that can be interfaces together, and the others."""
    nodes = source.nodes
    sets = {name: Proposal(name, f"set:{name}", "", rows) for name, rows in nodes.sets.items()}
    fit, taken = [], np.zeros(len(nodes), dtype=bool)
    for name, one in sorted(sets.items(), key=lambda item: len(item[1].rows)):
        if one.is_fit(nodes.xyz, taken):
            fit.append(name)
            taken[one.rows] = True
    chosen = fit[: TOL.template_interfaces]
    return [sets[name] for name in chosen], [one for name, one in sets.items() if name not in chosen]


def _reduction(interfaces: Interfaces, dofs: int) -> list[str]:
    """The table of the reduction: no more modes than a tenth of the dofs that the interfaces leave."""
    rows = [one.rows for one in interfaces.chosen]
    left = dofs - (3 * len(np.unique(np.concatenate(rows))) if rows else 0)
    modes = max(1, min(TOL.template_modes, int(TOL.many_modes_part * left)))
    lines = ["[[reduce]]                  # one body for each; morembs compare sets them side by side"]
    if any(one.matrix for one in interfaces.chosen):
        order = max(1, min(TOL.template_modes, int(TOL.many_modes_part * dofs)))
        lines += [
            'method = "krylov"',
            f"order = {order:<20}# coordinates; or balanced-truncation, irka with band_hz = [0, 2000]",
        ]
        return [*lines, ""]
    if not rows:
        lines += ['method = "modal"            # without interfaces; with some: craig-bampton', f"modes = {modes}"]
    elif left <= 0:
        lines += ['method = "guyan"            # the interfaces leave no node for modes']
    else:
        lines += ['method = "craig-bampton"']
        lines += [f"modes = {modes:<20}# fixed-interface modes; or: up_to_hz = 5000"]
    return [*lines, ""]


def _rest(name: str, picture: bool) -> list[str]:
    return [
        "# [[reduce]]                # the smallest body within a tolerance over a band",
        '# method = "auto"',
        "# band_hz = [0, 2000]",
        "# tolerance = 0.01",
        "",
        "# [damping]",
        "# modal = 0.01              # of critical damping; or: rayleigh = { alpha = ..., beta = ... }",
        "",
        "# [certify]                 # how wrong each body is, at every frequency of a band",
        "# band_hz = [0, 2000]",
        "# witness = true            # files by which morembs verify proves it again",
        "",
        "# [solver]",
        '# memory = "8 GB"           # for the whole process',
        "",
        "[output]",
        f"path = {_quote(f'{name}.h5')}",
        f"{'' if picture else '# '}picture = {_quote(f'{name}.png')}",
    ]


def write_example(name: str, job: Path) -> None:
    """Write the files of the example ``name`` beside the ``job``, and the job, which draws a picture.

    Raises:
        InputError: a file of one of these names is there; then nothing is written.
    """
    example = EXAMPLES[name]
    files = [job.parent / file for file in example.files]
    for path in (*files, job):
        if path.exists():
            raise InputError(
                f"{path} is there already, and an example writes over nothing; choose another folder", kind="output"
            )
    first = example.write(job.parent)
    if name == "matrices":
        K, M, B = (Path(file.name) for file in files)
        options = {"order": TOL.example_order}
        text = job_of_matrices([K, M], B, method="krylov", options=options, body=job.stem)
        text += f"picture = {_quote(f'{job.stem}.png')}\n"
    else:
        text = job_text(first, job.parent, parse_units(example.units), picture=True)
    with replacing(job) as written:
        written.write(text.encode())


def job_of_matrices(
    files: Sequence[Path],
    loads: Path | None = None,
    outputs: Path | None = None,
    *,
    method: str = "modal",
    options: Mapping[str, object] | None = None,
    body: str = "",
) -> str:
    """A job that reduces K, M and D of ``files``, in this order, with columns of ``loads`` and rows of ``outputs``.

    One file that holds matrices by name may stand for all; ``loads`` and ``outputs`` are then names in it. The file of
    bodies has the name ``body``, by default that of K. Loads and outputs without a folder lie beside K.

    Raises:
        InputError: no two or three files, or none that a method needs.
    """
    alone = len(files) == 1 and kind_of(files[0]) is MATRIX_FILE
    if not alone and not 2 <= len(files) <= len(_ROLES):
        count = f"{len(files)} {'matrix was' if len(files) == 1 else 'matrices were'} given"
        raise InputError(f"{count}; expected stiffness and mass, and maybe damping: morembs reduce K.mtx M.mtx D.mtx")
    given = {name: file for name, file in (("B", loads), ("C", outputs)) if file is not None}
    roles = ("file",) if alone else _ROLES
    lines = ["[model]", *(f"{role} = {_quote(str(file))}" for role, file in zip(roles, files, strict=False))]
    if given:
        lines += [f"set = {{ {', '.join(f'{name} = {_quote(str(file))}' for name, file in given.items())} }}"]
    for name in given:
        lines += ["", "[[interface]]", f"name = {_quote(name)}", f"matrix = {_quote(name)}"]
    keys = [f"{key} = {value}" for key, value in (options or {}).items()]
    lines += ["", "[[reduce]]", f"method = {_quote(method)}", *keys]
    stem = body or files[0].name.partition(".")[0]
    return "\n".join([*lines, "", "[output]", f"path = {_quote(f'{stem}.h5')}", ""])


def _quote(text: str) -> str:
    """A text as TOML has it, which takes the escapes of JSON."""
    return json.dumps(text, ensure_ascii=False)


def refuse_existing(path: Path) -> None:
    """Refuse to write over a job.

    Raises:
        InputError: there is such a file.
    """
    if path.exists():
        raise InputError(f"{path} is there already; give another name: morembs init FILE -o NAME.toml", kind="output")
