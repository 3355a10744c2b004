"""Tolerances, limits and forecasts of jobs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class JobTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Pieces of a mesh beyond which no hinges are searched for: the equations have six rows for each.
    max_searched_pieces: int = 300
    # Eigenvalue over the largest of what makes pieces move alike that is none: the square of 1e-5.
    independent_motion: float = 1e-10
    # Part of a rigid motion by which neighbours move apart as a tube turns; round-off of translations is far below.
    turned_tube: float = 1e-9
    # Bytes that a memory budget is below: no machine has 2^60.
    max_memory_bytes: float = 2.0**60
    # Difference of frequencies, as a part of them, below which they are one.
    same_frequency: float = 1e-6
    # Difference of values of a parameter, as a part of them, below which they are one: 4500 eps.
    same_value: float = 1e-12

    # --- Jobs that are written for a mesh
    # Young's modulus of steel in Pa.
    steel_young: float = 2.1e11
    # Its Poisson's ratio.
    steel_poisson: float = 0.3
    # Its density in kg/m^3.
    steel_density: float = 7850.0
    # Length up to which meshes without declared units are taken in m, and longer ones in mm.
    longest_in_metres: float = 5.0
    # Moduli from which a deck is taken in Pa, and below in MPa: polymers have 1e9 Pa, tungsten 4e5 MPa.
    least_pascals: float = 1e8
    # Sets that become interfaces; others are named in a comment.
    template_interfaces: int = 2
    # Fixed-interface modes that a first job asks for, where the mesh has ten times as many dofs.
    template_modes: int = 20
    # Interfaces that are proposed where a mesh names none: the holes of most parts, well below ``many_interface_dofs``.
    proposed_interfaces: int = 4
    # Others that are proposed in comments.
    proposed_others: int = 6
    # Distance beyond a face or a wall to which its selection reaches, over the shortest edge of the skin: far above
    # round-off, far below the next nodes.
    selection_margin: float = 0.01
    # The same, over the size of the mesh, at least: seven digits.
    least_margin: float = 1e-7
    # Depth of a plane face in the part, over that of the part, at which the part ends with it.
    face_depth: float = 1e-3
    # Component of a normal from which it is along an axis: a box then holds the face alone.
    along_axis: float = 1 - 1e-9
    # Coordinates of the bar whose matrices are an example: six bending modes, as a pair of moments is to each.
    example_order: int = 12
    # Singular value of points over the largest below which they are in a line: coordinates with six digits.
    points_in_line: float = 1e-6

    # --- What makes no sense
    # Interface degrees of freedom beyond which methods that follow all responses take minutes.
    many_interface_dofs: int = 60
    # How many interface degrees of freedom make sense where the responses to all of them are followed at once.
    max_interface_dofs: int = 500
    # Part of the dofs beyond which modes are no reduction any more.
    many_modes_part: float = 0.1
    # Modes beyond which they take very long.
    many_modes: int = 1000
    # Dofs of models that take seconds whatever is asked of them.
    small_model_dofs: int = 3000

    # --- Pictures
    # Frequencies of a picture where no [response] asks for others.
    picture_points: int = 400
    # Their band: parts of the lowest and of the highest known mode.
    picture_band: tuple[float, float] = (0.2, 1.1)
    # Part of the first resonance up to which a response is nearly static: the dynamic part is below a third.
    quasistatic_part: float = 0.5
    # Relative error beyond which a response is wrong, unless a peak without damping is what is off.
    large_error: float = 0.1
    # Order, seconds or GB that a picture draws at least, on an axis of logarithms.
    least_drawn_cost: float = 1e-3

    # --- Forecasts
    # Bytes of a stored entry of K or M: a double and an index of four bytes.
    entry_bytes: int = 8 + 4
    # Bytes of an entry of the triangle with the places of M in it.
    triangle_entry_bytes: int = 12
    # Columns of a Krylov space for each mode; measured.
    krylov_columns_per_mode: int = 3
    # Columns of blocks in use beside it; measured.
    krylov_block_columns: int = 160
    # Seconds for each dof of a certificate of bodies that come without one, on a machine of the usual speed: 15.2 s
    # of a crankshaft of 20,000 dofs, and 0.9 s of a bracket of 2,800 (a third of this).
    certificate_dof_seconds: float = 7e-4
    # Part of the speed of a large dense product that a factorisation reaches with solvers that were not measured.
    least_factor_speed: float = 0.1
    # Seconds for each entry of a factor on top.
    seconds_per_entry: float = 1e-8
    # Real products in a complex one.
    products_of_complex: int = 4
    # Resident memory of a rank of MPI without its part of a factor; measured.
    rank_bytes: int = 80_000_000
    # Bytes that stay resident of a job when all that can rest does; measured.
    resting_bytes: int = 70_000_000
    # Columns as long as there are dofs that do; measured.
    resting_columns: int = 12
    # Of these bytes, what is there before modes are counted; measured.
    loaded_bytes: int = 16_000_000
    # Bytes more that the smallest count takes; measured.
    least_count_bytes: int = 6_000_000
    # Tangents of a member that take as long as each equilibrium of its tables with all steps and checks; measured.
    tangents_per_equilibrium: int = 50
    # The same of a solid, in tangents with their factors; measured.
    factors_per_equilibrium: int = 8
    # Equilibria of a grid of 5 by 5 points and of its 16 checks: most members need no finer one.
    equilibria_of_a_member: int = 41
    # Equilibria that take as long as a formulation that solves for none; measured.
    equilibria_of_derivatives: int = 5
    # Numbers for each degree of freedom that an equilibrium keeps: its shape, slopes, stretch and modes.
    numbers_per_equilibrium: int = 6


TOL = JobTolerances()
