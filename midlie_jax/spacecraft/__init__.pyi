"""Spacecraft: control torques, disturbance torques along an orbit, thrust, and attitude files."""

from . import attitudes as attitudes
from .control import DrivenWheels as DrivenWheels
from .control import MomentumWheels as MomentumWheels
from .control import PDControl as PDControl
from .control import ReactionWheels as ReactionWheels
from .control import Thrust as Thrust
from .disturbances import EddyCurrents as EddyCurrents
from .disturbances import FreeMolecularDrag as FreeMolecularDrag
from .disturbances import GravityGradient as GravityGradient
from .sidereal_time import gmst as gmst
