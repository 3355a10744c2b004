"""Displacements and stresses of all nodes from the motion of a body."""
