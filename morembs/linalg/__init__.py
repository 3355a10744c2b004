"""Matrices only: sparse factorisations, eigenvalues, statics. Independent of finite elements."""

from morembs.linalg.sparse.threads import quiet_idle_threads

quiet_idle_threads()
