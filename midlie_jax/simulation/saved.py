"""`saved_path`: one body of a saved run as a path: .zarr or .npz of `simulate`, or .npz of `midlie run`."""

import zipfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path as File
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._lazy import classes_below
from ..drivers.path import Path
from ..model import so3
from ..model.bodies import RigidBody, SymmetricRotor, TensorBody
from ..model.free_body import FreeBody
from ..model.state import AnyState, State
from ..model.states import AxisState, Coupled, FreeAxisState, FreeState, RigidState, TravellingState
from .variables import parameter, unfolded

_KINDS = {kind.__name__: kind for kind in (AxisState, FreeState, FreeAxisState, *Coupled.__subclasses__())}
_NAMES = {"momentum": ("momentum", "momenta"), "attitude": ("attitude", "attitudes"), "times": ("time", "times")}


class Saved(NamedTuple):
    """One body of a run in a file.

    Attributes:
        body: the body.
        path: the motion computed so far; `first_bad` is the number of states if all can be trusted. The states have the
            class of the run if they have an axis, translate or are coupled; otherwise they are `RigidState`s.
        title: the title of the run in the file.
        bodies: the number of bodies in the file.

    Examples:
        >>> body, start = ml.RigidBody([5.0, 5.0, 1.0]), ml.RigidState(jnp.ones((4, 3)), jnp.eye(4))
        >>> run = ml.simulate("JACOBI[EA]", body, None, start, out="tops.npz", dt=0.01, steps=100, save_every=10)
        >>> saved = ml.simulation.saved_path("tops.npz", body=3)
        >>> saved.bodies, saved.body.moments
        (4, Array([5., 5., 1.], dtype=float64))
    """

    body: RigidBody | TensorBody | SymmetricRotor | FreeBody
    path: Path[Any]
    title: str
    bodies: int


def saved_path(file: str | File, body: int = 0) -> Saved:
    """Reads one body of a run.

    Args:
        file: a store .zarr or a file .npz of `simulate`, or a file .npz of `midlie run`.
        body: the index of the body, from 0; for coupled bodies, the index of the copy of all of them.

    Raises:
        ValueError: the file is not of such a run, is damaged, or lacks an array of the state or the body; there is no
            such body.
        ImportError: the file is a .zarr and the extra `io` is not installed.
        OSError: the file cannot be read.

    Examples:
        >>> body, start = ml.RigidBody([5.0, 5.0, 1.0]), ml.RigidState(jnp.ones((4, 3)), jnp.eye(4))
        >>> run = ml.simulate("JACOBI[EA]", body, None, start, out="tops.npz", dt=0.01, steps=100, save_every=10)
        >>> saved = ml.simulation.saved_path("tops.npz", body=3)
        >>> saved.path.states.attitude.shape
        (11, 4)
    """
    source = File(file)
    if source.suffix.lower() not in (".zarr", ".npz"):
        raise ValueError(f"{source} must be a run that ends in .zarr or .npz.")
    if not source.exists():
        raise ValueError(f"there is no {source}; write one with midlie run --out, or midlie_jax.simulate.")
    arrays = _arrays(source)
    kind: type[AnyState] = _KINDS.get(str(arrays.get("state")), RigidState)
    wanted = *kind.described(), "times"
    names = {new: old for new in wanted for old in reversed(_NAMES.get(new, (new,))) if old in arrays}
    if lacking := [new for new in wanted if new not in names]:
        raise ValueError(
            f"{source} holds no {' and no '.join(lacking)}; it must be a run of {kind.__name__}s, without observe=."
        )
    bodies = arrays[names["momentum"]].shape[0]
    if not 0 <= body < bodies:
        raise ValueError(f"body must be from 0 to {bodies - 1}, the last in {source}, got {body}.")
    values = {name: _read(source, arrays[names[name]], body) for name in kind.described()}
    times = arrays[names["times"]]
    t = _read(source, times, body if len(times.shape) > 1 else ...)
    finite = np.all([np.isfinite(value).all(axis=tuple(range(1, value.ndim))) for value in values.values()], axis=0)
    good = int(np.cumprod(finite).sum())
    bad = int(_read(source, arrays["first_bad"], body)) if "first_bad" in arrays else good
    ok = bool(arrays["ok"][body]) if "ok" in arrays else bad >= len(t)
    # An incomplete store has no numbers where nothing is computed yet, which is not a failure.
    count = good if ok else len(t)
    states = kind.unchecked(**{name: jnp.asarray(value[:count]) for name, value in values.items()})
    path = Path(jnp.asarray(t[:count]), states, jnp.asarray(ok), jnp.asarray(min(bad, good)))
    title = str(arrays["title"]) if "title" in arrays else source.name
    return Saved(_body(source, arrays, body, kind), path, title, bodies)


def states_of(file: str | File) -> AnyState:
    """The saved states of all bodies of a run of `simulate`, with leading axes (n, k), unchecked.

    Raises:
        ValueError: the file is not of such a run, is damaged, or holds no states.
        OSError: the file cannot be read.
    """
    source = File(file)
    arrays = _arrays(source)
    # Kinds of state by name, including user-defined kinds; a later class of the same name does not replace one.
    kinds = {kind.__name__: kind for kind in reversed(classes_below(State))}
    kind = kinds.get(str(arrays.get("state")))
    names = [] if kind is None else [field.name for field in fields(kind)]
    if kind is None or any(name not in arrays for name in names):
        raise ValueError(
            f"{source} holds no states; it must be a run of midlie_jax.simulate without observe=, and the module that "
            "defines a kind of state of your own must have been imported."
        )
    return kind.unchecked(**{name: jnp.asarray(_read(source, arrays[name], ...)) for name in names})


def _read(source: File, array: Any, place: Any) -> np.ndarray:
    try:
        return np.asarray(array[place])
    except Exception as error:  # reading a damaged file can raise anything
        raise ValueError(
            f"{source} is damaged ({type(error).__name__}: {error}). Find the damaged part with midlie inspect."
        ) from error


def _arrays(source: File) -> Mapping[str, Any]:
    """The arrays of a file; for a store, the arrays of its root, and the parameters in its attributes."""
    if source.suffix.lower() != ".zarr":
        try:
            with np.load(source, allow_pickle=False) as file:
                return dict(file)
        except (zipfile.BadZipFile, EOFError, ValueError) as error:
            raise ValueError(f"{source} cannot be read ({error}); it must be a run in NumPy's format .npz.") from error
    try:
        import zarr
    except ImportError as error:
        raise ImportError("a .zarr store needs Zarr: pip install 'midlie_jax[io]'.") from error
    try:
        root: Any = zarr.open_group(str(source), mode="r")
        found: dict[str, Any] = dict(root.arrays())
        said = unfolded(root.attrs.asdict())
        found |= {parameter(name): np.asarray(value) for name, value in said["parameters"].items()}
    except Exception as error:  # reading a damaged file can raise anything
        raise ValueError(f"{source} is not the store of a run ({type(error).__name__}: {error}).") from error
    return found | {"title": said.get("title", source.name), "state": said.get("state")}


def _body(source: File, arrays: Mapping[str, Any], body: int, kind: type[AnyState]) -> Any:
    def found(name: str, axes: int) -> np.ndarray | None:
        """The parameter of this body, which may be one per body or one for all."""
        name = parameter(name) if "." in name else name
        if name not in arrays:
            return None
        values = _read(source, arrays[name], ...)
        return values[body] if values.ndim > axes + (kind.own_axes == 2) else values

    def needed(what: str, name: str, axes: int) -> np.ndarray:
        if (values := found(name, axes)) is None:
            raise ValueError(f"{source} holds no {what}; write it anew with this version of midlie_jax.")
        return values

    def is_physical(moments: np.ndarray) -> bool:
        least, middle, largest = np.moveaxis(np.sort(moments), -1, 0)
        return bool(np.all(largest <= least + middle))

    def turning(own: str, rotation: type[Any]) -> RigidBody | TensorBody | SymmetricRotor:
        if issubclass(rotation, AxisState):
            return SymmetricRotor(needed("moment of inertia", f"{own}.moment", 0), found(f"{own}.along", 0))
        for name in (f"{own}.moments", "moments"):
            if (moments := found(name, 1)) is not None:
                return RigidBody(moments, physical=is_physical(moments))
        principal = needed("moments of inertia", f"{own}.principal.moments", 1)
        turn = np.asarray(so3.to_matrix(jnp.asarray(needed("moments of inertia", f"{own}.frame", 1))))
        tensor = (turn * principal[..., None, :]) @ turn.swapaxes(-1, -2)
        return TensorBody((tensor + tensor.swapaxes(-1, -2)) / 2, physical=is_physical(principal))

    if not issubclass(kind, TravellingState):
        return turning("body", kind)
    mass = needed("mass", "body.mass", 0)
    return FreeBody(turning("body.body", kind.rotation), mass)
