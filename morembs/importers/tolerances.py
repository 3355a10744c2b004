"""Tolerances, limits and sizes of importers and of the programs that they run."""

from __future__ import annotations

import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class ImporterTolerances:
    """Quantities that decide, each with the line that derives or cites it.

    What a format itself fixes stands in a class beside the code that reads the format.
    """

    # --- Numbers of a file
    # Numbers beyond it are refused, as areas and volumes would overflow: its cube is 1e300.
    largest_number: float = 1e100
    # Entries beyond it are scaled first, as the product of two is 1e300.
    largest_entry: float = 1e150
    # Labels beyond it are no integers as doubles: 2^53.
    largest_label: int = 1 << sys.float_info.mant_dig
    # A size that is divided by, at least: any positive one.
    least_size: float = 1e-300

    # --- Meshes of plane elements
    # Extent of a mesh across its plane over its longest side that is none: coordinates with six digits.
    out_of_plane: float = 1e-6

    # --- Parts of CAD
    # Size of elements over the longest side of a part, where none is asked for.
    cad_element_part: float = 0.05
    # Elements around a full circle at least: more than the eight that the wall of a hole is found by.
    cad_elements_per_turn: int = 12

    # --- Matrices
    # Asymmetry over the largest sum of a row that is round-off: 4.5e6 eps.
    asymmetry: float = 1e-9
    # The same of a matrix that an OP4 file calls symmetric: chosen, its numbers may have few digits.
    op4_asymmetry: float = 1e-5
    # Rows for each entry above which a size or a row number must be wrong: chosen.
    rows_per_entry: int = 1000
    # Entries that a reference with stiffness or mass of its own may spread over its nodes: 600 MB.
    max_spread_entries: int = 50_000_000
    # Columns that the header of a DMIG may announce: as many labels are 800 MB.
    max_dmig_columns: int = 100_000_000
    # |K R| over |K| |R|: round-off of printed digits stays below, a wrong order of rows is near one.
    held_share: float = 1e-5
    # Singular value over the largest entry below which stiffness of a condensed element is none: 4.5e6 eps.
    no_stiffness: float = 1e-9

    # --- Directions, equations, inertia
    # Sine of the angle of two directions that span no plane.
    parallel: float = 1e-8
    # The same of a beam and the orientation of its section.
    parallel_orientation: float = 1e-9
    # Part of a beam's length across the global z axis below which it lies along it (Element Reference, BEAM188).
    across_z: float = 1e-4
    # Pivot over the largest below which an equation of Abaqus says the same as others on its node.
    repeated_pivot: float = 1e-10
    # Pivot over the largest below which dependent components do not follow from the others.
    dependent_pivot: float = 1e-9
    # Pivot of unit directions below which one says nothing new, and coefficient that is none.
    repeated_direction: float = 1e-12
    # Part of a unit direction, and coefficient over the largest, that is round-off: 45 eps.
    no_part: float = 1e-14
    # Condition of the six motions of independent components above which they determine no rigid motion.
    undetermined_condition: float = 1e8
    # Condition of normal equations likewise: the square of 1e6.
    undetermined_normal_condition: float = 1e12
    # Lowest principal inertia over the largest entry, below zero, that is the rounding of printed digits.
    negative_inertia: float = 1e-9
    # The same of *ROTARY INERTIA.
    negative_rotary_inertia: float = 1e-12
    # Distance over the size of a coupling that is none.
    no_arm: float = 1e-9

    # --- Shells and beams, as CalculiX expands them (User's Manual); lengths are in the units of the deck, as there
    # Cosine of 20 degrees, within which normals are of one fibre.
    near_normal: float = 0.939693
    # Cosine of half a degree, within which normals are the same.
    same_normal: float = 0.999962
    # Difference of thicknesses and offsets that are the same.
    same_thickness: float = 1e-10
    # Length of a normal that has none.
    least_normal: float = 1e-10
    # Cosine off one below which a normal is along an axis.
    near_axis: float = 1e-3
    # Second moment of the nodes of a knot across a plane that they are in.
    flat_knot: float = 1e-10

    # --- Materials
    # Poisson's ratio that ANSYS takes where none is given (MP,PRXY).
    ansys_poisson: float = 0.3
    # Relative difference of moduli that are one.
    same_modulus: float = 1e-9
    # Relative difference to E / (2 (1 + nu)) of a shear modulus that is isotropic: printed digits.
    same_shear_modulus: float = 1e-6
    # Difference of E / (2 G) - 1 to nu, over 1 + nu, that is said, as Nastran says it (Quick Reference Guide, MAT1).
    disagreeing_poisson: float = 1e-2
    # Transverse shear thickness over that of the shell where it is left out (Quick Reference Guide, PSHELL): 5/6.
    shear_thickness: float = 0.833333

    # --- Ties
    # Part of the mean size of the master's faces within which nodes are tied where a deck says nothing (Abaqus).
    tie_distance: float = 0.05
    # Gap over the extent of the model that is round-off.
    tie_gap: float = 1e-9
    # Faces that are tried for each point, by the distance of their centres: chosen.
    tried_faces: int = 9
    # Steps by which the foot of a point on a face is found: chosen, plane triangles need one.
    foot_steps: int = 25
    # Change of a coordinate of a foot, between 0 and 1, that is none: 4.5 eps.
    settled_foot: float = 1e-15
    # Part of the trace of normal equations that is added to their diagonal, for faces without area: 45 eps.
    foot_shift: float = 1e-14
    # Shape functions below this are round-off of a point that is on an edge or a node.
    no_shape: float = 1e-9
    # CalculiX crosses edges by this part of the mean distance of centres from first edges (see ``facing``).
    crossed_part: float = 1 / 40
    # Triangles that CalculiX walks over before it gives up.
    walked_triangles: int = 100

    # --- Limits of decks
    # Nodes and elements that one card may generate: 1.2 GB of coordinates.
    max_generated: int = 50_000_000
    # Nastran cards that replication may make: chosen.
    max_replicated: int = 1_000_000
    # Sets, parts and coordinate systems that refer to others, one behind the other: chosen.
    max_references: int = 100
    # Files that include others, one behind the other: chosen, ends those that include themselves.
    max_include_depth: int = 50
    # Files that a deck includes: chosen.
    max_includes: int = 1000
    # Bytes of all files that a deck includes: 4 GiB.
    max_include_bytes: int = 1 << 32
    # Bytes of a line of an Abaqus deck beyond a piece, above which the file has no ends of lines.
    longest_line_bytes: int = 1 << 16
    # Bytes of a Nastran card above which the file has no ends of lines: three million lines of 80.
    longest_card_bytes: int = 1 << 28
    # Bytes of a line of a Harwell-Boeing file that are read at once.
    longest_matrix_line_bytes: int = 1 << 12
    # Lines that a keyword line may go on over where a piece ends: chosen.
    continued_lines: int = 32
    # Bytes of a line of a deck that tell whether it is a keyword line or goes on: chosen, blanks may stand there.
    told_bytes: int = 80
    # Bytes of a line that tell whether a keyword line goes on in it.
    told_bytes_below: int = 200
    # Characters that are kept of a Nastran field: those of free fields may be longer than 16.
    field_characters: int = 24
    # Numbers of a line that the format of an ANSYS block may have.
    block_numbers: int = 200
    # Characters that each of them may have.
    block_number_characters: int = 64
    # Numbers of a line that the format of a Harwell-Boeing file must stay below.
    harwell_numbers: int = 200
    # Characters that each of them must stay below.
    harwell_number_characters: int = 100
    # Node tags up to this one are taken, and some for each node: a table of them is no larger than a mesh.
    sparse_tags: int = 1_000_000
    # Tags beyond these for each node.
    sparse_tags_per_node: int = 20

    # --- Decks that are written
    # Difference between the offsets of beams of one section, in widths of its profile: round-off of their axes.
    same_offset: float = 1e-9

    # --- Sizes of pieces
    # Bytes of a deck that are read at once: their numbers stay in the cache of a core.
    piece_bytes: int = 1 << 19
    # Bytes of a matrix in text that are read at once.
    text_block_bytes: int = 1 << 20
    # Bytes of a file that are hashed at once.
    hashed_bytes: int = 1 << 24
    # Bytes at the begin of a file that tell its encoding or, in comments, the program that wrote it.
    head_bytes: int = 1 << 16
    # Bytes at the begin and end of a mesh that tell its format and whether it is whole.
    mesh_end_bytes: int = 1 << 12
    # Words of an OP4 file that are taken at once, which need about 30 MB.
    op4_block_words: int = 1 << 20
    # Entries up to which a copy in the other order is made without thinking of memory: 50 MB.
    copied_entries: int = 1 << 22
    # Rows of a matrix that are looked at together.
    rows_at_once: int = 1 << 12
    # Rows of a .full file that are read together.
    full_rows_at_once: int = 1 << 14
    # Bytes of an ANSYS block that are read together: their numbers stay in the cache of a core.
    block_bytes: int = 1 << 19
    # Codes of rows up to which a table by code serves instead of sorting: 512 MB.
    largest_table: int = 1 << 26
    # Threads that read numbers from text: chosen.
    reading_threads: int = 4

    # --- Messages, in characters
    # Of a line that is quoted: the columns of a card.
    shown_line: int = 80
    # Of what a line of a Nastran deck has beyond its fields.
    shown_unread: int = 24
    # Of the reason that a library gives: chosen, two lines.
    shown_reason: int = 200
    # Of the reason that meshio gives, which may name all formats: chosen, three lines.
    shown_mesh_reason: int = 300
    # Lines of one layout, and the characters of their last number, that tell a number which is cut off: chosen; labels
    # and numbers of a few digits have one width by chance. Fields of Nastran have as many columns.
    layout_lines: int = 3
    # As above.
    layout_characters: int = 8
    # Of the last line of a program: chosen.
    shown_last_line: int = 120
    # Kinds of problems of a deck that a message lists: chosen.
    shown_problems: int = 20

    # --- Programs that assemble
    # Seconds after which a run is ended, unless others are given: chosen.
    engine_seconds: float = 600.0
    # The end of what a program printed that is looked at: one that repeats itself may print gigabytes.
    log_bytes: int = 1 << 20
    # Files of a run may not grow beyond this part of the free space of their disk: chosen.
    disk_part: float = 0.8
    # Seconds after which a run looks whether it is to end.
    look_seconds: float = 0.5
    # Difference of the masses along the axes, over the largest, above which it is told.
    uneven_mass: float = 1e-6
    # Force under rigid motion, over what cancels in it, above which it is told.
    rigid_strain: float = 1e-9

    # --- CalculiX
    # Difference of K with and without springs to the same dofs, over its largest entry.
    same_stiffness: float = 1e-9
    # Difference of a stiffness from that of two constants, over its largest entry: round-off of the few sums, 45 eps.
    isotropic_error: float = 1e-14
    # Sums below this part of their terms are round-off; CalculiX writes 14 digits.
    cancelled_sum: float = 1e-12
    # A number above all internal numbers of nodes.
    made_label: int = 1 << 40
    # How near a rigid motion must come to that of a place or motion, of 1 for displacements, of lengths of the model.
    near_motion: float = 1e-3
    # Shift of the scaled stiffness: eigenvalues above it converge.
    proximal_shift: float = 1e-7
    # Steps of the proximal point iteration, at most.
    proximal_steps: int = 40
    # Step over the motion below which the iteration has settled: 450 eps.
    settled_motion: float = 1e-13
    # Residual of rows that were told by their rigid motion.
    told_residual: float = 1e-8
    # How far around untold dofs those may be that they follow, in entries of K.
    followed_rings: int = 4
    # Singular value over the largest below which the motions of followed dofs depend on each other.
    dependent_followed: float = 1e-10
    # Error of the rigid motion of untold dofs by those that they follow.
    followed_error: float = 1e-9

    # --- MYSTRAN
    # Grids of one run, by which the time is least: MYSTRAN writes dense matrices, and needs 40 ms for a start.
    run_grids: int = 150
    # Relative difference to an isotropic stiffness of one that MAT1 can say: round-off of its moduli.
    isotropic_stiffness: float = 1e-9
    # Part of a grid's largest rotational stiffness below which there is none (AUTOSPC_RAT of Nastran).
    no_rotational_stiffness: float = 1e-8
    # Difference between a direction and its image in the motion of an element that tells it.
    told_direction: float = 1e-9
    # Singular value over the largest below which grids of an element do not tell a rotation: those on a line.
    told_rotation: float = 1e-6
    # Sizes from which on numbers in 16 columns are tried without an exponent: below, zeros take more than it.
    plain_from: float = 1e-4
    # Sizes up to which they are: beyond, the digits before the point fill the columns.
    plain_below: float = 1e14
    # Likeness (0 to 1, difflib) of a misspelt keyword and the right one: NODES and NODE have 0.89.
    misspelt_keyword: float = 0.8


TOL = ImporterTolerances()
