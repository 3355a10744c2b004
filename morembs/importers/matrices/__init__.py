"""Files that hold matrices: one file per format; ``from_matrices`` takes matrices of SciPy."""
