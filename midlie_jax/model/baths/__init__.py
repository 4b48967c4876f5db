"""Heat baths: friction and thermal noise, the argument `bath` of a run whose method has a bath stage.

A bath is a friction, a noise, or both, and baths add. `Langevin` has both, in the frame of the body. `Recoil` is noise
alone, in the space frame. The bath of spins is `midlie_jax.spins.ThermalField`.
"""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
