"""The file of a run: a Zarr store that xarray opens and that can be resumed, or for a small run one .npz file.

The root holds the data for readers: the variables of the run, `time`, `first_bad`, and attributes that describe the
run. The group `parts` holds the parts of a statistic for each group of bodies, which are merged at the end of the run.
Each part of the run is one chunk of each variable, and each chunk ends with its checksum (the codec crc32c of Zarr).
Every reader that decodes a changed chunk raises an error.

The folder `checkpoint` holds a file GROUP.npz for each group: its progress, from which the run continues. The file is
written after the chunks, and replaced as a whole. It is therefore complete whenever the process is killed, and chunks
that it does not count are written again by the resumed run.
"""

import os
import shutil
import warnings
import zipfile
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .plan import BODY, GROUP, SPAN, Arrays, Part, Plan
from .variables import ATTRIBUTE, Variable, Variables, folded, parameter, unfolded

CHECKPOINT = "checkpoint"
_FIRST_BAD = "first_bad"
_PARTS = "parts"  # the Zarr group with the parts of a statistic


class Memory:
    """A run in memory, written to one .npz file at its end; it cannot be resumed."""

    def __init__(self, path: Path, plan: Plan, seen: Variables, attributes: dict[str, Any]):
        self.path, self.plan, self.attributes = path, plan, attributes
        self._dims = {name: variable.dims for name, variable in seen.items()}
        self._arrays: dict[str, Any] = {name: np.empty(x.shape, x.dtype) for name, x in seen.items()}
        self._whole: dict[str, Any] = {}
        self._first_bad: Any = np.full(plan.bodies, plan.saves, np.int32)

    @contextmanager
    def writing(self) -> Generator[None]:
        """Writes the file atomically when the context is left without an error."""
        yield
        contents: dict[str, Any] = {n: value for n, value in self.attributes.items() if not isinstance(value, dict)}
        contents |= {parameter(name): value for name, value in self.attributes["parameters"].items()}
        contents |= {name: values for name, values in self._arrays.items() if self._dims[name][0] != GROUP}
        unfinished = self.path.with_name(f"{self.path.name}.new-{os.getpid()}")
        try:
            # Not by `numpy.savez`, whose own arguments have names, too. It never writes a pickle.
            with zipfile.ZipFile(unfinished, "w") as archive:
                for name, values in {**contents, **self._whole, _FIRST_BAD: self._first_bad}.items():
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                        np.lib.format.write_array(entry, np.asanyarray(values), allow_pickle=False)
            os.replace(unfinished, self.path)
        finally:
            unfinished.unlink(missing_ok=True)

    def write(self, part: Part, seen: Arrays, first_bad: np.ndarray) -> None:
        """Writes a part, which counts once the next checkpoint is kept.

        The variables in `seen` have the shape (bodies, saves, ...), or (1, saves, ...) for a statistic.
        """
        for name, values in seen.items():
            self._arrays[name][self.plan.place(part, self._dims[name])] = values
        self._first_bad[self.plan.bodies_of(part.group)] = first_bad

    def write_whole(self, values: Arrays) -> None:
        """Writes variables that do not belong to parts, such as the time."""
        self._whole |= values

    # A stopped run in memory is lost, so nothing is kept.
    def keep(self, group: int, arrays: Arrays) -> None:
        """Replaces the checkpoint of a group."""

    def checkpoint(self, group: int) -> Arrays | None:
        """The checkpoint of a group, or None; raises ValueError if it is damaged."""

    def damaged(self, group: int, spans: int) -> list[str]:
        """Names the data in the first `spans` spans of a group that are missing or cannot be read."""
        return []

    @property
    def first_bad(self) -> np.ndarray:
        return self._first_bad[:]

    def read(self, name: str) -> np.ndarray:
        return self._arrays[name][:]


class Store(Memory):
    """A run in a Zarr store: its folder, attributes, plan and identity."""

    def __init__(self, path: Path, *, read_only: bool = False):
        """Opens a store; raises ValueError if the folder is none, or its description is damaged."""
        import zarr

        self.path = path
        try:
            with zarr.config.set({"array.write_empty_chunks": True}):  # so that a missing chunk is damage
                root: Any = zarr.open_group(path, mode="r" if read_only else "r+", use_consolidated=True)
                self.attributes = unfolded(root.attrs.asdict())
                own = self.attributes[ATTRIBUTE]
                self.plan, self.identity = Plan(**own["plan"]), dict(own["identity"])
                self._arrays = {name: root[place] for name, place in own["variables"].items()}
                self._dims = {name: array.metadata.dimension_names for name, array in self._arrays.items()}
                self._whole = {name: x for name, x in root.arrays() if name not in own["variables"].values()}
                self._first_bad = self._whole.pop(_FIRST_BAD)
        except Exception as error:  # reading a damaged file can raise anything
            raise ValueError(
                f"{path} is not the store of a run, or its description zarr.json is damaged ({type(error).__name__}: "
                f"{error}); delete the folder or choose another one."
            ) from error

    @contextmanager
    def writing(self) -> Generator[None]:
        """Prevents other processes from writing to the store, until this process ends or leaves the context.

        The operating system releases the lock of a killed process; the lock file remains and is harmless.
        """
        from filelock import FileLock, Timeout

        lock = FileLock(self.path / CHECKPOINT / "lock")
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

    def write_whole(self, values: Arrays) -> None:
        for name, value in values.items():
            self._whole[name][...] = value

    def keep(self, group: int, arrays: Arrays) -> None:
        file = self._file(group)
        with file.with_suffix(".new").open("wb") as unfinished:
            np.savez(unfinished, **arrays)  # pyright: ignore[reportArgumentType]
            unfinished.flush()
            os.fsync(unfinished.fileno())
        file.with_suffix(".new").replace(file)

    def checkpoint(self, group: int) -> Arrays | None:
        file = self._file(group)
        try:
            with file.open("rb") as opened, np.load(opened, allow_pickle=False) as arrays:
                return dict(arrays)
        except FileNotFoundError:
            return None
        except Exception as error:  # reading a damaged file can raise anything
            raise ValueError(f"{file} is damaged ({type(error).__name__}: {error}). {remedy(group)}") from error

    def damaged(self, group: int, spans: int) -> list[str]:
        found = [
            f"{name} of {Part(span, group)}"
            for span in range(spans)
            for name, array in self._arrays.items()
            if not _readable(self.path, array, (group, span))
        ]
        complete = spans == self.plan.spans  # otherwise a killed process may have left it unfinished
        damaged = complete and not _readable(self.path, self._first_bad, (group,))
        return [*found, f"{_FIRST_BAD} of group {group}"] if damaged else found

    def damaged_whole(self, complete: bool) -> list[str]:
        """Names the variables that do not belong to parts and cannot be read; in a complete run, or are missing."""
        whole = self._whole.items()
        return sorted(name for name, array in whole if not _readable(self.path, array, (), missing=not complete))

    def _file(self, group: int) -> Path:
        return self.path / CHECKPOINT / f"{group}.npz"


def _readable(path: Path, array: Any, chunk: tuple[int, ...], missing: bool = False) -> bool:
    """Whether a chunk of an array can be read, and exists unless it may be missing; Zarr reads it as NaN then."""
    if not array.size:
        return True
    chunk = (*chunk, *[0] * (array.ndim - len(chunk)))
    try:
        array.blocks[chunk] if chunk else array[...]
    except Exception:  # reading a damaged file can raise anything
        return False
    return missing or (path / array.path / array.metadata.encode_chunk_key(chunk)).exists()


def remedy(group: int) -> str:
    """How a damaged group is computed again, as a sentence."""
    return f"To compute this group again, delete {CHECKPOINT}/{group}.npz and resume the run."


def create(
    path: Path, plan: Plan, identity: dict[str, str], seen: Variables, others: Variables, attributes: dict[str, Any]
) -> None:
    """Creates a store without values atomically; the parts will write `seen`. It raises OSError if it cannot write."""
    import zarr

    places = {name: f"{_PARTS}/{name}" if variable.dims[0] == GROUP else name for name, variable in seen.items()}
    own = {"plan": plan._asdict(), "identity": identity, "variables": places}
    about = {
        "long_name": "index in time of the first saved state that cannot be trusted",
        "description": f"{plan.saves} for a body whose states can all be trusted, as far as they are computed",
    }
    first_bad = Variable((BODY,), (plan.bodies,), np.dtype(np.int32), about)
    unfinished = path.with_name(f"{path.name}.new-{os.getpid()}")
    try:
        root = zarr.open_group(unfinished, mode="w-", zarr_format=3, attributes=folded({**attributes, ATTRIBUTE: own}))
        root.create_group(CHECKPOINT)
        for name, variable in seen.items():
            of_groups = variable.dims[0] == GROUP
            chunks = 1 if of_groups else plan.group, 1 if variable.dims[1] == SPAN else plan.span
            place = root.require_group(_PARTS) if of_groups else root
            _create(place, name, variable, (*chunks, *variable.shape[2:]))
        for name, variable in others.items():
            _create(root, name, variable, variable.shape)
        _create(root, _FIRST_BAD, first_bad, (plan.group,), missing=plan.saves)
        with warnings.catch_warnings():  # version 3 of the format does not specify this yet; other readers ignore it
            warnings.simplefilter("ignore", UserWarning)
            zarr.consolidate_metadata(str(unfinished))  # xarray opens the store without listing its folders
        if path.exists():
            raise ValueError(f"another run has just created {path}; choose another name.")
        os.rename(unfinished, path)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _create(group: Any, name: str, variable: Variable, chunks: tuple[int, ...], missing: int = 0) -> None:
    """An array without compression, because the last digits of a motion's numbers are practically random.

    Integers not yet written have the value `missing`, and floating-point numbers are NaN.
    """
    from zarr.codecs import Crc32cCodec

    text = variable.dtype == object
    group.create_array(
        name,
        shape=variable.shape,
        dtype="str" if text else variable.dtype,
        chunks=tuple(max(1, size) for size in chunks),
        fill_value="" if text else np.nan if np.issubdtype(variable.dtype, np.floating) else missing,
        compressors=[Crc32cCodec()],
        dimension_names=variable.dims,
        attributes=variable.attributes,
    )
