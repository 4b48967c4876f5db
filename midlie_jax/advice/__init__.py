"""Advice about runs: whether a step is sane (`check`), what rounding does, and the fastest method (`recommend`)."""
