"""Bodies made of bodies: reduced bodies coupled at their interfaces, as a finite-element model to reduce again.

Each part is K, M, D in the degrees of freedom of its interfaces, turned and moved to its place, and scalars beside them
(Craig and Bampton 1968; Hurty 1965). Couplings are equations between interface degrees of freedom, or springs. Where a
part keeps nodes, these follow its coordinates, so that shapes of the assembly can be seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from morembs.body.stored import StoredBodies, StoredBody
from morembs.errors import InputError, nearest
from morembs.exporters.base import choose_body
from morembs.exporters.ports import ports_of_file
from morembs.exporters.reduced import to_interfaces
from morembs.importers.dependent_dofs import dependent_dofs
from morembs.linalg.columns import symmetric
from morembs.model import DofMap, FEModel, Nodes
from morembs.model.constraints import DependentDofs, Equations
from morembs.model.fe_model import SCALAR, rigid_motion
from morembs.problem.damping import STRUCTURAL

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Distance of two interfaces that are coupled, as part of the size of the assembly.
APART = 1e-6
# Force of rigid motion, part of what cancels in it and of the largest entry, that is round-off of a reduction.
STRAINED, NOTHING = 1e-6, 1e-10
ALL = (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True, kw_only=True, eq=False)
class Substructure:
    """A part of an assembly: one of ``bodies``, named ``reduction`` where there are several, at ``position`` (3,) in m,
    turned by ``rotation`` (3, 3).

    >>> stored = read_body(write_body("bar.h5", [body]))
    >>> part = Substructure(name="arm", bodies=stored, position=(0.4, 0, 0))
    """

    name: str
    bodies: StoredBodies
    reduction: str | None = None
    position: ArrayLike = (0.0, 0.0, 0.0)
    rotation: ArrayLike = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Couple:
    """Two interfaces ``between`` which ("part:INTERFACE") the ``components`` 0 to 5 are one, along the axes of the
    assembly; with ``stiffness`` (6,) in N/m and Nm/rad, and ``damping`` (6,), springs instead.

    >>> Couple(between=("upper:TIP", "lower:ROOT"), components=(0, 1, 2)).stiffness is None
    True
    """

    between: tuple[str, str]
    components: tuple[int, ...] = ALL
    stiffness: Sequence[float] | None = None
    damping: Sequence[float] | None = None


def assemble_bodies(parts: Sequence[Substructure], couples: Sequence[Couple], *, name: str = "assembly") -> FEModel:
    """The coupled parts as a model, whose node sets "part:INTERFACE" are for interfaces of the assembly.

    Peak memory: the matrices (sum of n^2) and, for the nodes that parts keep, their shapes twice.

    Raises:
        InputError: parts or interfaces that are not there, are apart or coupled twice, or bodies that are two-sided,
            have generalised forces or structural damping, or whose interfaces do not tell their rigid motion.

    >>> stored = read_body(write_body("bar.h5", [body]))
    >>> bars = [Substructure(name="a", bodies=stored), Substructure(name="b", bodies=stored, position=(0.4, 0, 0))]
    >>> assemble_bodies(bars, [Couple(between=("a:RIGHT", "b:LEFT"))]).size > 2 * 12
    True
    """
    names = [part.name for part in parts]
    if not parts or len(set(names)) < len(names) or any(":" in name for name in names):
        given = ", ".join(map(repr, names)) or "none"
        raise InputError(f"the parts {given} were given; expected one or more, each with a name of its own, no colons")
    placed = [_Placed.of(part) for part in parts]
    ends = np.cumsum([0, *(len(part.xyz) for part in placed)])
    first = dict(zip(names, ends.tolist(), strict=False))
    xyz = np.vstack([part.xyz for part in placed])
    sets = {f"{part.name}:{key}": rows + first[part.name] for part in placed for key, rows in part.sets.items()}
    nodes = Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz, sets=sets)
    dofs = DofMap(
        node=np.concatenate([part.node + first[part.name] for part in placed]),
        component=np.concatenate([part.component for part in placed]),
    )
    joints = _Joints(nodes, dofs, couples)
    # Interfaces that follow others altogether are these.
    nodes = replace(nodes, sets={key: joints.leading(rows) for key, rows in sets.items()})
    K, M, D = (sp.block_diag([part.matrices[key] for part in placed], "csr") for key in ("K", "M", "D"))
    K, D = K + joints.springs("stiffness"), D + joints.springs("damping")
    model = FEModel(K=K, M=M, D=D if D.nnz else None, nodes=nodes, dofs=dofs, source=name)
    equations = tuple(joints.equations())
    told = dict.fromkeys(f"{part.name}: {warning}" for part in parts for warning in part.bodies.warnings)
    own = "certificates of an assembly are against the bodies that were assembled, whose own errors are not in them"
    turning = (
        "inertia terms of second order in the elastic coordinates are not those of the parts, which matters where an "
        "assembly spins or turns fast: simulate the parts, coupled, there"
    )
    return replace(
        model, equations=equations, dependent=_with_shapes(model, equations, placed), warnings=(*told, own, turning),
        notes=(f"{len(parts)} bodies, {len(couples)} couplings",),
    )  # fmt: skip


def _with_shapes(model: FEModel, equations: Sequence[Equations], placed: Sequence[_Placed]) -> DependentDofs | None:
    """What follows what: the couplings, and the nodes that are seen, which follow the dofs of their part."""
    known = dependent_dofs(model, (), (), equations)
    if not any(part.basis.size for part in placed):
        return known
    if known is None:
        known = DependentDofs(S=sp.eye_array(model.size, format="csr"), owner=np.full(model.size, -1), names=())
    seen = np.concatenate([np.repeat([False, True], part.basis.T.shape) for part in placed])
    shapes = sp.block_diag([
        sp.block_array([[sp.csr_array((n, n)), None], [part.basis, sp.csr_array((rows, rows))]])
        for part in placed for rows, n in [part.basis.shape]
    ], "csr")  # fmt: skip
    S = sp.csr_array((sp.diags_array((~seen).astype(float)) + shapes) @ known.S)
    S.eliminate_zeros()
    owner = np.where(seen, len(known.names), known.owner)
    return DependentDofs(S=S, owner=owner, names=(*known.names, "shapes of the parts"))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Placed:
    """A part in its place: ``matrices`` in its dofs, of which the last follow the first by ``basis`` (last, first): the
    displacements of the nodes that it keeps. ``sets`` are the nodes of its interfaces."""

    name: str
    matrices: Mapping[str, sp.csr_array]
    xyz: Floats
    node: Ints
    component: Ints
    sets: Mapping[str, Ints]
    basis: Floats

    @classmethod
    def of(cls, part: Substructure) -> _Placed:
        source, body = part.bodies, choose_body(part.bodies, part.reduction, f"part {part.name!r}")
        turn, place = _rotation(part), np.asarray(part.position, dtype=float)
        _refuse(part.name, source, body)
        T, _ = to_interfaces(body, body.output_matrix)
        ports = ports_of_file(source)
        m, n = len(ports), T.shape[1]
        keys = list(dict.fromkeys((port.interface, port.node) for port in ports))
        at = {key: np.array([row for row, p in enumerate(ports) if (p.interface, p.node) == key]) for key in keys}
        node = np.empty(n, dtype=np.int64)
        for number, key in enumerate(keys):
            node[at[key]] = number
            _turn(T, at[key], [ports[row].component for row in at[key]], turn, part.name)
        node[m:] = 0
        points = np.array([ports[at[key][0]].point for key in keys])
        shown = np.flatnonzero(~np.isin(source.node_ids, [key[1] for key in keys]))
        basis = body.basis().reshape(-1, 3, n)[shown] @ T if len(shown) else np.zeros((0, 3, n))
        matrices = {"K": body.stiffness_matrix, "M": body.mass_matrix, "D": body.damping_matrix}
        component = np.concatenate([[port.component for port in ports], np.full(n - m, SCALAR)])
        empty = sp.csr_array((3 * len(shown), 3 * len(shown)))
        ready = {key: sp.block_diag([symmetric(T.T @ A @ T), empty], "csr") for key, A in matrices.items()}
        inside = np.vstack((points, source.coordinates[shown]))
        xyz = inside @ turn.T + place
        _refuse_loose(part.name, ready["K"], xyz[node[:m]], component[:m])
        if m == len(ALL):
            # One frame moves the part as a whole: what stiffness it seems to have is round-off.
            free = sp.diags_array((np.arange(ready["K"].shape[0]) >= m).astype(float))
            ready["K"] = sp.csr_array(free @ ready["K"] @ free)
        seen = np.arange(len(inside) - len(shown), len(inside))
        return cls(
            name=part.name, matrices=ready, xyz=xyz, node=np.concatenate([node, np.repeat(seen, 3)]),
            component=np.concatenate([component, np.tile([0, 1, 2], len(seen))]),
            sets={name: np.array([k for k, key in enumerate(keys) if key[0] == name]) for name in source.interfaces},
            basis=(turn @ basis).reshape(-1, n),
        )  # fmt: skip


def _rotation(part: Substructure) -> Floats:
    try:
        R, place = (np.asarray(value, dtype=float) for value in (part.rotation, part.position))
    except (TypeError, ValueError):
        raise InputError(f"part {part.name!r}: position or rotation are no numbers") from None
    if place.shape != (3,) or not np.isfinite(place).all() or not np.isfinite(R).all():
        raise InputError(f"part {part.name!r}: position = {place.tolist()} was given; expected three finite numbers")
    if R.shape != (3, 3) or not np.allclose(R.T @ R, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
        raise InputError(f"part {part.name!r}: rotation is no rotation matrix (3, 3); expected R'R = 1 and det R = 1")
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)


def _refuse(name: str, source: StoredBodies, body: StoredBody) -> None:
    """Refuse bodies that cannot be coupled."""
    if not source.interfaces:
        raise InputError(f"part {name!r}: body {body.name!r} has no interfaces to couple; reduce it with some")
    if not np.array_equal(body.output_matrix, body.input_matrix.T):
        raise InputError(f"part {name!r}: body {body.name!r} comes from a two-sided reduction; take a one-sided method")
    if not body.symmetric:
        raise InputError(f"part {name!r}: body {body.name!r} has gyroscopic or circulatory terms; couple full models")
    if (source.input_component == SCALAR).any():
        raise InputError(f"part {name!r}: its interfaces have generalised forces, which have no place; leave them out")
    if float(body.recipe.get(STRUCTURAL, 0.0)):
        raise InputError(
            f"part {name!r}: body {body.name!r} has structural damping; reduce the parts without it and give [damping] "
            "structural to the assembly"
        )


def _refuse_loose(name: str, K: sp.csr_array, points: Floats, component: Ints) -> None:
    """Refuse a body whose rigid motion its interfaces do not tell: it would strain it."""
    m = len(component)
    R = rigid_motion(points - points.mean(axis=0), component)
    force, size = K[:, :m] @ R, abs(K[:, :m]) @ np.abs(R)
    level = STRAINED * size.max(axis=0) + NOTHING * np.abs(K.data).max(initial=0.0) * np.abs(R).max(axis=0)
    if np.linalg.matrix_rank(R) < 6 or (np.abs(force) > level).any():
        raise InputError(
            f"part {name!r}: the motions of its interfaces do not tell its rigid motion (or the part is held); take "
            "interfaces with rotations or three nodes, of a free part"
        )


def _turn(T: Floats, rows: Ints, component: Sequence[int], turn: Floats, name: str) -> None:
    """Columns of T (n, n) for the dofs ``rows`` of a node along the axes of the assembly, in place."""
    for group in ((0, 1, 2), (3, 4, 5)):
        own = [row for row, c in zip(rows.tolist(), component, strict=True) if c in group]
        if len(own) == 3:
            T[:, own] = T[:, own] @ turn.T
        elif own and not np.array_equal(turn, np.eye(3)):
            raise InputError(f"part {name!r} is turned, and has an interface of one or two components; give three")


class _Joints:
    """Couplings as equations and springs between dofs."""

    def __init__(self, nodes: Nodes, dofs: DofMap, couples: Sequence[Couple]) -> None:
        self.nodes, self.size = nodes, len(dofs)
        self.dofs, self.table = dofs, dofs.table(len(nodes))
        self.reach = APART * float(np.ptp(nodes.xyz, axis=0).max(initial=0.0))
        self.pairs = [(couple, *self._ends(couple)) for couple in couples]

    def _ends(self, couple: Couple) -> tuple[Ints, Ints]:
        """Dofs (k,) of both sides in the same order."""
        sides = []
        if couple.between[0] == couple.between[1]:
            raise InputError(f"couple {couple.between}: both interfaces are one; expected two")
        for name in couple.between:
            if name not in self.nodes.sets:
                raise InputError(f"couple {couple.between}: there is no {name!r}; {nearest(name, self.nodes.sets)}")
            sides.append(self.nodes.sets[name])
        xyz = [self.nodes.xyz[rows] for rows in sides]
        what = " and ".join(couple.between)
        if len(sides[0]) != len(sides[1]):
            raise InputError(f"{what} have {len(sides[0])} and {len(sides[1])} nodes; couple interfaces that match")
        distance, match = cKDTree(xyz[1]).query(xyz[0])
        if distance.max() > self.reach or len(set(match.tolist())) < len(match):
            raise InputError(
                f"{what} are {distance.max():.3g} m apart; expected at most {self.reach:.1g} m, by their position and "
                "rotation"
            )
        components = list(couple.components)
        if not components or not all(isinstance(c, int) and c in ALL for c in components):
            raise InputError(f"{what}: components = {components} was given; expected some of 0 to 5")
        components = sorted(set(components))
        if couple.stiffness is not None and len(sides[0]) > 1:
            raise InputError(
                f"{what} have {len(sides[0])} nodes each, between which one spring has no place; take rigid or average "
                "interfaces for springs"
            )
        first, second = self.table[sides[0]][:, components], self.table[sides[1][match]][:, components]
        both = (first >= 0) & (second >= 0)
        if ((first >= 0) != (second >= 0)).any() or not both.any():
            raise InputError(f"{what} do not have the same components {components}; name those that both have")
        return first[both], second[both]

    def leading(self, rows: Ints) -> Ints:
        """The nodes that ``rows`` follow with all their dofs, themselves where they follow none."""
        leaders: dict[int, int] = {}

        def last(node: int) -> int:
            while node in leaders:
                node = leaders[node]
            return node

        for couple, first, second in self.pairs:
            if couple.stiffness is None and set(couple.components) == set(ALL):
                for a, b in zip(self.dofs.node[first].tolist(), self.dofs.node[second].tolist(), strict=True):
                    if last(a) != last(b):
                        leaders[last(b)] = last(a)
        return np.array([last(row) for row in rows.tolist()], dtype=np.int64)

    def equations(self) -> list[Equations]:
        """One for each rigid coupling: a dof of one side is that of the other."""
        follows: dict[int, int] = {}

        def leader(dof: int) -> int:
            while dof in follows:
                dof = follows[dof]
            return dof

        equations = []
        for couple, first, second in self.pairs:
            if couple.stiffness is not None:
                continue
            begin = len(follows)
            for a, b in zip(first.tolist(), second.tolist(), strict=True):
                a, b = leader(a), leader(b)
                if a == b:
                    raise InputError(f"{' and '.join(couple.between)} are coupled already, perhaps by way of others")
                follows[b] = a
            led = list(follows.items())[begin:]
            own, other = np.array(led, dtype=np.int64).T
            equations.append(
                Equations(
                    name=" - ".join(couple.between), nodes=self.dofs.node[own], components=self.dofs.component[own],
                    offsets=np.arange(len(own) + 1), term_nodes=self.dofs.node[other],
                    term_components=self.dofs.component[other], coefficients=np.ones(len(own)),
                )
            )  # fmt: skip
        return equations

    def springs(self, which: str) -> sp.csr_array:
        """``stiffness`` or ``damping`` (N, N) of the elastic couplings."""
        total = sp.csr_array((self.size, self.size))
        for couple, first, second in self.pairs:
            values = getattr(couple, which)
            if values is None:
                continue
            if len(values) != len(ALL) or not np.isfinite(values).all() or min(values) < 0 or couple.stiffness is None:
                raise InputError(
                    f"{' and '.join(couple.between)}: {which} = {list(values)} was given; expected six numbers, zero "
                    "or more, and damping beside stiffness"
                )
            k = np.asarray(values, dtype=float)[self.dofs.component[first]]
            rows, columns = [first, second, first, second], [first, second, second, first]
            entries = np.concatenate([k, k, -k, -k]), (np.concatenate(rows), np.concatenate(columns))
            total = total + sp.csr_array(entries, shape=total.shape)
        return total
