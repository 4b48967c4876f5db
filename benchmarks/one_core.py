"""Importing this holds the process to one core, before XLA counts the cores, and gives JAX float64."""

import jax

from midlie_jax.advice.timing import pin

pin()
jax.config.update("jax_enable_x64", True)
