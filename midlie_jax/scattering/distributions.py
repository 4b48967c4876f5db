"""The distributions of `midlie_jax.scatter`, all in one place: `midlie_jax.distributions`.

Each is checked when it is made, and has no randomness of its own: the key of `scatter` decides all draws. A subclass of
`Distribution` with a method `draw(key, body, dtype)` is a distribution, too.
"""

from .base import Distribution as Distribution
from .data import Each as Each
from .data import Key as Key
from .data import Rows as Rows
from .numbers import Joint as Joint
from .numbers import LogNormal as LogNormal
from .numbers import Normal as Normal
from .numbers import Uniform as Uniform
from .rotations import Rotation as Rotation
from .rotations import RotationNear as RotationNear
from .rotations import Sphere as Sphere
