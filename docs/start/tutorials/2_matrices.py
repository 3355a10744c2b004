r"""
Matrices of another code
========================

The stiffness and mass matrices of any finite-element program will do. Here `scikit-fem
<https://scikit-fem.readthedocs.io>`__ stands for that program: it assembles a steel bar of 27-node hexahedra.
"""

import tempfile
from pathlib import Path

import numpy as np
from skfem import Basis, BilinearForm, ElementHex2, ElementVector, MeshHex, asm
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

import morembs
from morembs.importers.model_file import write_model

folder = Path(tempfile.mkdtemp())
young, poisson, density = 2.1e11, 0.3, 7850.0  # Pa, -, kg/m3
length, width, height = 0.3, 0.03, 0.02  # m

# %%
# The other program
# -----------------

grid = MeshHex.init_tensor(np.linspace(0, length, 13), np.linspace(0, width, 3), np.linspace(0, height, 2))
basis = Basis(grid, ElementVector(ElementHex2()), intorder=4)
K = asm(linear_elasticity(*lame_parameters(young, poisson)), basis)
M = asm(BilinearForm(lambda u, v, _: density * dot(u, v)), basis)

# %%
# Its degrees of freedom lie on vertices, edges, faces and in the middle of elements, in this order, and are
# displacements along x, y and z.

component = np.empty(basis.N, dtype=int)
for dofs in (basis.nodal_dofs, basis.edge_dofs, basis.facet_dofs, basis.interior_dofs):
    component[dofs] = np.arange(3)[:, None]
places, node = np.unique(basis.doflocs.T.round(9), axis=0, return_inverse=True)
print(f"{len(places)} nodes, {basis.N} degrees of freedom")

# %%
# The model
# ---------
# Two matrices in SI units, the nodes with their sets, and for every row its node and its component (0, 1, 2 for x, y,
# z; 3, 4, 5 for rotations).

sets = {name: np.flatnonzero(np.isclose(places[:, 0], x)) for name, x in (("LEFT", 0.0), ("RIGHT", length))}
nodes = morembs.Nodes(ids=np.arange(1, len(places) + 1), xyz=places, sets=sets)
model = morembs.from_matrices(K, M, nodes=nodes, node=node.ravel(), component=component, name="scikit-fem")

# %%
# Whether the matrices are symmetric, rigid motion strains the body, or its mass and size are those of a solid, is
# looked at before anything is computed. Errors would be raised; warnings are sentences.

print(morembs.list_warnings(model) or "nothing looks wrong")

# %%
# Matrices that are files already (Matrix Market, ANSYS, Nastran, Abaqus, CalculiX, MATLAB and others) are read by
# ``morembs import``, see :doc:`/reference/formats`. It writes a model file, which jobs take by
# ``[model] file = "bar.model.h5"``. From here:

write_model(folder / "bar.model.h5", model)

# %%
# Reduction
# ---------

ends = [
    morembs.make_interface(model, name=name, nodes=morembs.select_nodes(model, f"set:{name}"), coupling="rigid")
    for name in ("LEFT", "RIGHT")
]
with morembs.Problem(model, ends) as problem:
    reduced = morembs.CraigBampton(modes=10).reduce(problem, name="bar")
    body = morembs.elastic_body(problem, reduced, morembs.make_part(problem, nodes="all"))
morembs.write_body(folder / "bar.h5", [body])

# %%
# An independent figure: the first bending frequency of a free beam by Euler and Bernoulli, which neglects shear and so
# lies above that of the solid.

first = morembs.read_body(folder / "bar.h5").bodies["bar"].frequencies_hz[6]
euler = 4.730041**2 / (2 * np.pi * length**2) * np.sqrt(young * height**2 / 12 / density)
print(f"first elastic frequency {first:.1f} Hz; Euler-Bernoulli beam {euler:.1f} Hz")
