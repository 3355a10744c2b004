"""Rigid and interpolating elements of Nastran bulk data, multipoint constraints and concentrated masses."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.constraints import AverageElement, Equations, RigidElement, Term, solved_for_first
from morembs.importers.decks.algebra import terms_of
from morembs.importers.imported import PointMass
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.geometry import Grids, Systems
from morembs.importers.nastran.motions import Motion, Motions, components
from morembs.importers.nastran.properties import Rows, labels_of, pad
from morembs.importers.tolerances import TOL

_ALL = (0, 1, 2, 3, 4, 5)


class Ties:
    """RBE1, RBE2, RBE3, RBAR, RROD, RTRPLT, MPC and CONM2 as rows of grids.

    Cards that fit a rigid or an average element of a model become one, others equations; ``solid`` (grids,) are those
    of solids, which have no rotations.
    """

    def __init__(self, grids: Grids, systems: Systems, scale: float, solid: NDArray[np.bool_] | None = None) -> None:
        self.grids, self.systems, self.scale = grids, systems, scale
        self.motions = Motions(grids, systems)
        self.solid = np.ones(len(grids.ids), dtype=bool) if solid is None else solid
        self.rigid: list[RigidElement] = []
        self.average: list[AverageElement] = []
        self.equations: list[Equations] = []
        self.masses: list[PointMass] = []
        self.notes: list[str] = []

    def rbe2(self, row: list[str]) -> None:
        """RBE2: grids that follow one grid, in some directions."""
        what = f"{self.grids.file}: RBE2 {pad(row, 1)[0]}"
        texts = row[3:]
        # Thermal expansion and its temperature stand behind the grids.
        while texts and "." in texts[-1]:
            if real(texts[-1], what):
                self.notes.append(f"RBE2 {row[0]}: its thermal expansion {texts[-1]} is not carried over.")
            texts = texts[:-1]
        which = components(pad(row, 3)[2], what)
        master = self.motions.row(pad(row, 2)[1], what)
        slaves = np.unique(self.motions.rows(labels_of(texts, what, self.grids.ids), what))
        self._add_rigid(what, f"RBE2_{row[0]}", master, slaves, which)

    def rbar(self, row: list[str]) -> None:
        """RBAR: two grids."""
        row = pad(row, 7)
        self._rigid_grids(f"RBAR {row[0]}", row[1:3], row[3:5], row[5:7])

    def rtrplt(self, row: list[str]) -> None:
        """RTRPLT: three grids."""
        row = pad(row, 11)
        self._rigid_grids(f"RTRPLT {row[0]}", row[1:4], row[4:7], row[8:11])

    def rbe1(self, row: list[str]) -> None:
        """RBE1: pairs of grid and components, those behind UM dependent."""
        what = f"{self.grids.file}: RBE1 {pad(row, 1)[0]}"
        # The first field of each further line is blank or UM.
        words = [text for text in row[1:] if text and "." not in text]
        at = [text.upper() for text in words].index("UM") if "UM" in map(str.upper, words) else len(words)
        self._add_body(what, self.motions.pairs(words[:at], what), self.motions.pairs(words[at + 1 :], what))

    def _add_body(self, what: str, independent: list[Motion], dependent: list[Motion]) -> None:
        self.equations.append(self.motions.rigid_equations(what, independent, dependent))

    def _add(self, what: str, A: Floats, motions: list[Motion], dependent: list[Motion]) -> None:
        self.equations.append(self.motions.solve(what, A, motions, dependent))

    def rrod(self, row: list[str]) -> None:
        """RROD: the distance of two grids stays, one component (CMA or CMB) depends."""
        row = pad(row, 5)
        what = f"{self.grids.file}: RROD {row[0]}"
        a, b = self.motions.row(row[1], what), self.motions.row(row[2], what)
        along = self.grids.xyz[b] - self.grids.xyz[a]
        if bool(row[3]) == bool(row[4]) or len(row[3] + row[4]) != 1 or not np.linalg.norm(along) > 0:
            raise InputError(f"{what}: expected two grids apart and one component, in CMA or in CMB")
        motions = [(grid, c) for grid in (a, b) for c in range(3)]
        A = np.concatenate([-along, along])[None, :] / np.linalg.norm(along)
        basic = np.array([self.motions.direction(motion)[:3] for motion in motions])
        A = np.hstack([A[:, 3 * i : 3 * i + 3] @ basic[3 * i : 3 * i + 3].T for i in range(2)])
        dependent = (a, components(row[3], what)[0]) if row[3] else (b, components(row[4], what)[0])
        self._add(what, A, motions, [dependent])

    def _rigid_grids(self, name: str, grids: list[str], kept: list[str], led: list[str]) -> None:
        """Grids of one rigid body with independent components ``kept`` and dependent ones ``led``, blank: all other."""
        what = f"{self.grids.file}: {name}"
        rows = [self.motions.row(label, what) for label in grids]
        if any(text.upper() in ("0", "") for text in kept):
            kept = ["" if text == "0" else text for text in kept]
        given = [components(text, what) if text else () for text in kept]
        follow = [components(text, what) if text not in ("", "0") else None for text in led]
        if not any(led):
            follow = [tuple(c for c in _ALL if c not in own) for own in given]
        dependent = [part or () for part in follow]
        if len(rows) == 2 and sorted(map(len, given)) == [0, 6]:
            first = len(given[0]) == 6
            master, slave, which = (rows[0], rows[1], dependent[1]) if first else (rows[1], rows[0], dependent[0])
            self._add_rigid(what, name.replace(" ", "_"), master, np.array([slave]), which)
            return
        self._add_body(
            what,
            [(row, c) for row, own in zip(rows, given, strict=True) for c in own],
            [(row, c) for row, own in zip(rows, dependent, strict=True) for c in own],
        )

    def _add_rigid(self, what: str, name: str, master: int, slaves: Ints, which: tuple[int, ...]) -> None:
        if not len(slaves) or (slaves == master).any():
            raise InputError(f"{what} ties no grids, or a grid to itself; check its fields", kind="conflict")
        if which in (_ALL, (0, 1, 2)) or not self.grids.cd[slaves].any():
            self.rigid.append(RigidElement(name=name, master=master, slaves=slaves, components=which))
            return
        independent = [(master, c) for c in _ALL]
        for slave in slaves.tolist():
            self._add_body(what, independent, [(slave, c) for c in which])

    def rbe3(self, row: list[str]) -> None:
        """RBE3: the motion of a reference as the mean of others."""
        row = pad(row, 7)
        what = f"{self.grids.file}: RBE3 {row[0]}"
        reference, which = self.motions.row(row[2], what), components(row[3], what)
        words = [text.upper() for text in row]
        end = next((i for i in range(4, len(row)) if words[i] in ("UM", "ALPHA")), len(row))
        stop = words.index("ALPHA") if "ALPHA" in words[end:] else len(row)
        weights = self._weights(row[4:end], what, reference)
        plain = all(moving[:3] == (0, 1, 2) for _, moving, _ in weights)
        rows = np.unique(np.concatenate([rows for *_, rows in weights]))
        turning = any(3 in moving or 4 in moving or 5 in moving for _, moving, _ in weights)
        turned = which not in (_ALL, (0, 1, 2)) and bool(self.grids.cd[reference])
        if turning and self.solid[rows].any():
            self.notes.append(f"RBE3 {row[0]} averages rotations of grids as well; those of solids have none.")
        if plain and not turned and "UM" not in words[end:] and (not turning or self.solid[rows].all()):
            weight = np.zeros(len(self.grids.ids))
            for value, _, own in weights:
                np.add.at(weight, own, value)
            self.average.append(
                AverageElement(
                    name=f"RBE3_{row[0]}", reference=reference, nodes=rows, weights=weight[rows], components=which
                )
            )
            return
        led = self.motions.pairs([text for text in row[end + 1 : stop] if text], what) if "UM" in words[end:] else []
        if led and len(led) != len(which):
            raise InputError(f"{what} names {len(led)} components behind UM; expected {len(which)}, as REFC has")
        self._mean_equations(what, reference, which, weights, led)

    def _weights(self, texts: list[str], what: str, reference: int) -> list[tuple[float, tuple[int, ...], Ints]]:
        """Groups of weight, components and rows of grids."""
        groups: list[tuple[float, tuple[int, ...], Ints]] = []
        words = [text for text in texts if text]
        starts = [i for i in range(len(words)) if i == 0 or "." in words[i]]
        for first, last in pairwise([*starts, len(words)]):
            weight, moving = real(words[first], what), components(pad(words[first:last], 2)[1], what)
            rows = self.motions.rows(labels_of(words[first + 2 : last], what, self.grids.ids), what)
            groups.append((weight, moving, rows))
        if (
            not sum(len(rows) for *_, rows in groups)
            or any(weight < 0 for weight, *_ in groups)
            or not any(weight > 0 for weight, *_ in groups)
            or any(reference in rows for *_, rows in groups)
        ):
            raise InputError(
                f"{what} has no grids with positive weights, or its own reference among them", kind="unsupported"
            )
        return groups

    def _mean_equations(
        self,
        what: str,
        reference: int,
        which: tuple[int, ...],
        weights: list[tuple[float, tuple[int, ...], Ints]],
        led: list[Motion],
    ) -> None:
        """Motion of the reference that fits those of the grids with the least squares of weighted differences.

        Rotations count with the square of the mean distance of the grids from the reference.
        """
        weight: dict[Motion, float] = {}
        for value, moving, rows in weights:
            for motion in ((row, c) for row in rows.tolist() for c in moving if c < 3 or not self.solid[row]):
                weight[motion] = weight.get(motion, 0.0) + value
        x, motions = self.grids.xyz[reference], list(weight)
        rows = np.unique([row for row, _ in motions])
        length = float(np.linalg.norm(self.grids.xyz[rows] - x, axis=1).mean()) or 1.0
        w = np.array([weight[motion] * (length**2 if motion[1] > 2 else 1.0) for motion in motions])
        R = self.motions.rigid_motion(motions, x) / np.array([1.0, 1.0, 1.0, length, length, length])
        normal = R.T @ (w[:, None] * R)
        if not np.linalg.cond(normal) < TOL.undetermined_normal_condition:
            raise InputError(
                f"{what}: its grids and components do not determine the motion of its reference; give it more of them",
                kind="unsupported",
            )
        own = np.array([self.motions.direction((reference, c)) for c in which])
        own[:, 3:] /= length
        G = own @ np.linalg.solve(normal, R.T * w)
        lead = [(reference, c) for c in which]
        A = np.hstack([np.eye(len(which)), -G])
        self._add(what, A, [*lead, *motions], led or lead)

    def mpc(self, cards: Rows, asked: set[int], has_control: bool) -> None:
        """The equations of MPC in the sets that are ``asked`` for, all where there is no case control."""
        if has_control and not asked:
            self.notes.append("MPC: not applied, the case control asks for none.")
            return
        sums: list[tuple[str, list[Term]]] = []
        for row in cards:
            what = f"{self.grids.file}: MPC {pad(row, 1)[0]} of grid {pad(row, 2)[1]}"
            if asked and integer(pad(row, 1)[0], what) not in asked:
                continue
            terms: list[Term] = []
            for at in [i for line in range(0, len(row), 8) for i in (line + 1, line + 4)]:
                label, component, value = pad(row[at : at + 3], 3)
                if label:
                    if component not in ("1", "2", "3", "4", "5", "6"):
                        raise InputError(f"{what} names the component {component or 0}; expected 1 to 6 of a grid")
                    grid = self.motions.row(label, what)
                    part = real(value, what) * self.motions.direction((grid, int(component) - 1))
                    # The largest is solved for where it is the first.
                    terms += sorted(terms_of(grid, part, int(component) - 1), key=lambda term: -abs(term[2]))
            sums.append((what, terms))
        if sums:
            self.equations.append(solved_for_first("MPC", sums))

    def conm2(self, row: list[str]) -> None:
        """CONM2: a mass with inertia at a grid."""
        row = pad(row, 14)
        what = f"{self.grids.file}: CONM2 {row[0]}"
        node = self.motions.row(row[1], what)
        system = integer(row[2], what)
        mass, *offset = (real(text, what) for text in row[3:7])
        i11, i21, i22, i31, i32, i33 = (real(text, what) for text in row[8:14])
        # The card gives int x1 x2 dm, which is the negative entry of the inertia.
        J = np.array([[i11, -i21, -i31], [-i21, i22, -i32], [-i31, -i32, i33]])
        x = np.array(offset)
        if mass < 0 or np.linalg.eigvalsh(J)[0] < -TOL.negative_inertia * np.abs(J).max():
            raise InputError(f"{what} has a negative mass or inertia; expected none", kind="unsupported")
        if system < 0:
            x = x - self.grids.xyz[node]
        elif system:
            kind, _, axes = self.systems.frame(system, self.grids)
            if kind != "R":
                raise InputError(f"{what} is given in the system {system}, which is not rectangular; expected one")
            x, J = x @ axes, axes.T @ J @ axes
        self.masses.append(
            PointMass(name=f"CONM2_{row[0]}", node=node, mass=mass * self.scale, inertia=J * self.scale, offset=x)
        )
