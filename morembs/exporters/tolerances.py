"""Tolerances, limits and sizes of exporters."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class ExporterTolerances:
    """Quantities that decide, each with the line that derives or cites it.

    What a format itself fixes stands in a class beside the code that writes the format.
    """

    # --- Numbers
    # Significant digits that keep every bit of a double: 1 + 53 log10(2), rounded up.
    double_digits: int = math.ceil(1 + sys.float_info.mant_dig * math.log10(2))
    # Largest number whose exponent has two digits, also where nine digits of it are kept.
    largest_in_two_digits: float = 9.99999999e99
    # Smallest number whose exponent has two digits.
    smallest_in_two_digits: float = 1e-99
    # Share of the largest number of an array below which one that the format loses is round-off: eps / 220.
    lost_number: float = 1e-18

    # --- What a file has against what the body has
    # Change of a number by a change of coordinates before the file was written: 4500 eps.
    changed_number: float = 1e-12
    # Difference over its bound: half a unit of each last digit adds up to the bound at most, solving adds as much of
    # its own, and the bound is of first order.
    read_back_slack: float = 4.0
    # Entries that vanish by symmetry are known to this many units of the largest.
    read_back_floor: float = 100.0
    # Frequency over that of the last mode at which both are compared: beyond its resonance, where it still counts.
    beyond_last_mode: float = 1.5

    # --- Bodies
    # Asymmetry of a matrix over its largest entry that is round-off: 4.5e6 eps.
    asymmetry: float = 1e-9
    # Lowest eigenvalue over the highest below which a stiffness has rigid motion: 4.5e5 eps.
    rigid_stiffness: float = 1e-10
    # Singular value of interface motions, rows scaled to one, over the largest, below which they depend on each other.
    dependent_interface: float = 1e-9
    # Singular value of rigid motion at held rows, these scaled to one, below which a motion is left: near sqrt(eps).
    held_motion: float = 1e-8
    # Damping force of a rigid motion over the products that it is the sum of, that is round-off: 4.5e5 eps.
    rigid_damping: float = 1e-10
    # Deviation from unit modal mass and diagonal stiffness, per coordinate, up to which coordinates stay as they are.
    normal_coordinates: float = 1e-12

    # --- Words for a rigid motion that supports leave
    # Singular value over the largest below which points do not tell a part of it.
    told_motion: float = 1e-9
    # Turn of the farthest point over its shift below which the motion is none but a translation.
    no_turn: float = 1e-6
    # What a direction lacks to an axis of the model that it is named by.
    along_axis: float = 1e-6

    # --- Notes
    # Poles and entries of the gain that a note shows: chosen, what a few lines of a log hold.
    shown_values: int = 12
    # Pole over the largest that is the one of a rigid motion, zero but for round-off.
    zero_pole: float = 1e-9
    # Damping between modes over the largest damping that a note calls left out.
    left_out_damping: float = 1e-6
    # Size of a file from which a note says it: chosen, text that an editor opens slowly.
    large_file_bytes: float = 50e6
    # Characters that a message shows of what a compiler said: chosen, two lines.
    shown_compiler_words: int = 200

    # --- Sizes of pieces
    # Columns of a basis that are in memory at a time: 16 MiB.
    basis_block_bytes: int = 16 * 2**20
    # Columns of Exudyn's mode basis that are made at a time; each block reads the whole stored basis once.
    exudyn_block_bytes: int = 256 * 2**20
    # Lines of text that are made at a time: of 40 characters, less than 3 MB.
    lines_at_once: int = 1 << 16

    # --- FMU and C source
    # Step in s that an FMU proposes to its simulator: chosen, 1 kHz.
    proposed_step_s: float = 1e-3
    # Error of a step of co-simulation over the length of the body, unless another is given.
    step_error: float = 1e-6
    # Deflection over the length of the body that nominal values stand for.
    nominal_deflection: float = 1e-3
    # Mass in kg that nominal values take at least, so that they are positive for a body without mass.
    least_nominal_mass_kg: float = 1e-12
    # Steps under random inputs over which single precision is compared with double.
    single_precision_steps: int = 1000
    # Part of the outputs that single precision may cost.
    single_precision_error: float = 0.1
    # Numbers in a line of a C table: chosen, lines of at most 200 characters.
    table_numbers_per_line: int = 8

    # --- Real time
    # Angle in rad by which the fastest mode that is kept goes on in a time step: half of where explicit steps get
    # unstable, 6 steps a period.
    resolved_angle: float = 1.0
    # Ends of the bands in which errors are told, over the highest frequency that a step resolves: at the first one 63
    # steps a period, at the last one the series of the error still halves with each term.
    band_shares: tuple[float, ...] = (0.1, 0.25, 0.5)
    # Terms of that series: 2^-60 is below eps.
    series_terms: int = 60
    # Frequency that motions without mass get over what a step resolves: their error at the end of the last band, which
    # counts it, is 2.5e-5 of their compliance.
    far_from_step: float = 100.0
    # Frequencies at which an error is looked at that has no upper limit: chosen.
    error_samples: int = 200
    # Decay that these have in parts of their frequency, so that resonances count as ones of 1 % of damping: chosen.
    sampled_damping: float = 0.01

    # Half width of a cell over its distance to the nearest pole, in which a response is limited by its Taylor series:
    # chosen, then the difference of two near poles is limited to an eighth above it.
    cell_radius: float = 1 / 16
    # Terms of that series: 16^-13 is eps.
    cell_terms: int = 13

    # Error of an export for which a time step is looked for: chosen, below that of most bodies.
    real_time_error: float = 1e-3
    # Steps whose time is measured: some milliseconds.
    timed_steps: int = 1000
    # Halvings of a time step that is looked for: below a hundredth of what the first band needs.
    step_halvings: int = 8

    # --- Simulators
    # MuJoCo: steps in a radian of the fastest mode; explicit steps are stable from half a step on.
    steps_per_radian: float = 10.0
    # MuJoCo: mass in kg and inertia in kg m2 up to which it refuses a body that moves, mjMINVAL.
    least_mujoco_inertia: float = 1e-15
    # MuJoCo: compliance of the tendons beyond that of the body from which a note names it: chosen.
    large_tendon_share: float = 0.01
    # MuJoCo: what a tendon follows its modes by, mjMAXIMP, the hardest that MuJoCo allows.
    tendon_impedance: float = 0.9999
    # MBDyn: characters of a node label: chosen, longer names are refused.
    node_label_characters: int = 255
    # SID: largest deviation from an identity, relative to its terms, in files of twelve and of fewer digits.
    sid_identity: float = 1e-6
    # SID: Gr and Ge over the most that mass and inertia allow, below which they are round-off.
    sid_roundoff: float = 1e-4
    # SID: entries of a matrix above which its header must be wrong: 8 GB.
    max_sid_entries: int = 10**9
    # Exudyn: singular value over the largest below which conditions on the weights of nodes depend on each other.
    dependent_weights: float = 1e-12
    # Exudyn: error of the centre of mass, and of its motion by the modes, that weights of nodes may leave.
    weights_error: float = 1e-9
    # Exudyn: spectral radius of generalised-alpha at infinite frequency, unless another is given; 1 damps nothing.
    spectral_radius: float = 0.9
    # Exudyn: part of the number of steps that is round-off of the quotient of two times.
    step_roundoff: float = 1e-12
    # Exudyn: relative tolerance of its Newton iteration: chosen, far below the error of steps.
    newton_error: float = 1e-11

    # --- Pictures
    # Straight steps in which a period of a sine is drawn: they leave it by 1 - cos(pi / 32), half a per cent.
    animation_steps: int = 32


TOL = ExporterTolerances()
