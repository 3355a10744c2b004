"""Tolerances, limits and usual values by which models are examined."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DiagnosticTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # --- Findings
    # Labels that a sentence names.
    shown_labels: int = 5
    # Labels that are kept with a finding, in reports of some 10 kB.
    kept_labels: int = 1000
    # Motion over the largest one by which a finding names its place. Not measured.
    named_motion: float = 0.3

    # --- Entries of matrices
    # Rows that are handled at a time: 80 entries of each are 21 MB.
    rows_at_once: int = 1 << 15
    # Difference of two entries, and of two products with a random vector, over what cancels: nine printed digits.
    same_entry: float = 1e-9
    # Relative difference of mirrored entries up to which they are rounded numbers: six printed digits.
    rounded_entry: float = 1e-6
    # Quotient x'Ax / x'|diag A|x whose negative proves that A is indefinite: single precision gives 1e-7.
    negative_quotient: float = 1e-6
    # Steps of Lanczos that look for such a quotient.
    lanczos_steps: int = 16
    # Length of the next Lanczos vector that is round-off: 4500 eps.
    invariant_space: float = 1e-12
    # Difference of two rows over the sum of their entries that is round-off: 4500 eps.
    equal_rows: float = 1e-12
    # Pairs of rows that are compared entry by entry: as many as a finding keeps.
    compared_pairs: int = 1000

    # --- Mass
    # Difference of the masses along x, y and z, and mass between them, over the mass.
    isotropic_mass: float = 1e-4
    # Difference of the mass of M from that of the mesh, over it: curved sides and lumping change it by less.
    geometry_mass: float = 1e-3
    # Distance of the center of mass from the box of the nodes, over its diagonal: point masses may have arms.
    center_outside: float = 0.1
    # Negative second moment of the mass, over the trace of the inertia, that is round-off of printed numbers.
    negative_inertia: float = 1e-6

    # --- Nodes and dofs
    # Distance of nodes at one place over the size of the model: coordinates with six digits.
    coincident_nodes: float = 1e-6
    # Part of the dofs with a residual above which other orders of the dofs are tried: supports are on fewer.
    many_dofs: float = 0.05
    # Rows on which they are tried: a share of 5 % is known to 0.4 % by them.
    order_rows: int = 3000
    # Force over what cancels below which it comes from soft mounts: in a wrong order most does not cancel.
    wrong_order: float = 1e-3
    # Part of the dofs with a residual that still have one, at most, after a change that explains it. Not measured.
    explained_share: float = 0.1
    # Residual of a row, over its size, with a factor on the rotations that does not explain it.
    unexplained_row: float = 1e-4
    # Size of a row over the largest below which it has none of its own.
    empty_row: float = 1e-6
    # Factor on the rotations, less one, that is none.
    no_factor: float = 1e-4
    # Relative distance of a factor from one that is known, such as that of degrees: 1 %.
    known_factor: float = 1e-2

    # --- Rigid motion
    # Numbers of the largest dense system in the search for nodes with wrong coordinates: 32 MB.
    dense_numbers: int = 4_000_000
    # Part of the dofs that fit the geometry with half the diagonal, at least, where it counts twice: the others may
    # carry supports.
    halved_share: float = 0.95
    # Force under displacement, over the largest under rotation, that is none: coordinates are wrong, not supports.
    no_displacement_force: float = 1e-3
    # Distance of a place from that of another node, over how far the node is moved, at which both are swapped.
    swapped_place: float = 1e-3
    # Distance over the size of the model by which a node is in a wrong place.
    wrong_place: float = 1e-5
    # Error of the axes of a node as a rotation.
    axes_error: float = 1e-4
    # Difference of such axes from those of the model by which they are axes of their own.
    own_axes: float = 1e-5
    # Singular value over the largest that least squares leave out: 4500 eps.
    least_squares_cutoff: float = 1e-12
    # Force over the largest that a change of rigid motion may leave unexplained.
    unexplained_force: float = 1e-5

    # --- Modes
    # Shift over the largest K_ii / M_ii: far below elastic modes of sound parts, far above round-off.
    shift: float = 1e-12
    # Columns of a Krylov block: the six rigid motions and two more.
    block_columns: int = 8
    # Blocks of the space: with the first about 50 solves.
    krylov_blocks: int = 7
    # Residual of an eigenvalue estimate that is good enough; its error is the square.
    good_residual: float = 1e-2
    # Eigenvalue over the shift below which a motion has no energy.
    zero_eigenvalue: float = 0.1
    # Difference of the motions of nodes from those of a rigid piece, over the largest.
    same_motion: float = 1e-4
    # Singular value over the largest of rigid motions that a patch of nodes does not tell apart.
    dependent_motion: float = 1e-9
    # Patches that are tried for a piece. Not measured.
    piece_tries: int = 30
    # Pieces that are looked for. Not measured: a mechanism of more has its largest ones named.
    most_pieces: int = 6

    # --- Units
    # Speeds of sound of matrices (m/s), beyond which units are wrong: as wide as the estimates are rough, beside solids
    # from 30 m/s (soft rubber) to 18 km/s (diamond).
    speeds: tuple[float, float] = (8.0, 1e5)
    # Densities of matrices (kg/m3), likewise beside 10 (foam) to 23,000 kg/m3; beams and plates come out too light.
    densities: tuple[float, float] = (1e-5, 1e6)
    # Speeds of sound of materials (m/s), which are exact.
    material_speeds: tuple[float, float] = (8.0, 3e4)
    # Densities of materials (kg/m3).
    material_densities: tuple[float, float] = (0.5, 3e4)
    # Density (kg/m3) of the lightest foams that are sold; below, a material is a foam or an aerogel.
    foam_density: float = 10.0
    # Speed of sound (m/s) that no foam so light exceeds: that of its solid times the root of the relative density
    # (Gibson and Ashby 1997) is 300 m/s for aluminium.
    fastest_foam: float = 1000.0
    # Moduli of materials (Pa), from gels to beyond diamond.
    material_moduli: tuple[float, float] = (1e4, 1.5e12)
    # Density of metals (kg/m3), at least: that of aluminium is 2700; magnesium passes for something else.
    metal_density: float = 2500.0
    # Speed of sound in metals (m/s), at least: below, the modulus is in GPa beside MPa.
    slowest_metal: float = 300.0
    # Speed of sound in usual metals (m/s): steel 5200, aluminium 5100, brass 3500.
    usual_metal_speed: float = 5000.0
    # Density of usual metals (kg/m3), between aluminium and steel.
    usual_metal_density: float = 5000.0
    # Distance to a metal, in powers of ten, within which numbers that were converted twice count as understood.
    near_metal: float = 1.0
    # Modulus of steel (Pa).
    steel_modulus: float = 2.1e11
    # Density of steel (kg/m3).
    steel_density: float = 7850.0
    # Densities of bodies whose units are to be told (kg/m3).
    likely_densities: tuple[float, float] = (1.0, 1e5)
    # Density (kg/m3) from which a number looks like one in kg/m3: below there are foams only.
    least_density: float = 100.0
    # Size of a body (m) that is a mistake.
    too_large: float = 2000.0
    # Size of a body (m) that is worth a note.
    large_size: float = 100.0
    # Size (m) beyond which two mistakes are likely, and both are named.
    long_size: float = 5.0
    # Size of a body (m) whose coordinates were most often taken for millimetres.
    small_size: float = 2e-3
    # Size of a body (m) that no unit of length explains.
    least_size: float = 1e-5
    # Sizes that are usual in metres.
    sizes_in_meters: tuple[float, float] = (0.01, 100.0)
    # Units of length (m) of which so small a body is meant.
    micro_unit: float = 1e-5
    # First bending frequency of a free bar times length squared, over speed of sound and radius of gyration:
    # 4.7300^2 / (2 pi).
    free_bar_bending: float = 22.373 / (2 * math.pi)
    # Side of a neighbourhood over its longest one below which it is flat.
    flat_side: float = 1e-6
    # Nodes whose neighbourhoods are looked at.
    sampled_nodes: int = 1000

    # Loose parts that a picture lists, the largest first: a tenth one is found when nine are mended.
    shown_parts: int = 9


TOL = DiagnosticTolerances()
