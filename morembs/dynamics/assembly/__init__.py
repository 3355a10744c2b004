"""Bodies made of bodies: reduced bodies coupled at their interfaces, as a finite-element model to reduce again.

Each part is K, M, D in the degrees of freedom of its interfaces, turned and moved to its place, and scalars beside them
(Craig and Bampton 1968; Hurty 1965). Couplings are equations between interface degrees of freedom, or springs. Where a
part keeps nodes, these follow its coordinates, so that shapes of the assembly can be seen.
"""

from morembs.dynamics.assembly.bodies import AssembledModel, assemble_bodies
from morembs.dynamics.assembly.joints import Couple
from morembs.dynamics.assembly.parts import Substructure
from morembs.dynamics.assembly.unreduced import Unreduced

__all__ = ["AssembledModel", "Couple", "Substructure", "Unreduced", "assemble_bodies"]
