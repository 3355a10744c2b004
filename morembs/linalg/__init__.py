"""Matrices only: sparse factorisations, eigenvalues, statics. Knows nothing of finite elements."""

from morembs.linalg.sparse.threads import quiet_idle_threads

quiet_idle_threads()
