"""A document of results in sections, which a terminal and a page show alike."""
