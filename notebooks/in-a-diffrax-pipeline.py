# %% [markdown]
# # In a diffrax pipeline
#
# You integrate with [diffrax](https://docs.kidger.site/diffrax/) and fit with optimistix or optax. A rotating body is
# part of the problem.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import matplotlib.pyplot as plt

fig, axes = plt.subplots()
axes.plot([1, 2, 3])
plt.show()
