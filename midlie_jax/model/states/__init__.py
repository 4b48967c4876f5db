"""The kinds of state, each imported at its first use; `model/state.py` defines their interface."""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
