"""The `midlie` command: scenes, closed-form solutions, convergence, maps of stability, and charts.

No other part of the package imports this folder. `main`, `parser`, `options` and `readers` do not import JAX, so help
and errors of the command line appear immediately; `commands` does the work.
"""
