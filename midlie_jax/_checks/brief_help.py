"""`BriefHelp`: the metaclass of states, bodies and torques, whose `help` leaves out what Equinox adds to a class."""

from types import FunctionType
from typing import TYPE_CHECKING

import equinox as eqx

if TYPE_CHECKING:
    BriefHelp = type(eqx.Module)
else:

    class BriefHelp(type(eqx.Module)):
        """`dir` of a class, and so `help` and completion, list of names like `__hash__` only the package's methods."""

        def __dir__(cls) -> list[str]:
            bases = [
                base for base in cls.__mro__ if not base.__module__.startswith(("equinox", "builtins", "collections"))
            ]
            own = {name for base in bases for name, value in vars(base).items() if isinstance(value, FunctionType)}
            return [name for name in super().__dir__() if not name.startswith("__") or name in own - {"__replace__"}]
