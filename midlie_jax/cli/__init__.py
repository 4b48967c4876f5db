"""The `midlie` command: its options and commands, scenes, the exact motion, convergence, maps of stability, and charts.

No other part of the package imports this folder. `main` and `options` do not import JAX, so help and errors of the
command line appear immediately.
"""
