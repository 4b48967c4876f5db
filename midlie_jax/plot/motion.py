"""`Motion`: the trustworthy part of a path, which is drawn."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._checks.arguments import described
from ..drivers.path import Path
from ..model import so3
from ..model.bodies import Body
from ..model.compatibility import check_body
from ..model.state import AnyState, State, attitude_of
from ..model.states import AxisState, Coupled, RigidState, TravellingState

# States with an axis of the body in space.
OrientedState = RigidState | AxisState | TravellingState

# Compiled, because a picture calls them for each body.
slerp, to_matrix = jax.jit(so3.slerp), jax.jit(so3.to_matrix)
_spatial_momentum = jax.jit(lambda states: states.spatial_momentum())


class Motion(NamedTuple):
    """The motion of one body, or of coupled bodies, at n different times, n at least 2."""

    times: np.ndarray
    states: AnyState
    failed: str  # the text on the picture if the run failed; "" if it did not

    @property
    def turning(self) -> "Motion":
        """Only the rotation of a body that also translates; the motion itself of any other body."""
        states = self.states
        return self._replace(states=states.turning) if isinstance(states, TravellingState) else self

    @property
    def has_axis_alone(self) -> bool:
        """Whether the states hold only the axis of symmetry and no attitude."""
        return isinstance(self.turning.states, AxisState)

    def directions(self, axis: np.ndarray) -> np.ndarray:
        """The unit vectors in space of an axis of the body, (n, 3).

        Raises:
            ValueError: the states hold no direction in space, or only the direction of another axis.
        """
        states = self.turning.states
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

    @property
    def spatial_momenta(self) -> np.ndarray:
        """The angular momenta about the centre of mass or the fixed point, in space, (n, 3)."""
        return np.asarray(_spatial_momentum(self.turning.states), float)

    def turns_by(self, body: Body) -> np.ndarray:
        """The approximate rotation angles of the body, or of its axis, from each time to the next, (n - 1,)."""
        check_body(body, self.states)
        speeds = np.linalg.norm(np.asarray(jax.vmap(body.turning.velocity)(self.turning.states.momentum)), axis=1)
        return (speeds[:-1] + speeds[1:]) / 2 * np.abs(np.diff(self.times))


def motion_of(path: Any, *, together: bool = False) -> Motion:
    """The part of a path of one body before the run failed, without repeated times; `together` allows coupled bodies.

    Raises:
        ValueError: the argument is not such a path, or fewer than two of its states can be trusted.
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
    kept = jax.tree.map(lambda leaf: leaf[keep], states)
    ok = good == len(times) and bool(path.ok)
    return Motion(times[keep], kept, "" if ok else f"FAILED after t = {times[good - 1]:.6g}")


def path_of_one(path: Any, i: int) -> Any:
    """The path of one of coupled bodies."""
    return path._replace(states=path.states.of_body(i))
