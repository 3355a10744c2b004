"""Bodies for every value of a box of parameters: affine terms of K and M, one global basis, the bound of the error."""
