"""Spacecraft: control torques, disturbance torques along an orbit, thrust, and attitude files."""

from . import attitudes as attitudes
from .control import MomentumWheels as MomentumWheels
from .control import PDControl as PDControl
from .control import ReactionWheels as ReactionWheels
from .control import Thrust as Thrust
from .eddy_currents import EddyCurrents as EddyCurrents
from .free_molecular_drag import FreeMolecularDrag as FreeMolecularDrag
from .gravity_gradient import GravityGradient as GravityGradient
from .sidereal_time import gmst as gmst
from .wheels import DrivenWheels as DrivenWheels
