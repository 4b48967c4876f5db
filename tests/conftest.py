"""Settings of every test, made before anything else is imported.

float64 on; mixed dtypes and silent broadcasting over ranks are errors. Nothing here imports midlie_jax: the type
checkers that pytest attaches to the package (see pyproject.toml) come after this file.
"""

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
