"""Everything that makes XLA compile a step to one fast loop; nothing here knows about rigid bodies.

Read `components` first (arithmetic on tuples of scalars), then `fusion` (one loop per step) and `replay` (runs a torque
written on arrays on components). `short_series`, `weierstrass` and `newton` compute functions and roots in a form that
fuses. Every use of an undocumented part of JAX is in `internals`.
"""
