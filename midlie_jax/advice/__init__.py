"""Advice about runs: is a step sane (`check`), what will rounding do, which method is the fastest (`recommend`)."""
