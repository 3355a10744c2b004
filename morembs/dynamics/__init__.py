"""Bodies at work.

``assembly`` couples bodies, ``multibody`` simulates systems of them, ``nonlinear`` has components of large deflections,
and ``gmp`` reduces those (global modal parameterisation).
"""
