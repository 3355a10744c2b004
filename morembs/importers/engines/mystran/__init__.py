"""MYSTRAN as the program that assembles a deck; ``importer`` is the entry."""
