"""Measurements of a rotating body, each with its residual: the difference from a model, in units of its sigma.

A value that is NaN is missing: its residual is zero and it is not counted. Shapes are those of one data set; to fit
many data sets at once, map over the arrays of a measurement with `jax.vmap`.

Files: `base` (what all have in common), `source` (biases, markers and clocks), `observed` (any quantity), and what is
measured so often that it has a class: `instruments` and `accelerations`.
"""

from .accelerations import Accelerations as Accelerations
from .base import Measurement as Measurement
from .base import check_parts as check_parts
from .instruments import Attitudes as Attitudes
from .instruments import Directions as Directions
from .instruments import Positions as Positions
from .instruments import Rates as Rates
from .observed import Observed as Observed
from .source import Source as Source
