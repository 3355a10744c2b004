"""What a body file holds, a row for each dataset: its writer, reader and check go by these, and docs/schema.md too.

Sizes: n coordinates of a body, ne elastic ones, m inputs, N nodes, s nodes of an interface, np points with stress.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.body.floating.frame import FloatingFrame, InterfaceMarker
from morembs.body.floating.integrals import ShapeIntegrals
from morembs.body.floating.ranking import RankedTerm
from morembs.body.floating.spin import ReducedSpin
from morembs.body.floating.stiffening import Stiffening
from morembs.storage.table import Row, Table

if TYPE_CHECKING:
    from morembs.body.parametric_parts import ParametricParts
    from morembs.certificate.certify import Certificate
    from morembs.reducers.switching_tables import StaticModeTables


def _stiffening(terms: tuple[str, ...] = (), share: Any = (), load: Any = (), **values: Any) -> Stiffening:
    share, load = (dict(zip(terms, np.asarray(column).tolist(), strict=True)) for column in (share, load))
    return Stiffening(share=share, load=load, **values)


def _stiffening_parts(stiffening: Stiffening) -> Mapping[str, object]:
    share, load = stiffening.share, [stiffening.load.get(name, 1.0) for name in stiffening.share]
    rows = {"terms": list(share), "share": list(share.values()), "load": load, "dropped": stiffening.dropped}
    return vars(stiffening) | {name: row or None for name, row in rows.items()}


def _frame_parts(frame: FloatingFrame) -> Mapping[str, object]:
    return vars(frame) | {"interfaces": frame.interfaces or None}


def _ranking(terms: tuple[str, ...], equations: tuple[str, ...], share: Any) -> tuple[RankedTerm, ...]:
    rows = zip(terms, equations, share.tolist(), strict=True)
    return tuple(RankedTerm(name=name, equation=equation, share=part) for name, equation, part in rows)


def _ranking_parts(terms: Sequence[RankedTerm]) -> Mapping[str, object]:
    names, equations, share = zip(*((term.name, term.equation, term.share) for term in terms), strict=True)
    return {"terms": names, "equations": equations, "share": share}


def _certificate_parts(certificate: Certificate) -> Mapping[str, Any]:
    limits = {name: (limit.lower, limit.upper, limit.at_hz) for name, limit in certificate.limits.items()}
    more = {name: getattr(certificate, name) for name in ("bound_kind", "absolute_error")}
    proof = {"lemmas": [asdict(lemma) for lemma in certificate.proof]} if certificate.proof else None
    return vars(certificate) | more | {"limits": limits, "proof": proof, "version": FormatVersion.CERTIFICATE}


def _parametric(**values: Any) -> ParametricParts:
    # Not at the top: files are shown without what evaluates them.
    from morembs.body.parametric_parts import ParametricParts

    return ParametricParts.of_rows(**values)


def _parametric_parts(parts: ParametricParts) -> Mapping[str, object]:
    return parts.rows()


def _switching(**values: Any) -> StaticModeTables:
    # Not at the top: files are shown without what reduces.
    from morembs.reducers.switching_tables import StaticModeTables

    return StaticModeTables(**values)


FORMAT = "morembs-body"


class FormatVersion:
    """Versions of the format ``morembs-body``."""

    # Transposed input matrices are output matrices, and all matrices are symmetric.
    PLAIN = 1
    # Output matrices of their own.
    TWO_BASES = 2
    # Gyroscopic and circulatory matrices.
    SKEW_PARTS = 3
    # The latest that is read.
    LATEST = SKEW_PARTS
    # Of certificates: limits hold at every frequency of a band; without a version there are errors at samples.
    CERTIFICATE = 2


_OLD = "files of earlier versions lack it"
_MAYBE = "may be absent"

# A row a dataset.
# fmt: off
CERTIFICATE = Table((
    Row("version", "whole", "", "2: limits on every frequency of the band", when=_OLD),
    Row("band_hz", "real", "2", "the limits hold from here to there", "Hz", when=_OLD),
    Row("measure", "text", "", "the limit that counts", when=_OLD,
        doc="the limit that counts: `envelope`, `peak` or `pointwise`"),
    Row("damping_floor", "real", "", "ratio of critical damping assumed in the full model and the body", when=_OLD),
    Row("limits/*", "any", "3", "largest error over the band: at least, at most, where the former is, Hz",
        doc="`envelope`, `peak`, `pointwise`: largest error over the band: a value that is reached, one that is not "
        "exceeded (infinite where there is none), and the frequency of the former in Hz"),
    Row("block_limit", "any", "ni ni", "upper limit of motion of interface i to load on interface j", when=_OLD,
        doc="upper limits of the motions of interface i under loads at interface j, each by its own envelope"),
    Row("cells_hz", "real", "nc 2", "cells that cover the band without gaps", "Hz", when=_OLD),
    Row("cell_limit", "any", "nc 3", "upper limits on the cells: envelope, peak, pointwise", when=_OLD),
    Row("uncertainty", "any", "nf", "how far the full response is not known, relative to its size", when=_OLD,
        field="reference_error", doc="limit of what is not known of the full response, relative to `full`, round-off "
        "included"),
    Row("residue_deviation", "any", "nm", "relative deviation of the body's residues", when=_OLD,
        doc="relative deviation of the residues of each mode, or of its cluster; not a number for modes that no load "
        "excites"),
    Row("mode_enclosure_hz", "any", "nm 2", "between these a frequency of the full model lies", "Hz", when=_OLD),
    Row("frequencies_hz", "any", "nf", "of the curves", "Hz"),
    Row("full", "any", "nf", "size of the transfer matrix of the full model", "m/N", when=_MAYBE),
    Row("reduced", "any", "nf", "size of that of the body", "m/N", when=_MAYBE),
    Row("error", "any", "nf", "size of the difference, relative to the full model"),
    Row("bound", "any", "nf", "upper limit of the error, or an estimate: see bound_kind",
        doc="`error` and `uncertainty`; infinite where there is none"),
    Row("bound_kind", "text", doc="`bound` (proven in exact arithmetic), `estimate` or `none`"),
    Row("block_error", "any", "ni ni", "largest error of motion of interface i to load on interface j", when=_MAYBE,
        doc="largest error at the samples of the motions of interface i under loads at interface j"),
    Row("held_error", "any", "ni nf", "error of what is left when interface i is held still", when=_MAYBE,
        doc="error of what is left when interface i is held still; not a number at low frequencies"),
    Row("static_error", "any", "", "error at 0 Hz", when=_MAYBE),
    Row("absolute_error", "any", "", "largest difference over the largest size, at the samples", when=_MAYBE),
    Row("reference_error", "any", "nf", "as uncertainty", when=_MAYBE),
    Row("mode_frequencies_hz", "any", "nm", "of the full model in the band", "Hz", when=_MAYBE,
        doc="free-free modes of the full model whose enclosure meets the band; files of earlier versions have those "
        "below the band too"),
    Row("mode_deviation", "any", "nm", "relative deviation of the body's frequencies", when=_MAYBE,
        doc="relative deviation of the body's frequencies; no number for a mode without a partner"),
    Row("mode_mac", "any", "nm", "mass-weighted modal assurance criterion", when=_MAYBE,
        doc="mass-weighted MAC, of the whole cluster where modes are close; near 0 for a mode that the body lacks"),
    Row("verified_below_hz", "any", "", "no mode below is missing", "Hz", when=_MAYBE,
        doc="no mode below is missing: by a Sturm count, or as LAPACK found all modes of a small model, see `proof`"),
    Row("proof", "json", "", "lemmas that the limits rest on", when="absent without limits, and in files of earlier "
        "versions", doc="JSON, `lemmas` is a list of those that the limits rest on: `name` (a section of methods.md), "
        "`statement`, `numbers` by name, `kind` (`proven` or `estimate`)"),
    Row("notes", "notes", doc="what there is to say about them", when=_MAYBE),
), parts=_certificate_parts)


def certificate_values(certificate: Certificate) -> dict[str, Any]:
    """Values of a certificate by the names of its datasets."""
    parts = _certificate_parts(certificate)
    return {name: value for row in CERTIFICATE for name, value in row.parts(parts[row.key])}

INTEGRALS = Table((
    Row("mass", "real", "", units="kg", doc="mass"),
    Row("first", "real", "3", "int x dm; x from the origin, phi the shapes", "kg m"),
    Row("inertia", "real", "3 3", "about the origin", "kg m2"),
    Row("second", "real", "3 3", "int x x' dm", "kg m2"),
    Row("Ct", "real", "ne 3", "int phi dm"),
    Row("Cr", "real", "ne 3", "int x cross phi dm"),
    Row("Me", "real", "ne ne", "int phi . phi dm"),
    Row("x_phi", "real", "3 3 ne", "[a, b, l]: int x_a phi_b,l dm"),
    Row("phi_phi", "real", "3 3 ne ne", "[a, b, k, l]: int phi_a,k phi_b,l dm"),
    *(
        Row(name, "later", shape, about, doc=doc, when="follows from those above", read=False)
        for name, shape, about, doc in (
            ("C4", "ne 3 3", "int x~ phi~ dm", ""),
            ("C6", "ne ne 3 3", "int phi_k~ phi_l~ dm", ""),
            ("Cr1", "ne ne 3", "[l, k, a]: Cr per coordinate k", ""),
            ("J1", "ne 3 3", "inertia per coordinate", ""),
            ("Gr", "ne 3 3", "gyroscopic moments", "gyroscopic moments, -2 C4"),
            ("Ge", "ne ne 3", "gyroscopic forces", ""),
            ("Oe", "ne 6", "centrifugal forces, w_a w_b in the order xx, yy, zz, xy, yz, zx", ""),
            ("Oe1", "ne 6 ne", "[i, ab, l]: Oe per coordinate l", ""),
        )
    ),
), build=ShapeIntegrals)

MARKER = Table((
    Row("point", "real", "3", "undeformed, from the origin", "m"),
    Row("motion", "real", "6 ne", "displacement and small rotation per coordinate"),
), build=InterfaceMarker)

STIFFENING = Table((
    Row("acceleration", "real", "3 ne ne", "geometric stiffness per acceleration of the frame", "s2/m"),
    Row("angular_acceleration", "real", "3 ne ne", "the same per angular acceleration", "s2"),
    Row("rotation", "real", "6 ne ne", "per w_a w_b in the order xx, yy, zz, xy, yz, zx", "s2"),
    Row("wrench/*", "real", "6 ne ne", "per force (3) and moment (3) of the interface, axes of the body"),
    Row("least_share", "real", "", "terms below this part of Ke were left out"),
    Row("terms", "text", "loads", "names of the terms", when="where there are any"),
    Row("share", "any", "loads", "of each term beside Ke, at its load", when="where there are any"),
    Row("load", "any", "loads", "of each term: its largest value in use, or one", when="where there are any"),
    Row("dropped", "text", "any", "terms that were left out", when="where there are any",
        doc="terms that were left out, which are zero"),
), build=_stiffening, parts=_stiffening_parts)

FRAME = Table((
    Row("kind", "text", "", "conditions that the frame follows",
        doc="`mean-axes`, `center-of-mass`, `tangent` or `chord`: how the body frame follows the body"),
    Row("interfaces", "text", "any", "that it follows", doc="interfaces that it follows", when="where it follows any"),
    Row("origin", "real", "3", "of the frame, in coordinates of the model", "m",
        doc="of the frame, in coordinates of the model; its axes are those of the model"),
    Row("elastic", "real", "n ne", "reduced coordinates of the elastic ones"),
    Row("rigid", "real", "n 6", "reduced coordinates of unit translations and rotations about the origin"),
    Row("Ke", "real", "ne ne", "stiffness of the elastic coordinates"),
    Row("De", "real", "ne ne", "damping of the elastic coordinates"),
    Row("integrals", INTEGRALS),
    Row("markers/*", MARKER),
    Row("notes", "notes", doc="what is not exact"),
    Row("stiffening", STIFFENING, doc="geometric stiffening, if that was asked for: see below", when="if"),
), build=FloatingFrame, parts=_frame_parts)

RANKING = Table((
    Row("terms", "text", "terms", "inertia terms, those that matter most first"),
    Row("equations", "text", "terms", "where the term is largest", doc="`force`, `moment` or `elastic`: where the "
        "term is largest"),
    Row("share", "any", "terms", "in all magnitudes of that equation", doc="of the term in the magnitudes of that "
        "equation, an upper estimate"),
), build=_ranking, parts=_ranking_parts)

SWITCHING = Table((
    Row("kind", "text", "", "path: loads slide from node to node; surface: any of them may be loaded"),
    Row("node_ids", "whole", "nc", "labels of the candidate nodes, in the order of the path"),
    Row("xyz", "later", "nc 3", "positions of these nodes in the model", "m"),
    Row("node", "whole", "c", "per candidate: place of its node in node_ids, ascending"),
    Row("direction", "later", "c 3", "per candidate: unit vector of the load"),
    Row("modes", "later", "c n", "row i: displacement along candidate i per unit of each coordinate"),
    Row("stiffness", "later", "w c",
        "band of R = Psi' K Psi: entry [k, j] of candidates j - k and j; displacements per load", "m/N"),
    Row("mass", "later", "w c", "band of Q = Psi' M Psi, as stiffness", "kg m2/N2"),
    Row("coupling", "later", "n c", "V' M Psi; zero where eigenmodes span the basis"),
    Row("weight", "later", "n 3", "load on the coordinates under unit gravity along x, y, z"),
    Row("static_weight", "later", "c 3", "the same on the static modes"),
    Row("turns", "flag", "c", "per candidate: 1 for a moment and rotation, 0 for a force"),
    Row("stress", "later", "nc 6 n", "[p, c, l]: stress c (xx, yy, zz, xy, yz, zx) at node p per unit of "
        "coordinate l", "Pa", when="where stress is wanted"),
    Row("static_stress", "later", "nc 6 b", "[p, c, k]: the same per unit load of candidate stress_first[p] + k",
        "Pa/N", when="where stress is wanted"),
    Row("stress_first", "whole", "nc", "first candidate in static_stress, per node", when="where stress is wanted"),
    Row("notes", "json", "", "what was found on the way, as JSON"),
), build=_switching)

# Sizes: P parameters, Q and J terms of stiffness and mass, 1 + morphs of them affine in morphs, q coordinates of
# residuals, c cells of the box, k deflated columns.
CELLS = Table((
    Row("low", "real", "c P", "least values of the cell"),
    Row("high", "real", "c P", "largest values of the cell"),
    Row("alpha", "any", "c", "part of the stiffness at the anchor that is left at least"),
    Row("least", "any", "c", "eigenvalue below which only deflated motions are", "1/s2"),
    Row("proven", "flag", "c", "1 where counts of eigenvalues prove both"),
))

BOUND = Table((
    Row("anchor", "real", "P", "values whose supported stiffness measures loads"),
    Row("soft", "real", "P", "values of the softest and heaviest body"),
    Row("cells", CELLS, doc="parts of the box, and what holds on each"),
    Row("residual_B", "later", "q m", "coordinates of the loads in the dual norm"),
    Row("residual_K", "later", "Q q n", "coordinates of the terms of the stiffness times the basis"),
    Row("residual_M", "later", "J q n", "coordinates of the terms of the mass times the basis"),
    Row("residual_F", "later", "q k", "coordinates of the mass times the deflated motions"),
    Row("rest_B", "later", "m", "norms of what the coordinates leave out"),
    Row("rest_K", "later", "Q n", "the same of the terms of the stiffness"),
    Row("rest_M", "later", "J n", "the same of the terms of the mass"),
    Row("rest_F", "later", "k", "the same of the deflated motions"),
    Row("motion_F", "later", "n k", "the deflated motions in reduced coordinates"),
    Row("sigma", "real", "", "weight of the deflated motions", "1/s2"),
    Row("highest", "real", "", "upper end of the band", "rad/s"),
    Row("eps", "real", "", "relative error of the stiffness of a morph, in every quadratic form"),
    Row("rounding_K", "later", "Q n n", "limits of round-off in quadratic forms of the terms of K", when=_OLD),
    Row("rounding_M", "later", "J n n", "the same of the terms of M", when=_OLD),
    Row("rigid", "later", "n 6 f", "rigid motions, constant and per morph",
        when="where springs alone hold a body with a morph, and are not in the norm of loads"),
))

FRAME_TERMS = Table((
    Row("pole", "real", "3", "about which the integrals are", "m"),
    Row("mass", "real", "J", "of each term"),
    Row("first", "real", "J f 3", "int x dm, x0 and the displacement of each morph"),
    Row("second", "real", "J f 3 f 3", "int x x' dm of each two of them"),
    Row("Ct", "real", "J n 3", "int phi dm, phi the columns of the basis"),
    Row("x_phi", "later", "J f 3 3 n", "[j, i, a, b, l]: int x_a phi_b,l dm"),
    Row("phi_phi", "later", "J 3 3 n n", "[j, a, b, k, l]: int phi_a,k phi_b,l dm"),
    Row("markers/*", "real", "6 n", "displacement and small rotation of the interface per coordinate"),
    Row("points/*", "real", "f 3", "place of the interface, and its displacement by each morph", "m"),
))

PARAMETRIC = Table((
    Row("names", "text", "P", "names of the parameters"),
    Row("kinds", "text", "P", "what each changes",
        doc="what each changes: `young`, `density`, `morph`, `spring`, `preload`, `alpha` or `beta`"),
    Row("units", "text", "P", "units of the values", read=False, doc="SI units of the values"),
    Row("low", "real", "P", "least values"),
    Row("high", "real", "P", "largest values"),
    Row("nominal", "real", "P", "values of /bodies/NAME itself"),
    Row("law/K", "whole", "Q P", "factors of the coefficient of each term of K: 0: 1; 1: p; 2: p^2; 3 + k: Lagrange "
        "polynomial of point k of p", field="law_K"),
    Row("law/M", "whole", "J P", "the same of each term of M", field="law_M"),
    Row("law/points_K/*", "real", "any", "points of a parameter with Lagrange polynomials in K"),
    Row("law/points_M/*", "real", "any", "the same in M"),
    Row("K", "later", "Q n n", "terms of the stiffness"),
    Row("M", "later", "J n n", "terms of the mass"),
    Row("rigid", "real", "n any f", "unit translations and rotations, constant and per morph"),
    Row("scale", "real", "m", "turns rotations into lengths", "m"),
    Row("damping", "json", "", "damping at nominal values, as JSON", doc="damping at nominal values as JSON: `alpha`, "
        "`beta`, `modal`, `modal_table`, `structural`"),
    Row("displacement/*", "real", "N 3", "displacement of the nodes per unit of a morph", "m"),
    Row("frame", FRAME_TERMS, doc="integrals over the terms of the mass, for floating frames", when="free bodies"),
    Row("bound", BOUND, doc="what the bound of the error needs", when="where there is one"),
    Row("box_bound", "any", "", "largest relative bound over the band at all sampled values",
        doc="largest bound over the band at all sampled values, relative to the envelope of the response: a maximum "
        "over samples"),
    Row("floor", "real", "", "damping ratio that box_bound gives to models without damping"),
    Row("proof", "json", "", "lemmas that the bound rests on at all values", read=False,
        when="where there is a bound; files of earlier versions lack it"),
), build=_parametric, parts=_parametric_parts)

SPIN = Table((
    Row("C", "real", "n n", "Coriolis matrix per rad/s: add 2 W C to damping_matrix; skew", doc="Coriolis matrix per "
        "rad/s, skew: 2 W C is added to `damping_matrix` at the speed W"),
    Row("S", "real", "n n", "spin softening per (rad/s)2: take W2 S from stiffness_matrix", doc="spin softening: W² S "
        "is taken from `stiffness_matrix`"),
    Row("Kg", "real", "n n", "stiffness of the centrifugal stress per (rad/s)2: add W2 Kg to stiffness_matrix",
        doc="stiffness of the centrifugal stress: W² Kg is added to `stiffness_matrix`"),
    Row("held", "real", "h n", "motions of the interfaces that are at rest in the frame that turns"),
    Row("elongation", "real", "3N", "static displacement of the nodes per (rad/s)2", "m s2"),
    Row("axis", "real", "3", "unit axis", doc="unit axis of the spin"),
    Row("point", "real", "3", "a point of the axis", "m"),
    Row("speeds", "real", "speeds", "with modes compared to those of the full model", "rad/s", doc="speeds at which "
        "modes were compared with those of the full model; the recipe has the deviations"),
), build=ReducedSpin)

FILE = Table((
    Row("format", "text", doc="`morembs-body`", read=False),
    Row("format_version", "whole", doc="1, 2 or 3, see above"),
    Row("unit_system", "text", doc="`SI`", read=False),
    Row("body_names", "text", "bodies", "groups of /bodies in their order",
        doc="groups of `/bodies`, in the order they were written"),
    Row("interface_names", "text", "interfaces", "groups of /interfaces in their order",
        doc="groups of `/interfaces`, in the order of the inputs"),
    Row("mode_kinds", "text", "kinds", "names of the codes in mode_kind, from 0"),
    Row("recipe", "json", "", "what was asked for, as JSON"),
    Row("check/warnings", "text", "any", "what to know before the bodies are used, a sentence each", when=_OLD),
    Row("mass_properties/mass", "real", units="kg", doc="mass"),
    Row("mass_properties/center_of_mass", "real", "3", units="m", doc="in the coordinates of the model"),
    Row("mass_properties/inertia", "real", "3 3", "about the centre of mass, axes of the model", "kg m2"),
    Row("nodes/ids", "whole", "N", "labels of the nodes in the source", field="node_ids"),
    Row("nodes/coordinates", "real", "N 3", units="m", doc="of the nodes"),
    Row("inputs/interface_index", "whole", "m", "per column of input_matrix: place in /interface_names from 0",
        field="input_interface"),
    Row("inputs/component", "whole", "m", "degree of freedom: 0..2 along x, y, z; 3..5 about them; 6 generalised",
        field="input_component"),
    Row("inputs/node_id", "whole", "m", "label of the node of a direct interface, -1 for a frame",
        field="input_node_id"),
))
