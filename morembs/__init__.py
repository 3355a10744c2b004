"""morembs: finite-element models to small elastic bodies for multibody simulation.

The straight line: ``read_mesh`` -> ``assemble`` -> ``make_interface`` -> ``Problem`` -> a reducer's
``reduce`` -> ``elastic_body`` -> ``write_body``. Everything inside is in SI units.

Each name is imported when it is first used; ``__init__.pyi`` says from where.
"""

import lazy_loader

# First, as it quiets the idle threads of OpenBLAS before NumPy loads its copy.
import morembs.linalg  # noqa: F401
from morembs.moved import accept_old_names
from morembs.version import VERSION

accept_old_names()
__version__ = VERSION
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
