"""Long runs of many bodies: `simulate` computes a run in parts, writes each part, and can resume."""

from .inspect import Inspection as Inspection
from .inspect import inspect as inspect
from .saved import Saved as Saved
from .saved import saved_path as saved_path
from .simulate import simulate as simulate
from .summary import Simulation as Simulation
