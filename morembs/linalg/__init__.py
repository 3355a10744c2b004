"""Matrices only: sparse factorisations, eigenvalues, statics. Knows nothing of finite elements."""
