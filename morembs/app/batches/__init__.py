"""Many jobs at once: which are due, processes that run them, and what is remembered of them."""
