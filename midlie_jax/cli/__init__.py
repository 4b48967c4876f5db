"""The `midlie` command and what it needs: scenes, closed-form solutions, convergence, maps of stability, and charts.

No other part of the package imports this folder. `main`, `parser`, `options` and `readers` do not import JAX, so that
help and errors of the command line appear at once; `commands` does the work.
"""
