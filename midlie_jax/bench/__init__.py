"""Benchmarks: scenes, closed-form solutions, other programs, convergence, charts and the `midlie` command.

No other part of the package imports this one.
"""
