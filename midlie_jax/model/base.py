"""The base classes of a custom kind of body and state; docs/extending.md shows an example."""

from .bodies import Body as Body
from .leaf import Leaf as Leaf
from .state import State as State
