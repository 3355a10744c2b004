r"""
One body for all designs
========================

A bracket whose lug may be softer or stiffer, and longer or shorter. One reduction gives a body for every value of both,
with derivatives and a bound of the error that nobody has to trust: here it is held against models that are assembled
anew.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import morembs
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job

folder = Path(tempfile.mkdtemp())
file = morembs.examples.bracket(folder)
mesh = morembs.read_mesh(file, "mm-t-s")

# %%
# Shapes
# ------
# A morph is a displacement of each node per unit of its parameter. The lug is stretched along z above 8 mm, and what
# lies above 20 mm moves as one, with the hole of the pin.

x, y, z = 1e3 * mesh.nodes.xyz.T
longer = np.clip((z - 8) / 12, 0, 1)
rows = [f"{label},0,0,{dz!r}" for label, dz in zip(mesh.nodes.ids.tolist(), longer.tolist(), strict=True) if dz]
(folder / "longer.csv").write_text("\n".join(["id,dx,dy,dz", *rows]))

# %%
# The job
# -------
# The method ``parametric`` looks for the value where its bound is largest, takes what is missing from there, and ends
# where the bound is below the tolerance at all values that it looks at.

(folder / "bracket.toml").write_text("""
[model]
mesh = "bracket.msh"
units = "mm-t-s"
[[material]]
young = 2.1e5
poisson = 0.3
density = 7.85e-9
[damping]
rayleigh = { beta = 2e-7 }
[[interface]]
name = "BOLTS"
nodes = "set:BOLTS"
[[interface]]
name = "PIN"
nodes = "set:PIN"
[[parameter]]
name = "E_lug"
property = "young"
set = "LUG"
range = [1.5e5, 2.7e5]
[[parameter]]
name = "t"
property = "morph"
displacement = "longer.csv"
range = [-3.0, 3.0]
[[reduce]]
name = "bracket"
method = "parametric"
band_hz = [0, 12000]
tolerance = 1e-2
training = 16
[output]
path = "bracket.h5"
""")
job = load_job(folder / "bracket.toml")
result = run_job(job)
body = morembs.read_body(job.output).bodies["bracket"].parametric
print(f"{result.dofs} degrees of freedom, {len(body.at().M)} coordinates for all values")

# %%
# Values
# ------
# Each value takes milliseconds; values that are not named are nominal. Derivatives are exact for the reduced body.

at = body.at(E_lug=1.8e11, t=2.0)
slopes = body.sensitivity(E_lug=1.8e11, t=2.0).frequencies_hz
print(f"first frequency {at.frequencies_hz[0]:.2f} Hz, {slopes['t'][0]:.1f} Hz per millimetre")

# %%
# The bound
# ---------
# A model of its own at this value, from the moved mesh and the material of the lug, and the response of both.

moved = np.column_stack([0 * longer, 0 * longer, 2e-3 * longer])
there = morembs.Mesh(
    nodes=morembs.Nodes(ids=mesh.nodes.ids, xyz=mesh.nodes.xyz + moved, sets=mesh.nodes.sets),
    blocks=mesh.blocks,
    element_sets=mesh.element_sets,
)
steel = {"poisson": 0.3, "density": 7850.0}
lug = morembs.isotropic(set="LUG", young=1.8e11, **steel)
foot = morembs.isotropic(set="FOOT", young=2.1e11, **steel)
model = morembs.assemble(there, [lug, foot])
ends = [
    morembs.make_interface(model, name=name, nodes=morembs.select_nodes(model, f"set:{name}"))
    for name in ("BOLTS", "PIN")
]
hz = np.linspace(200.0, 12000.0, 60)
with morembs.Problem(model, ends, damping=morembs.Damping(beta=2e-7)) as problem:
    full = morembs.full_response(problem, 2 * np.pi * hz)
    scale = np.outer(problem.motion_scale, problem.motion_scale)
error = np.linalg.norm((at.response(hz) - full) * scale, axis=(1, 2))
bound = at.bound(hz)
print(f"{at.bound_kind}: {(bound / error).min():.2f} to {(bound / error).max():.2f} times the error")

plt.figure(figsize=(8, 4))
plt.semilogy(hz, np.linalg.norm(full * scale, axis=(1, 2)), label="response")
plt.semilogy(hz, bound, label="bound")
plt.semilogy(hz, error, "--", label="error")
plt.xlabel("Hz")
plt.ylabel("m/N")
plt.legend(frameon=False)
plt.show()

# %%
# All designs
# -----------
# The first frequency over both parameters, from 900 values.

E, t = np.linspace(1.5e11, 2.7e11, 30), np.linspace(-3.0, 3.0, 30)
table = np.array([[young, stretch] for stretch in t for young in E])
first = body.frequencies_hz(table, count=1).reshape(30, 30)

plt.figure(figsize=(6, 4))
lines = plt.contour(E / 1e9, t, first, 12)
plt.clabel(lines, fmt="%.0f Hz")
plt.xlabel("modulus of the lug, GPa")
plt.ylabel("t, mm")
plt.show()

# %%
# ``morembs evaluate bracket.h5 --at E_lug=1.8e11,t=2 -o at.h5`` writes an ordinary body file of a value, which every
# exporter takes; ``morembs update`` finds the values from measured frequencies. :doc:`/howto/parametric` has the rest.

at.write(folder / "at.h5")
print(f"at.h5 has {morembs.read_body(folder / 'at.h5').bodies['bracket'].floating.integrals.mass:.5f} kg")
