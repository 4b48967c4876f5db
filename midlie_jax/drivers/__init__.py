"""Many steps and many bodies: `integrate`, `integrate_adaptive`, `ensemble`, `recommend`, and how runs are timed."""
