"""Numbers of system files and their checks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SimulationTolerances:
    """Limits of warnings before a run, each named by its quantity."""

    # Steps in a period below which generalised-alpha changes its length by more than 3 % (Chung and Hulbert 1993).
    steps_per_period: int = 10
    # Steps in a period of a load or of a motion below which its samples have another frequency (Nyquist 1928).
    sampled_steps_per_period: int = 2
    # Largest over smallest elastic body from which units are in doubt: below the 1000 of mm that are read as m.
    size_ratio: float = 300.0
    # Gravity in the plane of a member, over all of it, that is none: six digits, as axes are typed.
    gravity_in_plane: float = 1e-6
    # Most steps of a run: the states of one rigid body, 25 numbers a step, fill 200 GB then.
    steps: int = 1_000_000_000


TOL = SimulationTolerances()
