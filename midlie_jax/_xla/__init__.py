"""What makes XLA compile a step to one fast loop; independent of rigid bodies.

Read `fusion` first (one loop per step), then `replay` (evaluates a torque on arrays by operations on scalars). All uses
of undocumented parts of JAX are in `internals`.
"""
