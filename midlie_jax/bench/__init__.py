"""The laboratory: scenes, closed forms, other programs, convergence, charts and the `midlie` command.

Nothing outside this folder imports it.
"""
