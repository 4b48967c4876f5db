"""What makes XLA compile a step to one fast loop; nothing here knows about rigid bodies.

Read `fusion` first (one loop a step), then `replay` (runs a torque written on arrays on scalars). Every use of an
undocumented part of JAX is in `internals`.
"""
