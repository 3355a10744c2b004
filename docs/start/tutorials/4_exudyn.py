r"""
A mechanism in Exudyn
=====================

A rod of a soft plastic swings about one end. The same body runs in the reference simulator of morembs and in `Exudyn
<https://exudyn.readthedocs.io>`__ (``pip install exudyn``).
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import morembs
from morembs.dynamics.multibody import FlexibleBody, RevoluteJoint, System, ground, simulate
from morembs.exporters.exudyn_system import ExudynBody, ExudynSystem

folder = Path(tempfile.mkdtemp())
gravity, end, step = (0, -9.81, 0), 0.2, 2.5e-4

# %%
# The body
# --------
# Its floating frame stays with the interface ``BIGEND``, where the hinge will be.

mesh = morembs.read_mesh(morembs.examples.rod(folder), "mm-t-s")
model = morembs.assemble(mesh, [morembs.isotropic(set="all", young=1e8, poisson=0.4, density=1100.0)])
ends = [
    morembs.make_interface(model, name=name, nodes=morembs.select_nodes(model, f"set:{name}"), coupling="rigid")
    for name in ("BIGEND", "SMALLEND")
]
with morembs.Problem(model, ends) as problem:
    reduced = morembs.CraigBampton(modes=4).reduce(problem, name="rod")
    frame = morembs.floating_frame(problem, reduced, kind="tangent", interfaces=["BIGEND"], origin=ends[0].point)
    body = morembs.elastic_body(problem, reduced, morembs.make_part(problem, nodes="skin"), floating=frame)
morembs.write_body(folder / "rod.h5", [body])

# %%
# In the reference simulator
# --------------------------

floating = morembs.read_body(folder / "rod.h5").bodies["rod"].floating
system = System(gravity=gravity)
rod = system.add(FlexibleBody(floating, position=floating.origin, name="rod"))
system.add(RevoluteJoint(ground.marker_at(floating.origin), rod.marker("BIGEND"), axis=(0, 0, 1)))
result = simulate(system, end=end, step=step)
ours = result.position(rod.marker("SMALLEND"))
bending = result.elastic(rod) @ floating.markers["SMALLEND"].motion[1]

# %%
# In Exudyn
# ---------
# ``ExudynBody.of`` exports the body for ``ObjectFFRFreducedOrder``; ``ExudynSystem`` adds its damping and its weight,
# which the file cannot hold. Everything else of Exudyn is reached by ``system.mbs``.

system = ExudynSystem(gravity=gravity)
part = ExudynBody.of(folder / "rod.h5")
their_rod = system.elastic(part, position=floating.origin)
hinge = system.at_interface(their_rod, "BIGEND")
system.joint(system.at_ground(floating.origin), hinge, (1, 1, 1, 1, 1, 0))
_, (theirs,) = system.solve(end=end, step=step, watch=[system.at_interface(their_rod, "SMALLEND")])

# %%
# Both
# ----

gap = np.linalg.norm(ours - theirs, axis=1).max()
print(f"largest distance of the two small ends: {gap:.1e} m, {gap / 0.12:.1e} of the length")

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8, 5))
above.plot(result.time, ours[:, 1], label="morembs")
above.plot(result.time, theirs[:, 1], "--", label="Exudyn")
above.set_ylabel("height of the small end, m")
above.legend()
below.plot(result.time, 1e3 * bending)
below.set_ylabel("bending of the small end, mm")
below.set_xlabel("time, s")
for axes in (above, below):
    axes.grid(alpha=0.3)
