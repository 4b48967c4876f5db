"""The kinds of state, each with the file that it is from."""

from .coupled import Coupled as Coupled
from .coupled import CoupledAxisState as CoupledAxisState
from .coupled import CoupledFreeAxisState as CoupledFreeAxisState
from .coupled import CoupledRigidState as CoupledRigidState
from .coupled import CoupledState as CoupledState
from .free import FreeAxisState as FreeAxisState
from .free import FreeState as FreeState
from .free import TravellingState as TravellingState
from .particles import ParticleState as ParticleState
from .rigid import CompensatedState as CompensatedState
from .rigid import MomentumState as MomentumState
from .rigid import RigidState as RigidState
from .unit_vector import AxisState as AxisState
from .unit_vector import DirectionState as DirectionState
