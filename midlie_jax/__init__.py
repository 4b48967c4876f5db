"""midlie_jax: the rotation of many rigid bodies at once, by explicit midpoint Lie integrators, on JAX."""

from . import densities as densities
from . import flights as flights
from . import orbits as orbits
from . import schemes as schemes
from . import so3 as so3
from . import torques as torques
from .adaptive import AdaptivePath as AdaptivePath
from .adaptive import integrate_adaptive as integrate_adaptive
from .bodies import DirectionState as DirectionState
from .bodies import MomentumState as MomentumState
from .bodies import Particles as Particles
from .bodies import ParticleState as ParticleState
from .bodies import RigidBody as RigidBody
from .bodies import RigidState as RigidState
from .bodies import kinetic_energy as kinetic_energy
from .bodies import spatial_momentum as spatial_momentum
from .diffrax_solver import LieInterpolation as LieInterpolation
from .diffrax_solver import LieSolver as LieSolver
from .diffrax_solver import RigidBodyTerm as RigidBodyTerm
from .diffrax_solver import RotationNorm as RotationNorm
from .ensemble import ensemble as ensemble
from .integrate import Path as Path
from .integrate import integrate as integrate
from .methods import method as method
from .methods import methods as methods
from .torques import energy as energy
