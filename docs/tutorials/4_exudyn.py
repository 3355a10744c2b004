r"""
A mechanism in Exudyn
=====================

A beam swings about one end. The same body runs in the reference simulator of morembs and in `Exudyn
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
gravity, end, step = (0, 0, -9.81), 0.3, 5e-4

# %%
# The body
# --------
# Its floating frame stays with the interface ``ROOT``, where the hinge will be.

mesh = morembs.read_mesh("../../data/small_meshes/beam.msh")
model = morembs.assemble(mesh, [morembs.isotropic(set="all", young=2e9, poisson=0.3, density=1200.0)])
ends = [
    morembs.make_interface(model, name=name, nodes=morembs.select_nodes(model, f"set:{name}"), coupling="rigid")
    for name in ("ROOT", "TIP")
]
with morembs.Problem(model, ends) as problem:
    reduced = morembs.CraigBampton(modes=4).reduce(problem, name="beam")
    frame = morembs.floating_frame(problem, reduced, kind="tangent", interfaces=["ROOT"], origin=ends[0].point)
    body = morembs.elastic_body(problem, reduced, morembs.make_part(problem, nodes="skin"), floating=frame)
morembs.write_body(folder / "beam.h5", [body])

# %%
# In the reference simulator
# --------------------------

floating = morembs.read_body(folder / "beam.h5").bodies["beam"].floating
system = System(gravity=gravity)
beam = system.add(FlexibleBody(floating, position=floating.origin, name="beam"))
system.add(RevoluteJoint(ground.marker_at(floating.origin), beam.marker("ROOT"), axis=(0, 1, 0)))
result = simulate(system, end=end, step=step)
ours = result.position(beam.marker("TIP"))
bending = result.elastic(beam) @ floating.markers["TIP"].motion[2]

# %%
# In Exudyn
# ---------
# ``ExudynBody.of`` exports the body for ``ObjectFFRFreducedOrder``; ``ExudynSystem`` adds its damping and its weight,
# which the file cannot hold. Everything else of Exudyn is reached by ``system.mbs``.

system = ExudynSystem(gravity=gravity)
part = ExudynBody.of(folder / "beam.h5")
their_beam = system.elastic(part, position=floating.origin)
hinge = system.at_interface(their_beam, "ROOT")
system.joint(system.at_ground(floating.origin), hinge, (1, 1, 1, 1, 0, 1))
_, (theirs,) = system.solve(end=end, step=step, watch=[system.at_interface(their_beam, "TIP")])

# %%
# Both
# ----

gap = np.linalg.norm(ours - theirs, axis=1).max()
print(f"largest distance of the two tips: {gap:.1e} m, {gap / 0.5:.1e} of the length")

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8, 5))
above.plot(result.time, ours[:, 2], label="morembs")
above.plot(result.time, theirs[:, 2], "--", label="Exudyn")
above.set_ylabel("height of the tip, m")
above.legend()
below.plot(result.time, 1e3 * bending)
below.set_ylabel("bending of the tip, mm")
below.set_xlabel("time, s")
for axes in (above, below):
    axes.grid(alpha=0.3)
