"""The elastic body, made of a reduced model or read from a file, for simulators and their users. SI units."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import PositiveCount
from morembs.base.summary import hertz, kinds_words, summarised
from morembs.base.types import Complexes, Floats, Ints
from morembs.body.floating.frame import FloatingFrame
from morembs.body.floating.ranking import RankedTerm
from morembs.body.floating.spin import ReducedSpin
from morembs.body.parametric_parts import ParametricParts
from morembs.body.recovery_shapes import RECOVERY, Recovery, recovery_parts
from morembs.body.tolerances import TOL
from morembs.body.view import Viewed
from morembs.certificate.record import CERTIFICATE, Certificate
from morembs.fem.fe_model import STRUCTURAL
from morembs.responses.static_mode_tables import StaticModeTables
from morembs.storage.table import Later, Row, Table, dataset, repeat_table, table_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from morembs.body.vtkhdf_series import Grid, View
    from morembs.reducers.base import ReducedModel

# Why a body has no value for a field that is read later.
MISSING = {
    "switching": 'has no static modes of candidate loads; reduce with method = "static-modes-switching"',
    "parameters": 'has no parameters; make it with method = "parametric"',
    "recovery": "has no stress recovery; write the file with [stress], or ask for no stress",
}


def _codes(body: Body) -> list[int]:
    # Not at the top: files are shown without what reduces.
    from morembs.reducers.base import MODE_KINDS

    return [MODE_KINDS.index(kind) for kind in body.mode_kind]


def _spin(body: Body) -> ReducedSpin | None:
    """In a file the elongation is that of the nodes."""
    if body.spin is None or body.part is None:
        return body.spin
    return replace(body.spin, elongation=body.part.transformation @ body.spin.elongation)


def _recovery(body: Body) -> Mapping[str, Any] | None:
    return recovery_parts(body.recovery(), body.part and body.part.transformation) if body.recovery else None


class Source(Protocol):
    """The file that a body was read from."""

    def modes(self, body: str, count: int) -> Floats:
        """Shapes (k, n, 3) of the first elastic modes."""
        ...

    def outline(self) -> tuple[Grid, Ints, dict[str, Floats]]:
        """Its cells, labels of their nodes, and points of the interfaces."""
        ...

    def parametric(self, body: Body) -> Any:
        """The body at other values of its parameters."""
        ...


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Body(Viewed):
    """One elastic body: made of a ``model`` of a ``part``, or read from its ``file``.

    Attributes, for n coordinates and m interface dofs:

    - ``mass_matrix``, ``stiffness_matrix``, ``damping_matrix`` (n, n);
    - ``input_matrix`` (n, m), ``output_matrix`` (m, n), the transpose of ``input_matrix`` if the body is symmetric;
    - ``frequencies_hz`` (n,): eigenfrequencies of the body, ascending, rigid-body modes zero;
    - ``full_frequencies_hz``: eigenfrequencies of the full model with its interfaces, if they were computed;
    - ``certificate``: limits of the error, or None;
    - ``floating``: terms of large rotations; None for a supported or unsymmetric body;
    - ``ranking``: importance of these terms;
    - ``spin``: matrices in a frame that rotates with the body.

    Methods read large data from the file: ``basis(columns)`` displacements (3 N, k) of the nodes for the chosen
    coordinates, ``recovery()`` stresses, ``switching()`` static modes of candidate loads, ``parameters()`` matrices
    at other parameter values. ``if body.recovery:`` tests whether the file has the data; the same holds for
    ``switching`` and ``parameters``.

    >>> body.reduced.order, body.floating.kind
    (18, 'mean-axes')
    >>> body
    Body: name craig-bampton; order 18; elastic frequencies ...
    """

    name: str
    mass_matrix: Floats = dataset("real", "n n", "reduced matrix, symmetric", doc="M, symmetric")
    stiffness_matrix: Floats = dataset("real", "n n", "reduced matrix, symmetric", doc="K, symmetric")
    damping_matrix: Floats = dataset(
        "real",
        "n n",
        "reduced matrix, symmetric",
        doc="D, symmetric but for G, its skew part; structural damping is not in it but in the recipe",
    )
    input_matrix: Floats = dataset("real", "n m", "forces on the coordinates; the transpose gives the motions", doc="B")
    frequencies_hz: Floats = dataset(
        "any",
        "n",
        "eigenfrequencies, undamped, ascending",
        "Hz",
        doc="undamped eigenfrequencies of K, M, ascending; rigid ones 0",
    )
    full_frequencies_hz: Floats | None = dataset(
        "any",
        "any",
        "those of the full model as far as computed",
        "Hz",
        default=None,
        doc="those of the full coupled model as far as computed",
        when="absent if none were",
    )
    damping_ratios: Floats | None = dataset(
        "real",
        "n",
        "ratio of critical damping of each mode, rigid ones zero; structural damping is not in it",
        default=None,
        since="0.2",
        when="absent in two-sided bodies",
    )
    mode_kind: tuple[str, ...] = dataset(
        "code", "n", "kind of each coordinate, code of /mode_kinds", write=_codes, largest="kinds-1"
    )
    rigid_count: int = dataset(
        "whole",
        "",
        "number of rigid-body motions",
        doc="number of rigid-body motions the coordinates span",
        largest="n",
    )
    recipe: Mapping[str, Any] = dataset(
        "json", "", "options of the reduction, as JSON", doc="options of the reduction, as JSON with sorted keys"
    )
    output_matrix: Floats = dataset(
        "real",
        "m n",
        "interface degrees of freedom; not the transpose of input_matrix",
        doc="C",
        when="only where it is not B', and then the format version is 2",
        write=lambda body: None if body.reduced.symmetric else body.output_matrix,
    )
    certificate: Certificate | None = dataset(
        CERTIFICATE,
        default=None,
        doc="how wrong the body is, if that was asked for: see [certificate](schema/conventions.md#certificate)",
        when="if",
    )
    floating: FloatingFrame | None = dataset(
        table_of(FloatingFrame), name="floating_frame", default=None, when="free bodies with symmetric matrices"
    )
    ranking: tuple[RankedTerm, ...] = dataset(
        repeat_table(table_of(RankedTerm)),
        default=(),
        when="where the job has an envelope",
        write=lambda body: body.ranking or None,
    )
    spin: ReducedSpin | None = dataset(
        table_of(ReducedSpin), default=None, when="where the job has [spin]", write=_spin
    )
    switching: Later[StaticModeTables] = dataset(
        table_of(StaticModeTables),
        default=None,
        later=True,
        doc="static modes of candidate loads, if the method was `static-modes-switching`: see "
        "[switching](../howto/switching.md#in-the-body-file)",
        when="if",
    )
    parameters: Later[ParametricParts] = dataset(
        table_of(ParametricParts),
        name="parametric",
        default=None,
        later=True,
        doc="the body at other values of its parameters, if the method was `parametric`: see [parametric "
        "bodies](../howto/parametric.md)",
        when="if",
    )
    recovery: Later[Recovery] = dataset(
        RECOVERY,
        default=None,
        later=True,
        doc="stress shapes, if they were asked for: see [stress](schema/conventions.md#stress)",
        when="if",
        write=_recovery,
    )
    basis: Callable[..., Floats] = dataset(
        "later",
        "3N n",
        "row 3 i + c: displacement of node i along axis c per unit of each coordinate",
        doc="Phi: displacements of the nodes, in [this order](schema/conventions.md#order-of-the-dofs)",
        columns=True,
        later=True,
    )
    part: Any = None
    model: ReducedModel | None = None
    file: Source | None = None

    def __post_init__(self) -> None:
        for name, why_not in MISSING.items():
            value = vars(self)[name]
            if not isinstance(value, Later):
                there = Later.of(value) if value is not None else Later(why_not=f"body {self.name!r} {why_not}")
                object.__setattr__(self, name, there)

    def _facts(self) -> dict[str, object]:
        return {
            "name": self.name,
            "order": len(self.stiffness_matrix),
            "elastic frequencies": hertz(self.frequencies_hz[self.rigid_count :]),
            "error": "not certified" if self.certificate is None else self.certificate.words,
            "coordinates": kinds_words(self.mode_kind),
            "mass": None if self.part is None else f"{self.part.mass:.4g} kg",
            "frame": None if self.floating is None else self.floating.kind,
        }

    @property
    def has_recovery(self) -> bool:
        """True if there are stress shapes."""
        return bool(self.recovery)

    @property
    def has_switching(self) -> bool:
        """True if there are static modes of candidate loads."""
        return bool(self.switching)

    @property
    def has_parameters(self) -> bool:
        """True if the body can be evaluated at other values."""
        return bool(self.parameters)

    @property
    def matrices(self) -> tuple[Floats, Floats, Floats]:
        """M, K, D (n, n), at rest where the body may spin."""
        return self.mass_matrix, self.stiffness_matrix, self.damping_matrix

    @property
    def symmetric(self) -> bool:
        """True if all matrices are symmetric: one-sided, without gyroscopic and circulatory terms."""
        both = self.stiffness_matrix, self.damping_matrix
        return self._one_sided and all(
            np.abs(A - A.T).max(initial=0.0) <= TOL.asymmetry * np.abs(A).max(initial=0.0) for A in both
        )

    @property
    def _one_sided(self) -> bool:
        return bool(np.array_equal(self.output_matrix, self.input_matrix.T))

    def frequency_response(self, frequencies_hz: Any) -> Complexes:
        """Motions of the interfaces (nf, m, m) under unit loads at ``frequencies_hz`` (nf,), rigid motion included."""
        return self.reduced.frequency_response(frequencies_hz)

    @cached_property
    def reduced(self) -> ReducedModel:
        """The reduced model; that of a body from a file has no basis, and can be certified again."""
        from morembs.reducers.base import ReducedModel

        if self.model is not None:
            return self.model
        V, W = (np.zeros((0, len(self.stiffness_matrix))) for _ in range(2))
        return ReducedModel(
            name=self.name,
            M=self.mass_matrix,
            K=self.stiffness_matrix,
            D=self.damping_matrix,
            B=self.input_matrix,
            C=self.output_matrix,
            V=V,
            W=None if self.symmetric else V if self._one_sided else W,
            mode_kind=self.mode_kind,
            rigid_count=self.rigid_count,
            recipe=self.recipe,
            structural=float(self.recipe.get(STRUCTURAL, 0.0)),
        )

    @property
    def parametric(self) -> Any:
        """The body at other values of its parameters, a ``ParametricBody``.

        Raises:
            InputError: it has no parameters, was not read from a file, or the file is gone or damaged.
        """
        return self._source.parametric(self) if self.parameters else self.parameters()

    def modes(self, count: int) -> Floats:
        """Shapes (k, n, 3) of the first elastic modes at the chosen nodes, at most ``count``, of unit modal mass.

        Those of a body from a file are the ones that it keeps for ParaView, of single precision.

        Raises:
            InputError: no positive count was asked for, or the file is gone or damaged.
        """
        check_value("modes", count, PositiveCount)
        if self.part is None or self.model is None:
            return self._source.modes(self.name, count)
        first = self.rigid_count
        Y = self.model.modes()[1][:, first : first + count]
        shapes = self.part.transformation @ (self.model.V @ Y)
        return np.asarray(shapes).T.reshape(Y.shape[1], -1, 3)

    def _picture(self) -> str:
        try:
            return self.view(TOL.drawn_modes)._repr_html_()
        except InputError:
            return ""  # there is nothing to show

    def plot_response(self, frequencies_hz: Any = None, entries: Sequence[tuple[int, int]] | None = None) -> Figure:
        """Size and phase of the frequency response, drawn with Matplotlib.

        Args:
            frequencies_hz: (nf,), by default from below the first elastic mode to beyond the last.
            entries: pairs (motion, load), rows of ``output_matrix`` and columns of ``input_matrix`` counted from 1; by
                default the first six motions, each under its own load.

        Raises:
            InputError: an entry that is not there, no frequencies, or none for a body without elastic modes.

        >>> body.plot_response(entries=[(1, 1), (7, 1)]).savefig("response.png")
        """
        from morembs.body.charts import response_chart

        return response_chart(self, frequencies_hz, entries).figure()

    def plot_modal_density(self) -> Figure:
        """Modes below each frequency and modes per Hz, beside those of the full model where they are known.

        Raises:
            InputError: no elastic modes.

        >>> body.plot_modal_density().savefig("density.png")
        """
        from morembs.body.charts import density_chart

        own = {self.name: self.frequencies_hz[self.rigid_count :]}
        return density_chart(own, self.full_frequencies_hz).figure()

    def plot_mac(self, other: Body | None = None, modes: int = 10) -> Figure:
        """Modal assurance criterion of the first elastic ``modes`` with those of an ``other`` body at the same nodes.

        By default with its own: entries off the diagonal then say what the chosen nodes cannot tell apart.

        Raises:
            InputError: bodies at other nodes, or that keep no modes.

        >>> body.plot_mac().savefig("mac.png")
        """
        from morembs.body.charts import mac_chart

        return mac_chart(self, other, modes).figure()

    def plot_campbell(self, speeds: Sequence[float] | None = None, count: int = 12) -> Figure:
        """Campbell diagram: the ``count`` lowest frequencies over ``speeds`` in rad/s, by default those of [spin].

        Raises:
            InputError: a body without spin matrices, or a speed out of range.
        """
        from morembs.body.charts import campbell_chart

        return campbell_chart(self, speeds, count).figure()

    def view(self, modes: int = TOL.viewed_modes) -> View:
        """The first elastic ``modes``, or as many as there are: a notebook shows them as they move, and ``plot`` and
        ``to_pyvista`` draw them.

        Raises:
            InputError: no positive count was asked for, the body keeps no nodes, or its file is gone or damaged.
        """
        # Not at the top: most who read a file do not look at shapes.
        from morembs.body.view_scene import scene_of_view
        from morembs.body.vtkhdf_series import View

        check_value("modes", modes, PositiveCount)
        if self.part is not None and not self.part.cells:
            raise InputError(f'{self.name} keeps no nodes; keep nodes = "all", "skin" or "interfaces"')
        grid, node_ids, interfaces = (self._source if self.part is None else self.part).outline()
        motion = self.modes(modes)
        return View(
            body=self.name,
            grid=grid,
            node_ids=node_ids,
            motion=motion,
            frequencies_hz=self.frequencies_hz[self.rigid_count :][: len(motion)],
            interfaces=interfaces,
            scene=scene_of_view,
        )

    @property
    def _source(self) -> Source:
        """Where the body was read.

        Raises:
            InputError: it was not.
        """
        if self.file is None:
            raise InputError(f"body {self.name!r} is in no file yet; write it, and take that of read_body")
        return self.file

    def to_pymor(self) -> Any:
        """The reduced model as a ``pymor.models.iosys.SecondOrderModel``; see ``morembs.to_pymor``."""
        from morembs.reducers.pymor import to_pymor

        return to_pymor(self.reduced)


# The name until 1.0 of a body that was just made.
ElasticBody = Body
BODY = table_of(Body, build=dict)


def _unsymmetric(row: Row) -> Row:
    return replace(row, about=row.about.replace("symmetric", "not symmetric", 1).partition("; the transpose")[0])


# What is said of matrices that are not symmetric.
UNSYMMETRIC = Table(tuple(map(_unsymmetric, BODY)))
