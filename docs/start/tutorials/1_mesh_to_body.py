r"""
From a mesh to a body
=====================

A connecting rod of 2,078 nodes becomes a body of 62 coordinates: two pins with six degrees of freedom each, and fifty
fixed-interface modes.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import morembs
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job

folder = Path(tempfile.mkdtemp())

# %%
# The job
# -------
# A job says which mesh, which material, where other bodies touch the part, and what shall come out. Units are declared
# once; here lengths are mm, masses t and times s, so that stresses are MPa. The mesh is an example that morembs brings
# along; ``morembs init --example`` writes it with a job much like this one.

morembs.examples.rod(folder)
job = folder / "rod.toml"
job.write_text("""
[model]
mesh = "rod.msh"
units = "mm-t-s"

[[material]]
set = "all"
young = 210e3
poisson = 0.3
density = 7.85e-9

[[interface]]
name = "big_end"
nodes = "set:BIGEND"
coupling = "rigid"

[[interface]]
name = "small_end"
nodes = "set:SMALLEND"
coupling = "rigid"

[[reduce]]
name = "cb50"
method = "craig-bampton"
modes = 50

[output]
path = "rod.h5"
nodes = "skin"
picture = "rod.png"
""")

# %%
# ``morembs check rod.toml`` would now tell what is wrong with it, and ``morembs reduce rod.toml`` run it. From
# Python:

result = run_job(load_job(job))
print(f"{result.dofs:,} degrees of freedom -> {result.bodies[0].reduced.order}, factorised by {result.solver}")

# %%
# The picture
# -----------
# Its mode shapes, and its frequency response between the pins beside that of the finite-element model.

plt.figure(figsize=(10, 10))
plt.imshow(plt.imread(folder / "rod.png"))
plt.axis("off")
plt.tight_layout(pad=0)

# %%
# The body
# --------
# The file holds all that a simulator needs; :doc:`/reference/schema` lists every dataset. The first six frequencies are
# those of rigid-body motion, zero but for round-off. Those of the finite-element model stand beside the elastic ones.

body = morembs.read_body(folder / "rod.h5").bodies["cb50"]
elastic = body.frequencies_hz[6:]
full = result.bodies[0].full_frequencies_hz
for reduced_hz, full_hz in zip(elastic, full[full > 1.0], strict=False):
    print(f"{full_hz:10.2f} Hz in the model, {reduced_hz:10.2f} Hz in the body: {reduced_hz / full_hz - 1:.1e} above")

# %%
# Rayleigh's principle puts every frequency of the body above that of the model. How large the error of the *response*
# is at any frequency of a band, no list of frequencies says; the tutorial on certificates goes on from here.

plt.figure(figsize=(7, 3))
plt.semilogy(np.arange(1, len(elastic) + 1), elastic, "o-")
plt.xlabel("elastic mode of the body")
plt.ylabel("Hz")
plt.grid(alpha=0.3)
