r"""
How wrong is the body?
======================

A certificate gives limits of the error of the transfer matrix that hold at every frequency of a band, and not only at
those that were looked at.
"""

import tempfile

import matplotlib.pyplot as plt
import numpy as np

import morembs

mesh = morembs.read_mesh(morembs.examples.bracket(tempfile.mkdtemp()), "mm-t-s")
steel = morembs.isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
model = morembs.assemble(mesh, [steel])
ends = [
    morembs.make_interface(model, name=name, nodes=morembs.select_nodes(model, f"set:{name}"), coupling="rigid")
    for name in ("BOLTS", "PIN")
]
band = [0.0, 25_000.0]  # Hz

# %%
# Two bodies by number of modes, one by tolerance
# -----------------------------------------------
# The part has no damping, so a ratio of 1 % is assumed in the model and in the bodies for the transfer errors: without
# any, a resonance has no finite error.

with morembs.Problem(model, ends) as problem:
    bodies = [morembs.CraigBampton(modes=modes).reduce(problem, name=f"{modes} modes") for modes in (4, 12)]
    bodies.append(morembs.AutoReducer(band_hz=band, tolerance=1e-4).reduce(problem, name="tolerance 1e-4"))
    certificates = morembs.certify(problem, bodies, band)

for body, certificate in zip(bodies, certificates, strict=True):
    limit = certificate.limit
    print(
        f"{body.name:>15}: order {body.order:2d}, largest error between {limit.lower:.2e} and {limit.upper:.2e}, "
        f"at {limit.at_hz:,.0f} Hz ({certificate.kind})"
    )

# %%
# Over the band
# -------------
# Lines are errors at samples, relative to the response there; steps are the limits, relative to the envelope of the
# response, which has its resonances and none of its zeros. The wanted tolerance is dashed.

plt.figure(figsize=(8, 4.5))
for number, (body, certificate) in enumerate(zip(bodies, certificates, strict=True)):
    color = f"C{number}"
    plt.semilogy(certificate.frequencies_hz, certificate.error, color=color, lw=0.8, alpha=0.6)
    edges = np.append(certificate.cells_hz[:, 0], certificate.cells_hz[-1, 1])
    plt.stairs(certificate.cell_limit[:, 0], edges, baseline=None, color=color, label=f"{body.name}, limit")
plt.axhline(1e-4, color="black", ls="--", lw=0.8)
plt.xlabel("frequency, Hz")
plt.ylabel("relative error")
plt.legend()
plt.grid(alpha=0.3)

# %%
# Modes
# -----
# The frequencies of the model are known within enclosures, and a Sturm count proves that none is missing in the band.

certificate = certificates[1]
for hz, (low, high), deviation in zip(
    certificate.mode_frequencies_hz, certificate.mode_enclosure_hz, certificate.mode_deviation, strict=True
):
    print(f"{hz:9.2f} Hz, within {high - low:.1e} Hz; the body is off by {deviation:.1e}")

# %%
# In a job the same is ``[certify] band_hz = [0, 25000]``; ``morembs compare`` sets its reductions side by side.
# :doc:`/background/certificate` has the definitions, :doc:`/background/proofs` the proofs.
