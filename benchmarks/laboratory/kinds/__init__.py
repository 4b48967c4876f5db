"""What the programs are told of each kind of state: its equations of motion on numbers, and the error of its end.

The numbers of a state are its arrays one after another, in the order of its fields. A new kind needs a file here and a
line in `kind_of`; nothing else tells the kinds apart.
"""

from typing import Any

import jax
import numpy as np

from midlie_jax.cli.scenes import Scene
from midlie_jax.model.states import AxisState, FreeState, RigidState

from . import axis, free, rigid
from .kind import Kind as Kind


def kind_of(scene: Scene) -> Kind:
    """The kind of the state of a scene."""
    return {RigidState: rigid.RIGID, AxisState: axis.AXIS, FreeState: free.FREE}[type(scene.start)]


def numbers(states: Any) -> np.ndarray:
    """The numbers (n, k) of states with a leading axis n."""
    return np.concatenate([np.asarray(leaf) for leaf in jax.tree.leaves(states)], axis=-1)


def sizes(start: Any) -> np.ndarray:
    """The size of each number of a state, (k,): the norm of its array; tolerances are relative to it."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(start)]
    return np.concatenate([np.full(len(leaf), np.linalg.norm(leaf)) for leaf in leaves])
