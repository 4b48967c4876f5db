"""The mathematics of a step, in a form that XLA fuses: tuples of scalars, series, elliptic functions, roots.

Read `components` first.
"""
