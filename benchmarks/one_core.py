"""Importing this gives JAX float64 and holds a benchmark to one core, before XLA counts the cores; a test keeps all."""

import sys
from pathlib import Path

import jax

from midlie_jax.advice.timing import pin

if Path(sys.argv[0]).resolve().parent == Path(__file__).resolve().parent:
    pin()
jax.config.update("jax_enable_x64", True)
