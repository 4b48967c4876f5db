"""The options of each command, in functions that add them to its parser; like `parser`, without JAX."""

from .fitting import fit as fit
from .lists import names as names
from .measuring import chart as chart
from .measuring import stability as stability
from .runs import export as export
from .runs import inspect as inspect
from .runs import run as run
from .runs import view as view
