"""The drivers: `integrate`, `integrate_adaptive` and `ensemble` take many steps; `recommend` chooses a method."""
