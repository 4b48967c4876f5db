"""A run in a Zarr store that xarray opens, and the checks before it is resumed.

The root holds the data for readers: the variables of the run, `time`, `first_bad`, and attributes that describe the
run. The group `parts` holds the parts of a statistic for each group of bodies, which are merged at the end of the run.

The group `checkpoint` holds the data for resuming: the progress of each body at the end of the last two spans (in one
slot for even and one for odd spans), and a commit per part with the checksums of all data of the part. The commit is
written last, in one atomic operation. Data that a killed process wrote but did not commit are written again by the
resumed run. For a long part, the group also holds a file with its progress (`kept.py`).
"""

import os
import shutil
import warnings
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from . import checksums, description
from .checksums import checksum, or_none, sealed
from .description import ATTRIBUTE
from .kept import Kept
from .plan import Part, Plan
from .sink import Arrays, Begun, Sink
from .variables import BODY, COORDINATES, GROUP, SPAN, Variable

PARTS = "parts"  # the Zarr group with the parts of a statistic
_FIRST_BAD = "first_bad"


class Store(Sink):
    """A run in a Zarr store.

    Attributes:
        path: the folder.
        plan: how the run is divided into parts.
        identity: see `identity.py`.
        attributes: the attributes of the root, see `describe.py`.
    """

    def __init__(self, path: Path, *, read_only: bool = False):
        """Opens a store.

        Raises:
            ValueError: the folder is not the store of a run, or its description is damaged.
        """
        self.path = path
        self._described = description.read(path)
        self.attributes: dict[str, Any] = self._described["attributes"]
        own = self.attributes[ATTRIBUTE]
        self.plan, self.identity = Plan(**own["plan"]), dict(own["identity"])
        self._root: Any = _opened(path, "r" if read_only else "r+")
        places = dict(own["variables"])
        self._seen: list[str] = sorted(places)  # in the order of the checksums, because attributes have no order
        self._arrays = {name: self._root[places[name]] for name in self._seen}
        self._checkpoint: Any = self._root["checkpoint"]
        self._states: list[str] = sorted(own["state"])
        self._commits: Any = self._checkpoint["commit"]
        self._kept = Kept(path / "checkpoint")

    @contextmanager
    def locked(self) -> Generator[None]:
        """Prevents other processes from writing to the store, until this process ends or leaves the context.

        The operating system releases the lock of a killed process; the lock file remains and is harmless.

        Raises:
            ValueError: another process holds the lock.
        """
        from filelock import FileLock, Timeout

        lock = FileLock(self.path / "checkpoint" / "lock")
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise ValueError(
                f"another run is writing to {self.path}; wait for its end or choose another folder."
            ) from None
        try:
            yield
        finally:
            with suppress(PermissionError):  # Windows does not remove open files
                Path(lock.lock_file).unlink(missing_ok=True)  # before the release: later it may be another's file
            lock.release()

    def write(self, part: Part, seen: Arrays, state: Arrays, first_bad: np.ndarray) -> None:
        """Writes a part and commits it."""
        for name, values in seen.items():
            self._arrays[name][self._place(name, part)] = values
        bodies, slot = self.plan.bodies_of(part.group), part.span % 2
        for name, values in {**state, _FIRST_BAD: first_bad}.items():
            self._checkpoint[name][slot, bodies] = values
        self._root[_FIRST_BAD][bodies] = first_bad
        written = *(seen[name] for name in self._seen), *(state[name] for name in self._states), first_bad
        sums = [checksum(values) for values in written]
        self._commits[part.span, part.group] = sealed(sums)
        self._kept.remove(part.group)

    def keep(self, part: Part, begun: Begun) -> None:
        self._kept.write(part, begun)

    def begun(self, part: Part) -> Begun | None:
        """The stored part that is not committed, or None.

        Raises:
            ValueError: it is damaged.
        """
        return self._kept.read(part)

    def forget_begun(self, group: int) -> None:
        self._kept.remove(group)

    def state(self, part: Part) -> tuple[Arrays, np.ndarray]:
        """The states at the end of a committed part, and `first_bad` of its bodies."""
        bodies, slot = self.plan.bodies_of(part.group), part.span % 2
        state = {name: self._checkpoint[name][slot, bodies] for name in self._states}
        return state, self._checkpoint[_FIRST_BAD][slot, bodies]

    def committed(self, group: int) -> int:
        """The number of committed spans of a group without a gap, from the first."""
        return next((s for s in range(self.plan.spans) if not self._sums(Part(s, group))), self.plan.spans)

    def damage(self, group: int) -> list[str]:
        """Names the data in the committed spans of a group that are unreadable or have changed."""
        count = self.committed(group)
        later = [s for s in range(count, self.plan.spans) if self._sums(Part(s, group))]
        found = [f"the commit of {Part(count, group)}"] if later else []
        for span in range(count):
            part = Part(span, group)
            for name, expected in zip(self._seen, self._sums(part), strict=False):
                if checksums.found(lambda name=name: self._arrays[name], *self._place(name, part)) != expected:
                    found.append(f"{name} of {part}")
        return found

    def torn(self, group: int) -> list[str]:
        """Names the damaged data of a group for which no committed span must be discarded."""
        spans, bodies = self.committed(group), self.plan.bodies_of(group)
        found: list[str] = []
        if spans < self.plan.spans:
            part = Part(spans, group)
            commit = or_none(lambda: self._commits[part.span, part.group])
            if commit is None or commit.any():
                found.append(f"the commit of {part}")
        now = checksums.found(lambda: self._root[_FIRST_BAD], bodies)
        # Before the end of the run, `first_bad` may be ahead of the last commit.
        slots = [(spans - 1) % 2] if spans == self.plan.spans else [0, 1]
        then = [checksums.found(lambda: self._checkpoint[_FIRST_BAD], slot, bodies) for slot in slots]
        if not spans:
            then.append(checksum(np.full(self.plan.bodies_in(group), self.plan.saves, np.int32)))
        if now is None or (None not in then and now not in then):
            found.append(f"{_FIRST_BAD} of group {group}")
        return found

    def whole_state(self, part: Part) -> bool:
        """Whether the states at the end of a committed part are unchanged since they were written."""
        bodies, slot = self.plan.bodies_of(part.group), part.span % 2
        names = (*self._states, _FIRST_BAD)
        return self._sums_of_state(part) == [
            checksums.found(lambda name=name: self._checkpoint[name], slot, bodies) for name in names
        ]

    def given_up(self, part: Part) -> bool:
        """Whether the states at the end of a committed part are known to be lost."""
        return not any(self._sums_of_state(part))

    def give_up(self, part: Part) -> None:
        """Records in the commit of a part that the states at its end are lost."""
        sums = self._sums(part)
        self._commits[part.span, part.group] = sealed([*sums[: len(self._seen)], *([0] * (len(self._states) + 1))])

    def forget(self, group: int, spans: int) -> None:
        """Revokes the commits of a group after its first `spans` spans."""
        self._commits[spans:, group] = 0

    def first_bad(self) -> np.ndarray:
        """(bodies,); for a group in which it is damaged, the values of the last commit."""
        found = np.full(self.plan.bodies, self.plan.saves, np.int32)
        for group in range(self.plan.groups):
            bodies, slot = self.plan.bodies_of(group), (self.committed(group) - 1) % 2
            values = or_none(lambda bodies=bodies: self._root[_FIRST_BAD][bodies])
            if values is None:
                values = or_none(lambda bodies=bodies, slot=slot: self._checkpoint[_FIRST_BAD][slot, bodies])
            if values is not None:
                found[bodies] = values
        return found

    def write_first_bad(self, group: int, first_bad: np.ndarray) -> None:
        """Rewrites `first_bad`, which a killed process may have left incomplete or ahead of its last commit."""
        self._root[_FIRST_BAD][self.plan.bodies_of(group)] = first_bad

    def holds(self, name: str, values: np.ndarray) -> bool:
        """Whether a variable of the root can be read and has these values."""
        return name in self._root and checksums.found(lambda: self._root[name]) == checksum(values)

    def damaged_whole(self) -> list[str]:
        """Names the variables of the root that no part writes and that have changed."""
        whole: dict[str, int] = self.attributes[ATTRIBUTE]["whole"]
        found = {name: checksums.found(lambda name=name: self._root[name]) for name in whole}
        return [name for name, expected in whole.items() if found[name] != expected]

    def lost_descriptions(self) -> list[str]:
        """The files with descriptions of arrays that have changed."""
        return description.lost(self.path, self._described)

    def restore(self) -> list[str]:
        """Rewrites damaged descriptions of arrays and names of components; returns what was rewritten."""
        lost = self.lost_descriptions()
        description.restore(self.path, self._described, lost)
        names = [name for name in self.damaged_whole() if name in COORDINATES]
        for name in names:
            self._root[name][:] = np.array(COORDINATES[name], dtype=object)
        return lost + names

    def read(self, name: str) -> np.ndarray:
        return self._arrays[name][:]

    def add(self, variables: dict[str, tuple[Variable, np.ndarray]]) -> None:
        """Adds whole variables to the root, or overwrites them."""
        whole = self.attributes[ATTRIBUTE]["whole"]
        for name, (variable, values) in variables.items():
            if name in self._root:
                array = self._root[name]
            else:  # also if a killed process has created the array, but not described it in the root
                array = _create(self._root, name, variable, variable.shape, overwrite=True)
                description.add_copy(self.path, self._described, name)
            array[...] = values
            whole[name] = checksum(values)
        if variables:
            description.write(self.path, self._described)
            self._root = _opened(self.path, "r+")

    def _place(self, name: str, part: Part) -> tuple[slice, slice]:
        first, second, *_ = self._arrays[name].metadata.dimension_names
        return self.plan.place(part, first == GROUP, second == SPAN)

    def _sums_of_state(self, part: Part) -> list[int]:
        return self._sums(part)[len(self._seen) :]

    def _sums(self, part: Part) -> list[int]:
        """The checksums of a committed part; an empty list if the part is not committed."""
        try:
            sums = [int(x) for x in self._commits[part.span, part.group]]
        except Exception:  # a damaged commit counts as none
            return []
        return sums[:-1] if sums == sealed(sums[:-1]) else []


def create(
    path: Path,
    plan: Plan,
    identity: dict[str, str],
    seen: dict[str, Variable],
    state: dict[str, Variable],
    whole: dict[str, tuple[Variable, np.ndarray]],
    attributes: dict[str, Any],
) -> None:
    """Creates a store without parts atomically.

    Args:
        path: the folder, which must not exist.
        plan, identity: see `Store`.
        seen: the variables that the parts write.
        state: the arrays of the progress of all bodies.
        whole: variables available before the run, such as the time.
        attributes: the attributes of the root.

    Raises:
        OSError: the folder cannot be written.
    """
    import zarr

    used = {dim for variable in seen.values() for dim in variable.dims}
    coordinates = {dim: np.array(names, dtype=object) for dim, names in COORDINATES.items() if dim in used}
    described = {
        "plan": plan._asdict(),
        "identity": identity,
        "variables": {name: f"{PARTS}/{name}" if v.dims[0] == GROUP else name for name, v in seen.items()},
        "state": list(state),
        "whole": {
            **{name: checksum(values) for name, (_, values) in whole.items()},
            **{name: checksum(values) for name, values in coordinates.items()},
        },
    }
    unfinished = path.with_name(f"{path.name}.new-{os.getpid()}")
    try:
        written = description.folded({**attributes, ATTRIBUTE: described})
        root = zarr.open_group(unfinished, mode="w-", zarr_format=3, attributes=written)
        for name, variable in seen.items():
            of_groups = variable.dims[0] == GROUP
            place = root.require_group(PARTS) if of_groups else root
            times = 1 if variable.dims[1] == SPAN else plan.span
            _create(place, name, variable, (1 if of_groups else plan.group, times, *variable.shape[2:]))
        first_bad = Variable((BODY,), (plan.bodies,), np.dtype(np.int32), _first_bad_attributes(plan))
        _create(root, _FIRST_BAD, first_bad, (plan.group,), missing=plan.saves)
        for name, (variable, values) in whole.items():
            _create(root, name, variable, variable.shape)[...] = values
        for dim, names in coordinates.items():
            root.create_array(dim, shape=names.shape, dtype="str", dimension_names=(dim,))[:] = names
        checkpoint = root.create_group("checkpoint")
        for name, variable in {**state, _FIRST_BAD: first_bad}.items():
            slots = variable._replace(dims=("slot", *variable.dims), shape=(2, *variable.shape))
            _create(checkpoint, name, slots, (1, plan.group, *variable.shape[1:]))
        sums = len(seen) + len(state) + 2
        commit = Variable(("span", GROUP, "checksum"), (plan.spans, plan.groups, sums), np.dtype(np.uint32), {})
        _create(checkpoint, "commit", commit, (1, 1, sums))
        _consolidate(unfinished)
        description.seal(unfinished)
        if path.exists():
            raise ValueError(f"another run has just created {path}; choose another name.")
        os.rename(unfinished, path)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _first_bad_attributes(plan: Plan) -> dict[str, str]:
    return {
        "long_name": "index in time of the first saved state that cannot be trusted",
        "description": f"{plan.saves} for a body whose states can all be trusted, as far as they are computed",
    }


def _opened(path: Path, mode: Any) -> Any:
    """The root, whose copies of descriptions open the arrays even if their own descriptions are damaged."""
    import zarr

    return zarr.open_group(path, mode=mode, use_consolidated=True)


def _create(
    group: Any, name: str, variable: Variable, chunks: tuple[int, ...], missing: int = 0, overwrite: bool = False
) -> Any:
    """An array without compression, because the last digits of a motion's numbers are practically random.

    Integers not yet written have the value `missing`, and floating-point numbers are NaN.
    """
    return group.create_array(
        name,
        shape=variable.shape,
        dtype=variable.dtype,
        chunks=tuple(max(1, size) for size in chunks),
        fill_value=np.nan if np.issubdtype(variable.dtype, np.floating) else missing,
        compressors=None,
        dimension_names=variable.dims,
        attributes=variable.attributes,
        config={"write_empty_chunks": True},
        overwrite=overwrite,
    )


def _consolidate(path: Path) -> None:
    """Lets xarray open the store without listing its folders."""
    import zarr

    with warnings.catch_warnings():  # version 3 of the format does not specify this yet; other readers ignore it
        warnings.simplefilter("ignore", UserWarning)
        zarr.consolidate_metadata(str(path))
