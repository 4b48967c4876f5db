"""The kinds of state, one per file: a momentum alone, or with one direction, the attitude, or the axis of symmetry.

The last two can also translate; particles have positions only. `model/state.py` defines the interface of every state
for steps and torques. A kind is imported at its first use.
"""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
