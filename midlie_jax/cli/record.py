"""The result of `midlie run` as NumPy arrays, for the report, the chart and the saved file."""

import csv
from itertools import chain
from typing import Any, NamedTuple

import jax
import numpy as np

from ..drivers.path import columns, named
from ..model.bodies import RigidBody
from ..model.states import AxisState, TravellingState
from ..model.torques import UniformGravity, terms_of
from ..plot.conservation import Change, changes_of
from ..plot.style import colours_of
from ..simulation.variables import parameter, versions
from .scenes import Scene

SCENE = ("scene", "perturbation_size", "perturbation_seed")  # attributes of a store written by `midlie run`
_PLURAL = {"momentum": "momenta", "attitude": "attitudes"}  # the established names of these two in such files
_FRAMES = {
    "momentum": "angular momentum along the principal axes of the body, about its fixed point or centre of mass",
    "attitude": "unit quaternion, scalar first, that takes components in the body frame to components in space",
}


class Record(NamedTuple):
    """A run of one body or many; coupled bodies have an axis (N,) before the last, and the first is of their copies."""

    scene: Scene
    method: str
    dt: float
    steps: int
    size: float  # of the perturbations, see `scenes.perturbed`; the first body is not perturbed
    seed: int
    times: np.ndarray  # of the saved states, (n,)
    momenta: np.ndarray  # body frame, (bodies, n, 3); for an axis, in space
    attitudes: np.ndarray  # unit quaternions (w, x, y, z), body to space, (bodies, n, 4); or the axes, (bodies, n, 3)
    ok: np.ndarray  # (bodies,)
    first_bad: np.ndarray | None = None  # (bodies,), if known
    method_from: str = "midlie_jax"  # MODULE:NAME for a custom method
    travel: tuple[np.ndarray, ...] = ()  # linear momenta and positions of a translating body, (bodies, n, 3) each

    @classmethod
    def of(cls, scene: Scene, method: str, dt: float, steps: int, size: float, seed: int, path: Any) -> "Record":
        momenta, attitudes, *travel = (np.asarray(leaf) for leaf in jax.tree.leaves(path.states))
        times, ok, first_bad = map(np.asarray, (path.times[0], path.ok, path.first_bad))
        run = scene, method, dt, steps, size, seed
        return cls(*run, times, momenta, attitudes, ok, first_bad, travel=tuple(travel))

    @property
    def states(self) -> Any:
        """The states, with leading axes (bodies, n), unchecked, because the states of a failed run may contain NaN."""
        return jax.tree.unflatten(jax.tree.structure(self.scene.start), (self.momenta, self.attitudes, *self.travel))

    @property
    def changes(self) -> list[Change]:
        """The changes of energy and momentum; of a translating body also of its linear momentum, and place if known."""
        scene, times, states = self.scene, self.times, self.states
        place = None
        if self.travel and not self.several:
            place = _place_change(scene.body.mass, scene.torque, times, states)
        return changes_of(scene.body, scene.torque, times, states) + ([place] if place else [])

    @property
    def errors(self) -> list[tuple[str, str]]:
        """The lines of the report on what the exact motion conserves."""
        changes = self.changes
        names = ["energy", "momentum", *(change.name for change in changes[2:])]
        return [(f"{n} error, largest relative", change.in_words) for n, change in zip(names, changes, strict=True)]

    @property
    def several(self) -> bool:
        return self.scene.start.several

    def lines(self, values: np.ndarray, most: int) -> tuple[np.ndarray, list[str]]:
        """The separate lines, and their colours: the first bodies, or all coupled bodies of the first copy."""
        if self.several:
            first = np.moveaxis(values[0], 1, 0)
            return first, colours_of(len(first))
        return values[:most], colours_of(most)

    @property
    def arrays(self) -> dict[str, tuple[np.ndarray, tuple[str, ...]]]:
        """The variables of the state by name, each with the names of its components."""
        each = zip(columns(self.scene.start).items(), (self.momenta, self.attitudes, *self.travel), strict=True)
        return {name: (array, heads) for (name, heads), array in each}

    @property
    def dtype(self) -> str:
        return self.momenta.dtype.name

    @property
    def headline(self) -> str:
        many = len(self.ok)
        bodies = f"{many} perturbed {'copies' if self.several else 'bodies'}" if many > 1 else "one body"
        if self.several:
            together = f"{self.scene.start.count} coupled bodies"
            bodies = f"{bodies} of {together}" if many > 1 else together
        return (
            f"{self.scene.name}: {self.scene.title}; {bodies}, {self.method}, {self.steps} steps of {self.dt:g}, "
            f"{self.dtype}"
        )


def save(record: Record, path: str) -> None:
    """Writes a .npz or .csv file, by the ending of `path`.

    The .npz contains the arrays and a full description of the run, and can be read without pickle. The .csv has a line
    for each body and time: body, time, the components of the state, ok. For coupled bodies: copy, time, body and so on.
    """
    (_save_csv if path.lower().endswith(".csv") else _save_npz)(record, path)


def _save_npz(record: Record, path: str) -> None:
    scene, start, body = record.scene, record.scene.start, record.scene.body
    parts: dict[str, Any] = {
        **{name: getattr(record, name) for name in ("times", "ok", "method", "method_from", "dt", "steps", "dtype")},
        **dict(zip(SCENE, (scene.name, record.size, record.seed), strict=True)),
        **{name: getattr(scene, name) for name in ("title", "source", "units")},
        "bodies": len(record.ok),
        "version": versions()["midlie_jax"],
        "jax_version": versions()["jax"],
    }
    for name, (array, heads) in record.arrays.items():
        frame = _FRAMES.get(name) or start.described()[name][1]["frame"]
        parts |= {_PLURAL.get(name, name): array, f"{name}_components": heads, f"{name}_frame": frame}
    if isinstance(start, AxisState) or record.travel:
        parts |= {"state": type(start).__name__, "momentum_frame": start.described()["momentum"][1]["frame"]}
    if isinstance(body, RigidBody):
        parts["moments"] = np.asarray(body.moments)
    else:  # the names used by `simulate`
        parts |= {parameter(name): np.asarray(leaf) for name, leaf in named({"body": body}, ".").items()}
    if record.first_bad is not None:
        parts["first_bad"] = record.first_bad
    if scene.axes is not None:
        parts["axes"] = np.asarray(scene.axes)
    with open(path, "wb") as file:  # given a name instead of an open file, NumPy may append ".npz" to the name
        np.savez(file, **parts)


def _save_csv(record: Record, path: str) -> None:
    arrays, heads = zip(*record.arrays.values(), strict=True)
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        first = ("copy", "time", "body") if record.several else ("body", "time")
        writer.writerow((*first, *chain(*heads), "ok"))
        for copy, ok in enumerate(record.ok):
            rows = np.concatenate([array[copy] for array in arrays], axis=-1)
            for t, row in zip(record.times, rows, strict=True):
                # A NumPy scalar prints with the fewest digits that reproduce the number.
                for own in enumerate(row) if record.several else [(None, row)]:
                    writer.writerow([copy, t, *(own[:1] if record.several else ()), *own[1], int(ok)])


def _place_change(mass: Any, torque: Any, times: np.ndarray, states: TravellingState) -> Change | None:
    """The distance from the parabola divided by the path length along its axes; None if the path has no closed form."""
    terms: list[Any] = terms_of(torque)
    if not all(isinstance(term, UniformGravity) for term in terms):
        return None
    x, p = (np.asarray(v, np.float64) for v in (states.position, states.linear))
    gravity = sum((np.asarray(term.acceleration, np.float64) for term in terms), start=np.zeros(3))
    t, v = np.asarray(times, np.float64)[:, None], p[..., :1, :] / float(mass)
    way, fall = v * t, gravity * t**2 / 2
    size = np.max(np.abs(way) + np.abs(fall), axis=(-2, -1))[..., None]
    error = np.linalg.norm(x - (x[..., :1, :] + way + fall), axis=-1)
    return Change(error / np.where(size > 0, size, 1), "place", "|x - x(t)| / way", "from the parabola")
