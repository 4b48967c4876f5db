"""`Motion`: the part of a path that is drawn, because it can be trusted."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._checks.arguments import described
from ..drivers.path import AdaptivePath, Path
from ..model import so3
from ..model.bodies import Body
from ..model.compatibility import check_body
from ..model.state import AnyState, State
from ..model.states import AxisState, Coupled, TravellingState, attitude_of


class Motion(NamedTuple):
    """The motion of one body, at times that all differ.

    Attributes:
        times: (n,), n at least 2.
        states: the states, of the class of the path's states, with a leading axis (n,).
        failed: what the picture must say if the run failed; "" if it did not.
    """

    times: np.ndarray
    states: AnyState
    failed: str

    @property
    def turning(self) -> "Motion":
        """The rotation alone of a body that also travels; of any other body the motion itself."""
        states = self.states
        return self._replace(states=states.turning) if isinstance(states, TravellingState) else self

    @property
    def momenta(self) -> np.ndarray:
        """The angular momenta about the centre of mass or the fixed point, in the frame of the state, (n, 3)."""
        return np.asarray(self.states.momentum)

    @property
    def attitudes(self) -> np.ndarray:
        """The attitudes (n, 4); a ValueError if the states have none."""
        return np.asarray(attitude_of(self.states))

    @property
    def has_axis_alone(self) -> bool:
        """Whether of the rotation only the axis of symmetry is known."""
        return isinstance(self.turning.states, AxisState)

    def directions(self, axis: np.ndarray) -> np.ndarray:
        """The unit vectors in space of an axis of the body, (n, 3).

        Raises:
            ValueError: the states hold no direction in space, or only that of another axis.
        """
        states = self.turning.states
        if isinstance(states, AxisState):
            if abs(axis[2]) < 1 - 1e-6:
                raise ValueError(
                    f"a {type(self.states).__name__} knows no direction of the body but its axis of symmetry, so axis "
                    'must be "e3"; integrate a state with an attitude for others.'
                )
            tips = np.asarray(states.axis, float) * np.sign(axis[2])
        else:
            tips = np.asarray(so3.to_matrix(jnp.asarray(self.turning.attitudes)), float) @ axis
        return tips / np.linalg.norm(tips, axis=1, keepdims=True)

    @property
    def spatial_momenta(self) -> np.ndarray:
        """The angular momenta about the centre of mass or the fixed point, in space, (n, 3)."""
        return np.asarray(self.turning.states.spatial_momentum(), float)

    def turns_by(self, body: Body) -> np.ndarray:
        """By about how many radians the body, or its axis, turns from each time to the next, (n - 1,).

        Raises:
            ValueError: the body is not of the kind of the states.
        """
        check_body(body, self.states)
        speeds = np.linalg.norm(np.asarray(jax.vmap(body.turning.velocity)(self.turning.states.momentum)), axis=1)
        return (speeds[:-1] + speeds[1:]) / 2 * np.abs(np.diff(self.times))


def motion_of(path: Any, *, together: bool = False) -> Motion:
    """The part of a path before the run failed, without repeated times.

    Args:
        path: a `Path` or `AdaptivePath` of one body, from `integrate`, `integrate_adaptive` or `free_motion`.
        together: whether it may also be a path of coupled bodies.

    Raises:
        ValueError: the argument is not a path of one rigid body, or fewer than two of its states can be trusted.
    """
    states: Any = getattr(path, "states", None)
    if not isinstance(path, Path | AdaptivePath) or not (isinstance(states, State) and states.own_axes):
        raise ValueError(
            f"path must be a path of a rigid body with its states, got {described(path)} that holds "
            f"{described(states)}; integrate without observe=."
        )
    times = np.asarray(path.times)
    if isinstance(states, Coupled) and not together:
        raise ValueError(
            f"path must be of one body, and a {type(states).__name__} holds {states.count}; take body i by "
            "path._replace(states=path.states.of_body(i)), and its row of the body."
        )
    if times.ndim != 1 or states.momentum.shape[: -states.own_axes] != times.shape:
        raise ValueError(
            f"path must be of one body, with momenta (n, 3) at n times, got {states.momentum.shape} and times "
            f"{times.shape}; take body k of an ensemble by "
            "ml.Path(path.times, jax.tree.map(lambda x: x[k], path.states), path.ok[k], path.first_bad[k]), "
            "and integrate with save_every."
        )
    good = int(path.first_bad)
    if good < 2:
        raise ValueError(
            f"path has {good} states that can be trusted, and a picture needs 2; see path.first_bad, and take a "
            "smaller step or save more often."
        )
    keep = np.flatnonzero(np.append(True, np.diff(times[:good]) != 0))
    if len(keep) < 2:
        raise ValueError("the times of path are all the same; integrate with dt that is not zero.")
    kept = jax.tree.map(lambda leaf: leaf[keep], states)
    ok = good == len(times) and bool(path.ok)
    return Motion(times[keep], kept, "" if ok else f"FAILED after t = {times[good - 1]:.6g}")
