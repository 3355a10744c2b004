"""Certificates of random assemblies against their unreduced parts, proven again by ``morembs_verify``; and false ones.

    python benchmarks/joined_verification.py --count 30 --tampers 30 --seed 1

Each assembly has two or three steel beams of random sizes at random places, with joints that are rigid, hinged with
springs or springs alone. The true error is that of dense solutions, made of the meshes alone. False files have new
digests: a limit below the true error, a joint or a part of one left out, another model, place, spring or damping of a
part.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.verification import reseal
from morembs.body import elastic_body, make_part
from morembs.body.file import StoredBodies, read_body, write_body
from morembs.certificate.certify import certify
from morembs.certificate.morembs_verify import verify
from morembs.certificate.record import Certificate
from morembs.certificate.witness import write_witness
from morembs.dynamics.assembly import Couple, Substructure, Unreduced, assemble_bodies
from morembs.dynamics.assembly.joint_file import write_joined
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton
from tests.support.dense_assembly import Joint, Part, Whole, elastic
from tests.support.meshes import box, steel, where

Rng = np.random.Generator


@dataclass(frozen=True, kw_only=True, eq=False)
class Joined:
    """An assembly with its files, and what dense matrices of it are made of."""

    words: str
    folder: Path
    certificate: Certificate
    parts: list[Part]
    joints: list[Joint]
    ends: list[tuple[int, str]]
    structural: float

    @property
    def files(self) -> tuple[Path, Path, Path]:
        """Body, assembly and witness."""
        return self.folder / "body.h5", self.folder / "model.h5", self.folder / "witness.h5"

    def true_errors(self, hz: Sequence[float], parts: list[Part] | None = None, joints: list[Joint] | None = None):
        """(nf,) error of H over |H|, by its definition, against these dense parts and joints."""
        dense = Whole(parts or self.parts, joints or self.joints, self.ends)
        stored = read_body(self.files[0])
        (body,) = stored.bodies.values()
        length = np.sqrt(np.trace(stored.inertia) / (2 * stored.mass))
        scale = np.tile([1.0] * 3 + [length] * 3, len(stored.interfaces))
        errors = []
        for w in 2 * np.pi * np.asarray(hz):
            H = scale[:, None] * dense.response(w, self.structural) * scale
            M, K, D = body.matrices
            H_r = scale[:, None] * elastic(K, M, D, body.input_matrix, w, self.structural) * scale
            errors.append(np.linalg.norm(H_r - H) / np.linalg.norm(H))
        return np.array(errors)

    def sweep(self) -> np.ndarray:
        """Frequencies between 0 and the end of the band, where limits were found, and beside resonances."""
        top = self.certificate.band_hz[1]
        at = [limit.at_hz for limit in self.certificate.limits.values()]
        modes = Whole(self.parts, self.joints, self.ends).frequencies_hz[6:]
        near = np.outer(modes[modes < top], [0.999, 1.0, 1.001]).ravel()
        return np.sort(np.clip(np.concatenate([np.linspace(0.01 * top, top, 60), at, near]), 1e-3 * top, top))


def beam_of(rng: Rng, folder: Path, name: str, beta: float) -> tuple[Problem, StoredBodies, Callable[[], np.ndarray]]:
    """A beam with two rigid ends, reduced."""
    size = (rng.uniform(0.2, 0.5), rng.uniform(0.03, 0.08), rng.uniform(0.03, 0.08))
    model = steel(box("hex8", (int(rng.integers(2, 5)), 1, 1), size))
    ends = [make_interface(model, name=end, nodes=where(model, 0, x)) for end, x in (("left", 0.0), ("right", size[0]))]
    problem = Problem(model, ends, damping=Damping(beta=beta))
    reduced = CraigBampton(modes=int(rng.integers(2, 8))).reduce(problem)
    path = write_body(folder / f"{name}.h5", [elastic_body(problem, reduced, make_part(problem))])
    return problem, read_body(path), lambda: reduced.V


def joined(seed: int, number: int, folder: Path) -> Joined:
    """The certified random assembly ``number``, with its files in ``folder``."""
    rng = np.random.default_rng([seed, number])
    count, kind = int(rng.integers(2, 4)), number % 3
    beta = float(10 ** rng.uniform(-6.5, -5)) if kind else 0.0
    turn, place, parts, dense = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1, 1, 3), [], []
    for k in range(count):
        problem, bodies, basis = beam_of(rng, folder, f"p{k}", beta)
        xyz = problem.model.nodes.xyz
        middles = [xyz[each.nodes].mean(axis=0) for each in problem.interfaces]
        at = place - turn @ middles[0]
        parts.append(
            Substructure(name=f"p{k}", bodies=bodies, position=at, rotation=turn, problem=problem, basis=basis)
        )
        rows = {each.name: each.nodes for each in problem.interfaces}
        dense.append(Part(mesh=problem.model.mesh, turn=turn, place=at, interfaces=rows, beta=beta))
        place = at + turn @ middles[1]
        # The next one goes on in another direction.
        turn = Rotation.random(random_state=rng).as_matrix() if rng.random() < 0.7 else turn
    couples, joints = list[Couple](), list[Joint]()
    for k in range(count - 1):
        sides = (f"p{k}:right", f"p{k + 1}:left")
        stiff, damp = 10 ** rng.uniform(6, 9, 6), 10 ** rng.uniform(1, 3, 6)
        springs = [(0, 1, 2, 3, 4, 5), (3, 4, 5), ()][2 - kind]
        rest = tuple(sorted(set(range(6)) - set(springs)))
        if rest:
            couples.append(Couple(between=sides, components=rest))
            joints.append(((k, "right"), (k + 1, "left"), rest, None, None))
        if springs:
            couples.append(Couple(between=sides, components=springs, stiffness=list(stiff), damping=list(damp)))
            joints.append(((k, "right"), (k + 1, "left"), springs, stiff, damp))
    structural = 0.0 if kind else float(10 ** rng.uniform(-3, -1))
    assembled, outer = assemble_bodies(parts, couples), [(0, "left"), (count - 1, "right")]
    ends = [
        make_interface(assembled, name=f"{side}_{k}", nodes=assembled.nodes.sets[f"p{k}:{side}"]) for k, side in outer
    ]
    with Problem(assembled, ends, damping=Damping(structural=structural)) as small, Unreduced(small) as full:
        reduced = CraigBampton(modes=int(rng.integers(2, 10))).reduce(small)
        modes = Whole(dense, joints, outer).frequencies_hz[6:]
        band = (0.0, float(modes[int(rng.integers(1, 5))] * rng.uniform(1.05, 1.3)))
        (certificate,) = certify(full.problem, [full.expand(reduced)], band, points=10)
        case = Joined(
            words=f"{number}: {count} parts, {('rigid', 'hinges with springs', 'springs')[kind]}",
            folder=folder,
            certificate=certificate,
            parts=dense,
            joints=joints,
            ends=outer,
            structural=structural,
        )
        body, model, witness = case.files
        write_body(body, [elastic_body(small, reduced, make_part(small), certificate)])
        write_joined(model, full)
        write_witness(witness, full.problem, band, body=body, model=model, expand=full.in_parts)
    for part in parts:
        if part.problem is not None:
            part.problem.close()
    return case


def put(file: h5py.File, name: str, value: object) -> None:
    """Another dataset in the place of one."""
    del file[name]
    file[name] = value


def other_stiffness(case: Joined, file: h5py.File, size: float) -> np.ndarray:
    """Another model of the first part."""
    file["models/0/matrices/K/data"][...] *= 1 + size
    first = case.parts[0]
    # Damping by beta is that of the other stiffness.
    return case.true_errors(case.sweep(), parts=[replace(first, young=first.young * (1 + size)), *case.parts[1:]])


def other_damping(case: Joined, file: h5py.File, size: float) -> np.ndarray:
    """Other damping of the last part."""
    last, beta = len(case.parts) - 1, case.parts[-1].beta * (1 + 10 * size) + 1e-5 * size
    put(file, f"parts/{last}/beta", beta)
    return case.true_errors(case.sweep(), parts=[*case.parts[:-1], replace(case.parts[-1], beta=beta)])


def other_springs(case: Joined, file: h5py.File, size: float) -> np.ndarray | None:
    """Other springs in all joints that have some."""
    joints = list(case.joints)
    for number, (*sides, stiffness, damping) in enumerate(case.joints):
        if stiffness is not None:
            joints[number] = (*sides, np.asarray(stiffness) * (1 + size), damping)
            put(file, f"couples/{number}/stiffness", joints[number][3])
    sprung = any(joint[3] is not None for joint in joints)
    return case.true_errors(case.sweep(), joints=joints) if sprung else None


def without_joint(case: Joined, file: h5py.File, _: float) -> np.ndarray:
    """The last joint left out: parts, or some components, are free."""
    del file[f"couples/{len(case.joints) - 1}"]
    return np.array([np.inf])


def fewer_components(_: Joined, file: h5py.File, __: float) -> np.ndarray:
    """One component of a joint left out: a mechanism, or springs that are not there."""
    put(file, "couples/0/components", file["couples/0/components"][1:])
    return np.array([np.inf])


def other_place(case: Joined, file: h5py.File, size: float) -> np.ndarray:
    """Another place of the last part, away from its joint."""
    file[f"parts/{len(case.parts) - 1}/position"][...] += 0.1 * size
    return np.array([np.inf])


def other_turn(case: Joined, file: h5py.File, size: float) -> np.ndarray:
    """The last part is turned about its joint."""
    last = len(case.parts) - 1
    part, R = case.parts[-1], Rotation.from_rotvec([0.7 * size, 0.4 * size, 0.9 * size]).as_matrix()
    joint = part.turn @ part.mesh.nodes.xyz[part.interfaces["left"]].mean(axis=0) + part.place
    moved = replace(part, turn=R @ part.turn, place=joint + R @ (part.place - joint))
    file[f"parts/{last}/rotation"][...], file[f"parts/{last}/position"][...] = moved.turn, moved.place
    errors = case.true_errors(case.sweep(), parts=[*case.parts[:-1], moved])
    with h5py.File(case.files[0], "r+") as body:
        # The body says where its interface is.
        name = f"interfaces/right_{last}/point"
        body[name][...] = moved.turn @ part.mesh.nodes.xyz[part.interfaces["right"]].mean(axis=0) + moved.place
    return errors


def other_model(case: Joined, file: h5py.File, _: float) -> np.ndarray:
    """The model of the first part in the place of that of the last one."""
    put(file, f"parts/{len(case.parts) - 1}/model", 0)
    return np.array([np.inf])


def lower_limit(case: Joined, file: h5py.File, size: float) -> np.ndarray:
    """A pointwise limit below the true error."""
    errors = case.true_errors(case.sweep())
    with h5py.File(case.files[0], "r+") as body:
        place = f"bodies/{next(iter(body['bodies']))}/certificate"
        limit, cells = body[f"{place}/limits/pointwise"][()], body[f"{place}/cell_limit"][()]
        limit[1] = errors.max() / (1.01 + 0.1 * size)
        cells[:, 2] = np.minimum(cells[:, 2], limit[1])
        put(body, f"{place}/limits/pointwise", limit)
        put(body, f"{place}/cell_limit", cells)
    return np.array([np.inf])


TAMPERS = (
    *(lower_limit, without_joint, other_stiffness, fewer_components, other_springs),
    *(other_place, other_turn, other_damping, other_model),
)


def tamper(case: Joined, change: Callable[..., np.ndarray | None]) -> bool:
    """Make the files of ``case`` false by ``change``; False where that is not possible."""
    kept = [path.read_bytes() for path in case.files]
    for size in (0.01, 0.1, 0.4, 1.0, 4.0):
        with h5py.File(case.files[1], "r+") as file:
            errors = change(case, file, size)
        if errors is not None and errors.max() > 1.01 * case.certificate.limits["pointwise"].upper:
            reseal(*case.files)
            return True
        for path, data in zip(case.files, kept, strict=True):
            path.write_bytes(data)
    return False


def main() -> None:
    """Print how many are proven, and of the false ones the lemmas that refuse them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=6, help="random assemblies")
    parser.add_argument("--tampers", type=int, default=9, help="false files")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    proven, wrong, over, tampers, number, largest, refused = 0, 0, 0, 0, 0, 0.0, Counter[str]()
    while number < given.count or tampers < given.tampers:
        with tempfile.TemporaryDirectory() as folder:
            case, found = joined(given.seed, number, Path(folder)), list[np.ndarray]()
            if number < given.count:
                _, holds, said = verify(*map(str, case.files), found)
                part = float(case.true_errors(case.sweep()).max() / case.certificate.limits["pointwise"].upper)
                proven, over = proven + holds, over + (part > 1)
                largest = max([largest, *(float(each.max()) for each in found)])
                verdict = "proven" if holds else said.splitlines()[-1]
                print(f"{case.words}: {verdict}; true error {part:.3f} of the limit", flush=True)
            change = TAMPERS[number % len(TAMPERS)]
            if tampers < given.tampers and tamper(case, change):
                tampers += 1
                try:
                    _, holds, said = verify(*map(str, case.files))
                except (ValueError, LookupError) as error:
                    holds, said = False, f"cannot be read: {error}"
                wrong += holds
                why = said.splitlines()[-1].partition(" fails")[0].removeprefix("not verified: ")
                refused[f"{change.__name__}: {why[:60]}"] += 1
                if holds:
                    print(f"FALSE AND PROVEN: {case.words}, {change.__name__}: {said}", flush=True)
            number += 1
    print(f"{proven} of {given.count} verified; found at most {largest:.3f} of the stated limit")
    print(f"{over} true errors above their limits; {wrong} of {tampers} false ones proven")
    for name, times in sorted(refused.items()):
        print(f"  {times:4d} {name}")
    sys.exit(bool(wrong or over))


if __name__ == "__main__":
    main()
