"""Sparse factorisations: the contract, one file for each solver, their choice."""
