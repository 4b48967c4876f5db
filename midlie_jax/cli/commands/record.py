"""The result of `midlie run` as NumPy arrays, for the report, the chart and the saved file."""

import csv
from typing import Any, NamedTuple

import jax
import numpy as np

from ...model.states import RigidState
from ...plot.conservation import Change, energy_change, momentum_change
from ...simulation.versions import versions
from ..scenes import Scene

MOMENTUM = ("momentum_1", "momentum_2", "momentum_3")
ATTITUDE = ("attitude_w", "attitude_x", "attitude_y", "attitude_z")
COLUMNS = ("body", "time", *MOMENTUM, *ATTITUDE, "ok")
_MOMENTUM_FRAME = "angular momentum along the principal axes of the body, about its fixed point or centre of mass"
_ATTITUDE_FRAME = "unit quaternion, scalar first, that takes components in the body frame to components in space"


class Record(NamedTuple):
    """A run of one body or many.

    Attributes:
        scene: the scene.
        method: name of the method.
        dt: step.
        steps: number of steps.
        size, seed: size and seed of the perturbations, see `scenes.perturbed`; the first body is not perturbed.
        times: times of the saved states, (n,).
        momenta: angular momenta, body frame, (bodies, n, 3).
        attitudes: unit quaternions (w, x, y, z), body to space, (bodies, n, 4).
        ok: `Path.ok` of each body, (bodies,).
        first_bad: `Path.first_bad` of each body, (bodies,), if it is known.
        method_from: MODULE:NAME for a method of the user's own, else the name of this package.
    """

    scene: Scene
    method: str
    dt: float
    steps: int
    size: float
    seed: int
    times: np.ndarray
    momenta: np.ndarray
    attitudes: np.ndarray
    ok: np.ndarray
    first_bad: np.ndarray | None = None
    method_from: str = "midlie_jax"

    @classmethod
    def of(cls, scene: Scene, method: str, dt: float, steps: int, size: float, seed: int, path: Any) -> "Record":
        """The record of a path of `integrate` with a leading axis of bodies."""
        arrays = path.times[0], path.states.momentum, path.states.attitude, path.ok, path.first_bad
        times, momenta, attitudes, ok, first_bad = map(np.asarray, arrays)
        return cls(scene, method, dt, steps, size, seed, times, momenta, attitudes, ok, first_bad)

    @property
    def states(self) -> RigidState:
        """The states, with leading axes (bodies, n), unchecked: those of a failed run may contain NaN."""
        return jax.tree.unflatten(jax.tree.structure(self.scene.start), (self.momenta, self.attitudes))

    @property
    def energy_change(self) -> Change:
        """The change of the energy of each body, (bodies, n)."""
        return energy_change(self.scene.body, self.scene.torque, self.times, self.states)

    @property
    def momentum_change(self) -> Change:
        """The change of the spatial momentum of each body, (bodies, n)."""
        return momentum_change(self.scene.torque, self.states)

    @property
    def dtype(self) -> str:
        return self.momenta.dtype.name

    @property
    def headline(self) -> str:
        """A description of the run in one line."""
        many = len(self.ok)
        bodies = f"{many} perturbed bodies" if many > 1 else "one body"
        return (
            f"{self.scene.name}: {self.scene.title}; {bodies}, {self.method}, {self.steps} steps of {self.dt:g}, "
            f"{self.dtype}"
        )


def save(record: Record, path: str) -> None:
    """Writes a .npz or .csv file, by the ending of `path`.

    The .npz contains the arrays and a full description of the run, and can be read without pickle. The .csv has a line
    for each body and time, with the columns `COLUMNS`.

    Raises:
        OSError: the file cannot be written.
    """
    (_save_csv if path.lower().endswith(".csv") else _save_npz)(record, path)


def _save_npz(record: Record, path: str) -> None:
    scene = record.scene
    parts: dict[str, Any] = {
        "times": record.times,
        "momenta": record.momenta,
        "attitudes": record.attitudes,
        "ok": record.ok,
        "moments": np.asarray(scene.body.moments),
        "scene": scene.name,
        "title": scene.title,
        "source": scene.source,
        "units": scene.units,
        "method": record.method,
        "method_from": record.method_from,
        "dt": record.dt,
        "steps": record.steps,
        "dtype": record.dtype,
        "bodies": len(record.ok),
        "perturbation_size": record.size,
        "perturbation_seed": record.seed,
        "momentum_frame": _MOMENTUM_FRAME,
        "momentum_components": MOMENTUM,
        "attitude_frame": _ATTITUDE_FRAME,
        "attitude_components": ATTITUDE,
        "version": versions()["midlie_jax"],
        "jax_version": versions()["jax"],
    }
    if record.first_bad is not None:
        parts["first_bad"] = record.first_bad
    if scene.axes is not None:
        parts["axes"] = np.asarray(scene.axes)
    with open(path, "wb") as file:  # given a name instead of an open file, NumPy may append ".npz" to the name
        np.savez(file, **parts)


def _save_csv(record: Record, path: str) -> None:
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for body, (momenta, attitudes, ok) in enumerate(zip(record.momenta, record.attitudes, record.ok, strict=True)):
            for t, momentum, attitude in zip(record.times, momenta, attitudes, strict=True):
                # A NumPy scalar prints with the fewest digits that give back the same number.
                writer.writerow([body, t, *momentum, *attitude, int(ok)])
