"""Archives of ANSYS (.cdb): commands, blocks, elements, properties, sets, ties; ``cdb`` is the entry."""
