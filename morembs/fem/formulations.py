"""How solid elements take the strain of their displacements, and their mass: formulations by name.

A formulation is a matrix B at points of volume dV that takes the displacements of an element's nodes to strains, so
that K = sum B' C B dV, and a stiffness against shapes that no strain sees. Stresses and geometric stiffness take
the strains of the same B. Programs have different ones for their element types.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.fem.elements import BAR, IRONS, STROUD, TYPES, ElementType, Order, Rule
from morembs.fem.mesh import ElementBlock
from morembs.fem.tolerances import TOL

LINEAR = ("tet4", "hex8", "wedge6")
# Rules of the mass and the types that they are for; "reduced" takes the points of the stiffness, "row-sum" is lumped,
# "irons" has 14 points, and "stroud" 15, which differ from the exact mass where sides are curved.
MASSES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"exact": tuple(TYPES), "reduced": tuple(TYPES), "row-sum": LINEAR, IRONS: ("hex20",), STROUD: ("tet10",)}
)


@dataclass(frozen=True)
class Geometry:
    """Elements at quadrature points: ``dN`` (ne, nq, k, 3) gradients along x, y, z; ``dV`` (ne, nq) volumes."""

    dN: Floats
    dV: Floats

    @property
    def mean(self) -> Geometry:
        """The mean gradients, at one point of the whole volume."""
        V = self.dV.sum(axis=1, keepdims=True)
        return Geometry(np.einsum("eqkb,eq->ekb", self.dN, self.dV / V, optimize=True)[:, None], V)


def jacobian(x: Floats, rule: Rule) -> Floats:
    """Isoparametric Jacobians (ne, nq, 3, 3) of elements with node coordinates ``x`` (ne, k, 3)."""
    return np.asarray(np.einsum("eka,qkr->eqar", x, rule.dN, optimize=True))


def geometry(x: Floats, rule: Rule, ids: Ints, kind: ElementType) -> Geometry:
    """Gradients and volumes at the points of ``rule``.

    Raises:
        InputError: elements that are inside out there; ``ids`` (ne,) are their labels.
    """
    J = jacobian(x, rule)
    det = np.linalg.det(J)
    scale = np.abs(det).max(axis=1, initial=0.0)
    # Sizes whose squares a double cannot hold, and what is not a number, are as bad as no size.
    outside = ~((scale > TOL.least_jacobian) & (scale < TOL.largest_jacobian))
    bad = np.flatnonzero(~(det > TOL.flat_element * scale[:, None]).all(axis=1) | outside)
    if len(bad):
        raise InputError(
            f"{len(bad)} {kind.name} elements are inverted or degenerate: {', '.join(map(str, ids[bad[:5]]))}"
            f"{', ...' if len(bad) > 5 else ''} (Jacobian not positive); mend the mesh or its node order",
            kind="model",
        )
    inverse = np.linalg.inv(J)
    dN = np.matmul(rule.dN[None], inverse)
    return Geometry(dN, det * rule.weights)


def strain_operator(dN: Floats) -> Floats:
    """B (..., 6, 3k) of gradients ``dN`` (..., k, 3): strains xx, yy, zz, yz, zx, xy (shear doubled)."""
    k = dN.shape[-2]
    B = np.zeros((*dN.shape[:-2], 6, k, 3))
    x, y, z = dN[..., 0], dN[..., 1], dN[..., 2]
    B[..., 0, :, 0] = B[..., 4, :, 2] = B[..., 5, :, 1] = x
    B[..., 1, :, 1] = B[..., 3, :, 2] = B[..., 5, :, 0] = y
    B[..., 2, :, 2] = B[..., 3, :, 1] = B[..., 4, :, 0] = z
    return B.reshape(*dN.shape[:-2], 6, 3 * k)


@dataclass(frozen=True)
class Elements:
    """Elements of one block as a formulation sees them.

    ``x`` (ne, k, 3) are the places of their nodes, ``C`` (ne, 6, 6) their elastic constants, ``rule`` is where
    ``here`` was taken.
    """

    kind: ElementType
    x: Floats
    C: Floats
    rule: Rule
    here: Geometry


@dataclass(frozen=True, kw_only=True)
class Formulation:
    """How the strain is taken.

    ``about`` says it in words. ``orders`` maps the types that it is for to the degree that its points integrate; None
    is every type with the degree of its field. ``mean`` takes the mean strain at one point in the centre; ``change``
    makes another B (ne, nq, 6, 3k) of that of the gradients, in place, and ``hourglass`` (ne, k, k) is added to the
    stiffness along each axis. With ``has_modes`` these are dofs of the model, and ``change`` is their part
    at rest.
    """

    about: str
    orders: Mapping[str, Order] | None = None
    mean: bool = False
    change: Callable[[Floats, Elements], None] | None = None
    hourglass: Callable[[Elements], Floats] | None = None
    has_modes: bool = False

    @property
    def is_plain(self) -> bool:
        """True if strains are those of the gradients at the points, and nothing else."""
        return not (self.mean or self.change or self.hourglass)

    def points(self, kind: ElementType) -> Rule:
        """Where strains and stresses are."""
        return kind.rule(1) if self.mean else self.integration(kind)

    def elements(self, kind: ElementType, x: Floats, ids: Ints, C: Floats) -> Elements:
        """Elements with node coordinates ``x`` (ne, k, 3), labels ``ids`` and constants ``C`` (ne, 6, 6) in Pa.

        Raises:
            InputError: elements that are inside out.
        """
        rule = self.integration(kind)
        here = geometry(x, rule, ids, kind)
        return Elements(kind, x, C, self.points(kind), here.mean if self.mean else here)

    def operator(self, elements: Elements) -> Floats:
        """B (ne, nq, 6, 3k)."""
        B = strain_operator(elements.here.dN)
        if self.change is not None:
            self.change(B, elements)
        return B

    def change_of_strains(self, elements: Elements) -> Floats | None:
        """What ``change`` adds to B (ne, nq, 6, 3k); None without one."""
        return None if self.change is None else self.operator(elements) - strain_operator(elements.here.dN)

    def integration(self, kind: ElementType) -> Rule:
        """Where gradients and volumes are taken."""
        return kind.rule(kind.stiffness_order if self.orders is None else self.orders[kind.name])


def _mean_dilatation(B: Floats, elements: Elements) -> None:
    """B-bar: the volume strain is its mean over the element (Nagtegaal, Parks, Rice 1974; Hughes 1980)."""
    dN = elements.here.dN
    change = (elements.here.mean.dN - dN) / 3
    B[:, :, :3] += change.reshape(*dN.shape[:2], 1, -1)


def mode_strains(elements: Elements, *, patched: bool) -> Floats:
    """Strains (ne, nq, 6, 9) of three more functions 1 - xi_k^2 along three axes, with the Jacobian in the centre
    (Wilson 1973); ``patched`` gradients det J0 / det J make pass the patch test (Taylor, Beresford, Wilson 1976)."""
    here, rule = elements.here, elements.rule
    centre = jacobian(elements.x, elements.kind.rule(1))[:, 0]
    # The cube is [0, 1]^3 here: -4 of the coordinates that run from -1 to 1.
    g = -4 * (2 * rule.points - 1)[None, :, :, None] * np.linalg.inv(centre)[:, None]
    if patched:
        g = g * (np.linalg.det(centre)[:, None] * rule.weights / here.dV)[..., None, None]
    return strain_operator(g)


def _condense(B: Floats, elements: Elements, inner: Floats) -> None:
    """What modes with the strains ``inner`` (ne, nq, 6, m) add at rest."""
    weighted = np.matmul(elements.C[:, None], inner) * elements.here.dV[..., None, None]
    ne, nq, _, modes = inner.shape
    left = weighted.reshape(ne, nq * 6, modes).transpose(0, 2, 1)
    Kii, Kiu = (np.matmul(left, part.reshape(ne, nq * 6, -1)) for part in (inner, B))
    B -= np.matmul(inner, np.linalg.solve(Kii, Kiu)[:, None])


def _incompatible_modes(B: Floats, elements: Elements) -> None:
    _condense(B, elements, mode_strains(elements, patched=True))


def _inner_modes(B: Floats, elements: Elements) -> None:
    _condense(B, elements, mode_strains(elements, patched=False))


def _against_hourglasses(elements: Elements) -> Floats:
    """Stiffness (ne, 8, 8) of the four shapes that the mean strain does not see (Flanagan, Belytschko 1981)."""
    r = 2 * elements.kind.reference - 1
    shapes = np.array([r[:, 0] * r[:, 1], r[:, 1] * r[:, 2], r[:, 2] * r[:, 0], r.prod(axis=1)])
    g = elements.here.dN[:, 0]
    # Orthogonal to all linear fields, also on distorted elements: rigid motion and constant strain have no force.
    gamma = shapes - np.einsum("eij,ehj->ehi", g, np.einsum("hi,eij->ehj", shapes, elements.x))
    size = TOL.hourglass_stiffness * _modulus(elements.C) * elements.here.dV[:, 0] * np.square(g).sum(axis=(1, 2))
    return np.asarray(size[:, None, None] * np.matmul(gamma.transpose(0, 2, 1), gamma))


def _modulus(C: Floats) -> Floats:
    """Young's modulus (ne,) of isotropic constants (ne, 6, 6), the first constant of others."""
    lam, mu = C[:, 0, 1], C[:, 3, 3]
    isotropic = np.zeros_like(C)
    isotropic[:, :3, :3] = lam[:, None, None]
    isotropic[:, range(6), range(6)] += mu[:, None] * np.array([2, 2, 2, 1, 1, 1])
    alike = np.abs(C - isotropic).max(axis=(1, 2)) <= TOL.isotropic * C[:, 0, 0]
    return np.where(alike, mu * (3 * lam + 2 * mu) / np.where(alike, lam + mu, 1.0), C[:, 0, 0])


FORMULATIONS: Mapping[str, Formulation] = MappingProxyType(
    {
        "full": Formulation(about="the field, with as many points as it needs"),
        "b-bar": Formulation(about="the mean volume strain", orders={"hex8": 3}, change=_mean_dilatation),
        "mean-strain": Formulation(
            about="the mean strain, with hourglass stiffness",
            orders={"hex8": 3},
            mean=True,
            hourglass=_against_hourglasses,
        ),
        "incompatible": Formulation(
            about="three incompatible modes, condensed", orders={"hex8": 3}, change=_incompatible_modes
        ),
        "inner-modes": Formulation(
            about="three incompatible modes as dofs with mass", orders={"hex8": 3}, change=_inner_modes, has_modes=True
        ),
        "reduced": Formulation(about="8 points (hexahedra) or 2 (wedges)", orders={"hex20": 3, "wedge6": (1, 3)}),
        "irons": Formulation(about="14 points", orders={"hex20": IRONS}),
        "bar": Formulation(about="2 points along a bar, 5 times 5 in its section", orders={"hex20": BAR}),
    }
)


def formulation_of(block: ElementBlock) -> Formulation:
    """The formulation of a block.

    Raises:
        InputError: the block names a formulation or a mass that does not exist, or is not for its type.
    """
    for what, name, table in (("formulation", block.formulation, _TYPES_OF), ("mass", block.mass, MASSES)):
        if name not in table:
            raise InputError(
                f"{what} = {name!r} was given for elements {block.type}; {nearest(name, tuple(table))}",
                kind="unknown",
                keyword=what,
            )
        if block.type not in table[name]:
            raise InputError(
                f"{what} = {name!r} was given for elements {block.type}; it is for {', '.join(table[name])}",
                kind="conflict",
                keyword=what,
            )
    return FORMULATIONS[block.formulation]


_TYPES_OF = {name: tuple(formulation.orders or TYPES) for name, formulation in FORMULATIONS.items()}


def mass_rule(block: ElementBlock, rule_name: str) -> Rule:
    """Where ``element_mass`` integrates."""
    kind = TYPES[block.type]
    if rule_name == "reduced":
        return formulation_of(block).integration(kind)
    return kind.rule(rule_name if rule_name in (IRONS, STROUD) else kind.mass_order)


def element_mass(block: ElementBlock, rule_name: str, x: Floats, density: Floats) -> Floats:
    """Scalar mass (ne, k, k) in kg of elements with node coordinates ``x`` (ne, k, 3) and ``density`` (ne,) in kg/m3.

    The Jacobian is checked where the stiffness is integrated, as FE codes do; a strongly curved element
    whose Jacobian dips below zero in a corner still has its exact mass.
    """
    kind, formulation = TYPES[block.type], formulation_of(block)
    rule = mass_rule(block, rule_name)
    dm = np.linalg.det(jacobian(x, rule)) * rule.weights * density[:, None]
    if rule_name == "reduced" and formulation.mean:
        rule, dm = formulation.points(kind), dm.sum(axis=1, keepdims=True)
    if rule_name == "row-sum":
        return np.asarray((dm @ rule.N)[:, :, None] * np.eye(kind.n_nodes))
    NN = np.einsum("qa,qb->qab", rule.N, rule.N).reshape(len(rule.weights), -1)
    return np.asarray((dm @ NN).reshape(len(x), kind.n_nodes, kind.n_nodes))
