"""Attacks on the program: runs that are killed, inputs that are damaged; ``python -m benchmarks.attack --help``.

Every trial is drawn from the seed, its kind and its number alone, so that one command repeats one failure.
"""
