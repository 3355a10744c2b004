"""Bodies as C code: alone, and as Functional Mock-up Units of the Modelica Association."""
