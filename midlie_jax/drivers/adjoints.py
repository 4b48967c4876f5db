"""How the derivative of a run is computed: the argument `adjoint` of `integrate`, `ensemble` and others."""

from .derivatives import Checkpointed as Checkpointed
from .derivatives import Forward as Forward
from .derivatives import Reversible as Reversible
