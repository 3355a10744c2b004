"""Tolerances, limits and block sizes of finite-element models."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FemTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # --- Numbers
    # Difference of a matrix from its transpose, over the largest entry, that is round-off: text has eight digits.
    asymmetry: float = 1e-8
    # Coordinates and entries beyond this are damage: the fourth power, as in sums of products of volumes, overflows
    # beyond 1e77.
    largest_number: float = 1e75
    # Difference of elastic constants from isotropic ones, over them, that is round-off of nine printed digits.
    isotropic: float = 1e-9
    # Error of the axes of a material as a rotation: the root of eps, as of eight printed digits.
    axes_error: float = 1e-8

    # --- Elements
    # Determinants of Jacobians, at least: inverses are numbers still.
    least_jacobian: float = 1e-250
    # The same, at most.
    largest_jacobian: float = 1 / least_jacobian
    # Determinant at a point, over the largest of its element, at which that is inverted or flat.
    flat_element: float = 1e-10
    # Hourglass stiffness over E V sum |g|^2: that of CalculiX.
    hourglass_stiffness: float = 0.0005
    # Sum of squared distances in another order of the middle nodes, over that in their own, by which they are in that
    # order. A motion that all middle nodes share (a curved edge on each side) changes no comparison of orders, and a
    # quarter-point keeps its edge.
    better_order: float = 0.1
    # Gain of an order, in squared sizes of the element, that is round-off: the square of 1e-6.
    order_roundoff: float = 1e-12
    # Shape function of a corner that is round-off of zero.
    no_shape: float = 1e-9

    # --- Interfaces and selections
    # Distance of a frame's point from its nodes, in sizes of the model, that is a mistake.
    far_lengths: float = 1000.0
    # Scaled condition of R_s' W R_s above which nodes count as collinear: 1e4 of their places, which are squared in it.
    collinear_condition: float = 1e8
    # Distance over the size of a box, sphere or cylinder at which points on its surface belong to it.
    region_slack: float = 1e-6

    # --- Plane faces and round holes of a skin
    # Angle in rad between neighbours that are of one plane face: one degree, coordinates of six digits turn small
    # faces by less.
    plane_angle: float = 0.0175
    # Distance of nodes from a plane face, over the root of its area, that is still plane.
    plane_error: float = 1e-3
    # Part of the skin that a plane face is at least: an end of a square bar 250 times as long as wide.
    least_face_part: float = 1e-3
    # Angle in rad between neighbours within the wall of a hole: 50 degrees, so eight faces around are taken.
    wall_angle: float = 0.873
    # Height of a face over the plane of its neighbour, over their distance, from which the edge is convex.
    flat_rise: float = 1e-3
    # Faces of the wall of a hole at least: once around at ``wall_angle``.
    least_wall_faces: int = 8
    # Distance of corners from the wall of a hole, over its radius: coordinates of four digits.
    wall_error: float = 1e-3
    # Angle in rad about the axis without a corner: a quarter, as of a keyway; slots and fillets leave more.
    wall_gap: float = 1.571
    # Steps of Gauss and Newton's method, which squares the error in each: four are enough from a guess of 10 %.
    cylinder_steps: int = 8

    # --- Pictures that move
    # Triangles of a surface that is shown: each is a few pixels then, and software draws them at 10 pictures a second.
    drawn_triangles: int = 60_000
    # Elements of a model that a notebook shows unasked: its skin is found in half a second.
    shown_elements: int = 100_000
    # Nodes of a set, and lines of a coupling, that are marked: more of them are one spot.
    drawn_points: int = 5_000
    # Radius of a node that is drawn alone, over the longest side of the part: seen, and apart from its neighbours.
    dot_radius: float = 0.008
    # Points of a skin whose motion is that of an interface beside them: as many as turn with it for certain.
    frame_points: int = 24
    # Sets that a page lists: a menu of more is searched by name elsewhere.
    drawn_groups: int = 200
    # Turn of the first view about z, in degrees: x runs to the right and y backwards.
    view_turn: float = -30.0
    # Height of the eye over the plane of x and y, in degrees: all three sides are seen.
    view_tilt: float = 25.0
    # Whole steps from the middle of a surface to its rim: five digits of a place.
    drawn_place_steps: int = 2**17
    # Whole steps of the largest displacement of a shape: 0.1 pixels where it is drawn 200 pixels large.
    drawn_shape_steps: int = 2**11 - 1
    # Whole steps of a scale of colors, which has bytes.
    drawn_color_steps: int = 127
    # Weights of a prediction across an edge are multiples of one 64th, so that sums are exact (also in reading.js).
    prediction_steps: int = 64
    # Largest weight: beyond it the fourth corner lies far from the other three, and their differences grow.
    max_prediction_weight: float = 3.0
    # Squared sine of the angle of a triangle that is too thin to have a plane.
    thin_triangle: float = 1e-3

    # --- Force under rigid motion, over the sum of magnitudes that cancel in it
    # Force by which the motion strains the body.
    strained_force: float = 1e-6
    # Force up to which it is round-off; between both numbers are rounded, or the ground is very soft.
    rounded_force: float = 1e-9
    # Force up to which all over the model it comes from numbers that were printed with few digits: three.
    few_digits: float = 1e-3
    # Part of the dofs whose force is the usual one: supports are on fewer than the others.
    usual_dofs: float = 0.8
    # Force over the usual one that is not round-off: a very soft ground.
    outlier: float = 100.0
    # Part of the dofs with such a force above which the whole body does not fit, not only what holds it.
    most_dofs: float = 0.5
    # Part of the force that springs at the nodes may leave unexplained.
    unexplained_force: float = 1e-3
    # Part of the dofs at which they may leave more.
    unexplained_dofs: float = 0.05
    # Strain that a preload stays below: 1 % is beyond yield of metals.
    preload_strain: float = 0.01

    # --- Pieces
    # Bytes of what is integrated over a piece of elements; four such arrays exist at once.
    element_bytes: int = 48_000_000
    # Numbers at once where arrays are walked through: 1 MB, which stays in the cache.
    numbers_at_once: int = 1 << 17
    # Elements whose handedness is looked at at once.
    handed_elements: int = 20_000
    # Elements whose middle nodes are looked at at once: 20 x 20 distances of each are 32 MB.
    ordered_elements: int = 10_000
    # Entries of the stress operator that are collected before they are added up: 32 MB, and their places.
    collected_entries: int = 4_000_000


TOL = FemTolerances()
