"""`Motion`: the trustworthy part of a path, which is drawn."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._checks.arguments import described
from ..drivers.path import Path
from ..model import so3
from ..model.state import AnyState, State, attitude_of
from ..model.states import AxisState, Coupled, RigidState, TravellingState

# States with an axis of the body in space.
OrientedState = RigidState | AxisState | TravellingState

to_matrix = jax.jit(so3.to_matrix)  # compiled, because a picture calls it for each body


class Motion(NamedTuple):
    """The motion of one body, or of coupled bodies, at n different times, n at least 2."""

    times: np.ndarray
    states: AnyState
    failed: str  # the text on the picture if the run failed; "" if it did not

    @property
    def turning(self) -> Any:
        return self.states.turning if isinstance(self.states, TravellingState) else self.states

    def directions(self, axis: np.ndarray) -> np.ndarray:
        """The unit vectors in space of an axis of the body, (n, 3); a ValueError if the states do not define them."""
        states = self.turning
        if isinstance(states, AxisState):
            if abs(axis[2]) < 1 - 1e-6:
                raise ValueError(
                    f'axis must be "e3" for a {type(self.states).__name__}, which holds no other direction of the '
                    "body. Integrate a state with an attitude for others."
                )
            tips = np.asarray(states.axis, float) * np.sign(axis[2])
        else:
            tips = np.asarray(to_matrix(jnp.asarray(attitude_of(states))), float) @ axis
        return tips / np.linalg.norm(tips, axis=1, keepdims=True)


def motion_of(path: Any, *, together: bool = False) -> Motion:
    """The part of a path of one body before the run failed, without repeated times; `together` allows coupled bodies.

    It raises a ValueError if the argument is no such path, or fewer than two of its states can be trusted.
    """
    states: Any = getattr(path, "states", None)
    if not isinstance(path, Path) or not (isinstance(states, State) and states.own_axes):
        raise ValueError(
            f"path must be a path of a rigid body with its states, got {described(path)} that holds "
            f"{described(states)}. Integrate without observe=."
        )
    times = np.asarray(path.times)
    if isinstance(states, Coupled) and not together:
        raise ValueError(
            f"path must be of one body, got a {type(states).__name__} with {states.count}. Take body i by "
            "path._replace(states=path.states.of_body(i)), and its row of the body."
        )
    if times.ndim != 1 or states.batch != times.shape:
        raise ValueError(
            f"path must be of one body with several times, got momenta {states.momentum.shape} and times "
            f"{times.shape}. Take body k: "
            "ml.Path(path.times, jax.tree.map(lambda x: x[k], path.states), path.ok[k], path.first_bad[k])."
        )
    good = int(path.first_bad)
    if good < 2:
        raise ValueError(
            f"path must have 2 good states, got {good}; see path.first_bad. Take a smaller step or save more often."
        )
    keep = np.flatnonzero(np.append(True, np.diff(times[:good]) != 0))
    if len(keep) < 2:
        raise ValueError("times of path must differ, got the same time throughout. Integrate with another dt.")
    ok = good == len(times) and bool(path.ok)
    failed = "" if ok else f"FAILED after t = {times[good - 1]:.6g}"
    return Motion(times[keep], jax.tree.map(lambda leaf: leaf[keep], states), failed)


def path_of_one(path: Any, i: int) -> Any:
    """The path of one of coupled bodies."""
    return path._replace(states=path.states.of_body(i))
