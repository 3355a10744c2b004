"""morembs: finite-element models to small elastic bodies for multibody simulation.

The steps of a reduction: ``read_mesh`` -> ``assemble`` -> ``make_interface`` -> ``Problem`` -> a reducer's
``reduce`` -> ``elastic_body`` -> ``write_body``. All values are in SI units.

A name is imported at its first use; ``__init__.pyi`` lists its module. The examples of all functions and classes use
the following objects: a bar of four elements, free (``model``) and held at its left end (``clamped``):

>>> import numpy as np
>>> from morembs import CraigBampton, Damping, DofMap, ElementBlock, FEModel, Mesh, Nodes, Problem
>>> from morembs import assemble, elastic_body, isotropic, make_interface, make_part
>>> x, y, z = np.meshgrid(np.linspace(0, 0.4, 5), [0, 0.05], [0, 0.05], indexing="ij")
>>> ends = {"LEFT": np.arange(4), "RIGHT": np.arange(16, 20)}
>>> nodes = Nodes(ids=np.arange(1, 21), xyz=np.stack([x, y, z], axis=-1).reshape(-1, 3), sets=ends)
>>> cells = np.array([0, 4, 6, 2, 1, 5, 7, 3]) + 4 * np.arange(4)[:, None]
>>> mesh = Mesh(nodes=nodes, blocks=(ElementBlock(type="hex8", nodes=cells, ids=np.arange(1, 5)),), source="bar")
>>> steel = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
>>> model = assemble(mesh, [steel])
>>> interfaces = [make_interface(model, name=name, nodes=rows) for name, rows in ends.items()]
>>> problem = Problem(model, interfaces, damping=Damping(modal=0.02))
>>> reduced = CraigBampton(modes=6).reduce(problem)
>>> body = elastic_body(problem, reduced, make_part(problem))
>>> free = np.arange(12, 60)                                         # all but the left end
>>> rows = DofMap(node=free // 3, component=free % 3)
>>> K, M = (A[free][:, free] for A in (model.K, model.M))
>>> clamped = FEModel(K=K, M=M, D=1e-5 * K, nodes=nodes, dofs=rows, source="clamped bar")
>>> held = Problem(clamped, [make_interface(clamped, name="tip", nodes=ends["RIGHT"])])
"""

import lazy_loader

# First, as it quiets the idle threads of OpenBLAS before NumPy loads its copy.
import morembs.linalg  # noqa: F401
from morembs.base.errors import alike
from morembs.version import VERSION

__version__ = VERSION
_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    try:
        return _imported(name)
    except AttributeError as error:
        # Python asks for names of its own, such as __path__; they get its own answer.
        if name.startswith("_"):
            raise
        near = alike(name, __all__)
        cure = f"did you mean {near!r}?" if near else "dir(morembs) lists what there is"
        raise AttributeError(f"morembs has no {name!r}; {cure}", name=name) from error
