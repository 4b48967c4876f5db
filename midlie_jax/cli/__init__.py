"""The `midlie` command and what it needs: scenes, closed-form solutions, convergence, maps of stability, and charts.

No other part of the package imports this one. `main`, `parser`, `options` and `readers` do without JAX, so that help
and the refusal of a wrong line come at once; `commands` does the work.
"""
