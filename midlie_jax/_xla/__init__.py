"""What makes XLA compile a step to one fast loop; nothing here knows about rigid bodies.

Read `fusion` first (one loop per step), then `replay` (evaluates a torque written on arrays by operations on scalars).
Every use of an undocumented part of JAX is in `internals`.
"""
