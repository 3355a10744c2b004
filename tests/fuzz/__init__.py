"""Whole jobs across features, drawn at random, run through the command line, and judged by a truth of their own."""
