"""`midlie run SCENE --out run.zarr`, a run of a scene that can be resumed; and `midlie inspect`, which checks it."""

import argparse
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...methods.base import Method
from ...simulation.simulate import simulate
from ...simulation.summary import Inspection, inspect
from .. import chosen, scenes
from ..scenes import Scene
from .output import require
from .record import Record

_SHOWN = 1000  # the largest number of bodies of a store whose errors are computed and drawn: evenly spaced ones
_SCENE = ("scene", "perturbation_size", "perturbation_seed")  # attributes of a store written by `midlie run`


def long_run(options: argparse.Namespace, method: Method, scene: Scene, dt: float, steps: int, start: Any) -> None:
    """Runs the scene into a store, or resumes the run there, and prints the summary."""
    devices = jax.devices()[: options.devices] if options.devices else []
    if options.devices and len(devices) < options.devices:
        raise ValueError(f"there are {len(devices)} devices, but --devices requires {options.devices}.")
    values = (scene.name, options.size, options.seed)
    result = simulate(
        method,
        scene.body,
        scene.torque,
        start,
        out=options.out,
        dt=dt,
        steps=steps,
        save_every=options.save_every or _save_every(steps),
        torque_axes=None,  # all copies are in one field
        resume=options.resume,
        mesh=jax.make_mesh((len(devices),), ("bodies",), devices=devices) if devices else None,
        attributes={
            "title": f"{scene.name}: {scene.title}",
            "method_from": chosen.origin(options.method),
            **dict(zip(_SCENE, values, strict=True)),
        },
    )
    print(result)
    if options.plot:
        _draw(inspect(options.out), options.plot)
    else:
        print(f"look at it with: midlie inspect {options.out}")


def _save_every(steps: int) -> int:
    """The least divisor of the number of steps that divides the run into at most 100 intervals."""
    return next(steps // count for count in range(100, 0, -1) if steps % count == 0)


def inspect_run(options: argparse.Namespace) -> None:
    require("zarr")
    if options.plot:
        require("matplotlib")
    found = inspect(options.store)
    print(found)
    record = _record(found)
    if record is not None:
        shown = "all bodies" if found.bodies <= _SHOWN else f"{len(record.ok)} of {found.bodies} bodies"
        print(f"energy error, largest relative, of {shown}: {record.energy_change.in_words}")
        print(f"momentum error, largest relative, of {shown}: {record.momentum_change.in_words}")
        for change in record.travel_changes:
            print(f"{change.name} error, largest relative, of {shown}: {change.in_words}")
    if options.plot:
        _draw(found, options.plot)


def _draw(found: Inspection, path: str) -> None:
    record = _record(found)
    if record is None:
        from .store_chart import store_chart

        store_chart(found, path)
    else:
        from .run_chart import run_chart

        run_chart(record, path)
    print(f"wrote {path}")


def _record(found: Inspection) -> Record | None:
    """The run as far as it is computed, for evenly spaced bodies; None unless the store holds the states of a scene."""
    said = found.attributes
    if said.get("scene") not in scenes.scenes() or found.done == 0:
        return None
    scene = scenes.scene(said["scene"], jnp.dtype(said["dtype"]))
    import zarr

    root: Any = zarr.open_group(str(found.path), mode="r")
    names = list(scene.start.described())
    if said.get("state") != type(scene.start).__name__ or any(name not in root for name in names):
        return None
    bodies = slice(None, None, -(-found.bodies // _SHOWN))
    momenta, *others = (root[name][bodies] for name in names)
    computed = int(np.sum(~np.all(np.isnan(momenta), axis=(0, 2))))
    momenta, attitudes, *travel = (values[:, :computed] for values in (momenta, *others))
    _, size, seed = (said[name] for name in _SCENE)
    ok = found.first_bad[bodies] == found.saves
    run = said["method"], said["dt"], said["steps"], size, seed
    return Record(scene, *run, root["time"][:computed], momenta, attitudes, ok, travel=tuple(travel))
