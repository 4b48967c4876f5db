"""Advice before runs: stability of a step (`check`), effect of rounding, and the fastest method (`recommend`)."""
