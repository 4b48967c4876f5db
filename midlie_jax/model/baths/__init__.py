"""Heat baths: friction and thermal noise, the argument `bath` of a run whose method has a bath stage.

`base` has what every bath needs, a temperature and a random key, and the checks that a run makes. `langevin` is the
bath of bodies. Another bath, for example one with noise in the space frame, is another class here. The bath of spins
is `midlie_jax.spins.ThermalField`.
"""

from .langevin import Langevin as Langevin
