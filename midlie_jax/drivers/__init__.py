"""The drivers: `integrate`, `integrate_adaptive` and `ensemble` take many steps; `free_motion` needs none."""
