"""Stress of a model, of a reduced body, and of its motions."""
