"""Settings of every test, made before anything else is imported.

float64 on; mixed dtypes and silent broadcasting over ranks are errors. Nothing here imports midlie_jax: the type
checkers that pytest attaches to the package (see pyproject.toml) come after this file.
"""

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


def pytest_collection_modifyitems(items):
    """Tests of one method to one worker (`--dist loadgroup`), which then compiles once for all of them."""
    for item in items:
        name = getattr(item, "callspec", None) and item.callspec.params.get("name")
        if isinstance(name, str):
            item.add_marker(pytest.mark.xdist_group(name))
