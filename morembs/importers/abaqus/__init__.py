"""Decks of Abaqus and CalculiX (.inp): text, keywords, parts, sets, materials, couplings; ``importer`` is the entry."""
