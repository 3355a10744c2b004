"""Bulk data of Nastran: cards, grids, elements, ties, properties, restraints; ``importer`` is the entry."""
