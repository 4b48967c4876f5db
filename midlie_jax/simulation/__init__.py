"""Long runs of many bodies: `simulate` computes a run in parts, writes each part, and can resume."""

from .saved import Saved as Saved
from .saved import saved_path as saved_path
from .simulate import simulate as simulate
from .summary import Inspection as Inspection
from .summary import Simulation as Simulation
from .summary import inspect as inspect
