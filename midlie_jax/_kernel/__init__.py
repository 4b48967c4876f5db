"""How XLA is kept fast: arithmetic on components, fusion, short series, Newton's method. It knows no bodies.

Read `components` first, then `fusion` (one loop a step) and `replay` (a torque written on arrays, run on components).
Every use of an undocumented part of JAX is in `internals`.
"""
