"""What every room uses and what knows none of them.

``errors`` and ``python_warnings`` tell users what is wrong. ``types`` names kinds of arrays. ``arguments`` and
``options`` check what is given, within the ``limits`` that stand with types. ``plugins`` are tables that other packages
extend. ``units`` and ``summary`` read and show numbers.
``progress``, ``stopping`` and ``closing`` serve work that takes long, is interrupted, or holds something. ``memory``,
``budget`` and ``scratch`` count memory and put files in its place. ``worker_pool`` has processes that work together,
``optional`` the libraries that may be absent.
"""
