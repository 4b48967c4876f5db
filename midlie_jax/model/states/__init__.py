"""The kinds of state, one per file: the momentum with nothing, one direction, the attitude, or particles' positions.

What every state offers to steps and torques is in `model/state.py`.
"""

from .compensated import CompensatedState as CompensatedState
from .direction import DirectionState as DirectionState
from .momentum import MomentumState as MomentumState
from .particles import ParticleState as ParticleState
from .rigid import RigidState as RigidState
from .rigid import attitude_of as attitude_of
from .rigid import with_attitude as with_attitude
