"""Pictures of ensembles on matplotlib's axes (extra `plot`). `import midlie_jax` imports neither this nor matplotlib.

Modules: `bands` (quantiles against time), `apart` (labels that do not collide; `bench` uses it, too).
"""

from .bands import Bands as Bands
from .bands import bands as bands
