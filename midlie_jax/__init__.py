"""midlie_jax integrates the rotation of many rigid bodies at once, by explicit midpoint Lie methods, on JAX.

This module lists the public names; everything else is internal.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from .drivers import observe as observe
from .drivers.adaptive import integrate_adaptive as integrate_adaptive
from .drivers.adjoints import Checkpointed as Checkpointed
from .drivers.adjoints import Forward as Forward
from .drivers.adjoints import Reversible as Reversible
from .drivers.check import Check as Check
from .drivers.check import check as check
from .drivers.energy import energy as energy
from .drivers.ensemble import ensemble as ensemble
from .drivers.free_motion import free_motion as free_motion
from .drivers.integrate import integrate as integrate
from .drivers.path import AdaptivePath as AdaptivePath
from .drivers.path import Path as Path
from .drivers.recommend import Recommendation as Recommendation
from .drivers.recommend import recommend as recommend
from .drivers.results import RESULTS as RESULTS
from .methods import flights as flights
from .methods import schemes as schemes
from .methods.registry import method as method
from .methods.registry import methods as methods
from .model import densities as densities
from .model import orbits as orbits
from .model import so3 as so3
from .model import torques as torques
from .model.bodies import Body as Body
from .model.bodies import Particles as Particles
from .model.bodies import RigidBody as RigidBody
from .model.bodies import TensorBody as TensorBody
from .model.observables import angular_velocity as angular_velocity
from .model.observables import kinetic_energy as kinetic_energy
from .model.observables import spatial_angular_velocity as spatial_angular_velocity
from .model.observables import spatial_momentum as spatial_momentum
from .model.state import State as State
from .model.states import CompensatedState as CompensatedState
from .model.states import DirectionState as DirectionState
from .model.states import MomentumState as MomentumState
from .model.states import ParticleState as ParticleState
from .model.states import RigidState as RigidState
from .scattering import distributions as distributions
from .scattering import scatter as scatter
from .simulation.simulate import simulate as simulate
from .simulation.summary import Simulation as Simulation

if TYPE_CHECKING:
    from . import diffrax as diffrax
    from . import fitting as fitting
    from . import plot as plot
    from .diffrax import LieInterpolation as LieInterpolation
    from .diffrax import LieSolver as LieSolver
    from .diffrax import RigidBodyTerm as RigidBodyTerm
    from .diffrax import RotationNorm as RotationNorm
    from .fitting import fit as fit

    # These modules can be called, which type checkers do not know.
    from .methods.as_typed import flights as flights
    from .methods.as_typed import schemes as schemes


def __getattr__(name: str) -> Any:
    """What takes time, or an extra, is done when it is first asked for: diffrax, `fit`, `plot` and the version."""
    if name in ("diffrax", "fitting", "plot"):
        return import_module(f".{name}", __name__)
    if name in ("LieInterpolation", "LieSolver", "RigidBodyTerm", "RotationNorm"):
        return getattr(import_module(".diffrax", __name__), name)
    if name == "fit":
        return import_module(".fitting", __name__).fit
    if name == "__version__":  # of the installed package, whose version is in pyproject.toml
        return version(__name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
