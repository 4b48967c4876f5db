"""`midlie_jax.distributions`: the distributions for `midlie_jax.scatter`.

Each is checked on construction and holds no random state: the key of `scatter` determines all draws. A subclass of
`Distribution` with a method `draw(key, body, dtype)` is also a distribution.
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
