"""Advice before runs: stability of a step (`check`), effect of rounding, and the fastest method (`recommend`)."""

from .check import Check as Check
from .recommend import Recommendation as Recommendation
from .trials import Rounding as Rounding
