"""The drivers: `integrate`, `integrate_variable_step` and `ensemble` take many steps; `free_motion` needs none."""
