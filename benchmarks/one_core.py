"""Importing this gives JAX float64 and holds a benchmark to one core, or with `--all-cores` to all; no test."""

import os
import sys
from pathlib import Path

import jax

from midlie_jax.advice.timing import pin

if Path(sys.argv[0]).resolve().parent == Path(__file__).resolve().parent:
    if "--all-cores" not in sys.argv:
        pin()
    elif hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
jax.config.update("jax_enable_x64", True)
