"""Systems of bodies as files: what ``morembs simulate`` does with the simulator of ``morembs.dynamics.multibody``."""
