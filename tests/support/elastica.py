"""Shape of a cantilever that can only bend, by elliptic integrals (Bisshopp and Drucker 1945)."""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc


def tip_of_elastica(load):
    """Tip along the axis, across it, and its angle for the length 1 under a load P L^2 / EI across the axis."""

    def parts(angle):
        m = (1 + np.sin(angle)) / 2
        return m, np.arcsin(np.sqrt(1 / (2 * m)))

    def miss(angle):
        m, phi = parts(angle)
        return ellipk(m) - ellipkinc(phi, m) - np.sqrt(load)

    angle = brentq(miss, 1e-9, np.pi / 2 - 1e-12)
    m, phi = parts(angle)
    across = 1 - 2 / np.sqrt(load) * (ellipe(m) - ellipeinc(phi, m))
    return np.sqrt(2 * np.sin(angle) / load), across, angle
