"""The mathematics of a step, in a form that fuses: arithmetic on tuples of scalars, series, elliptic functions, roots.

Read `components` first.
"""
