"""A small run in memory, written to one .npz file at its end; it cannot be resumed."""

import os
import zipfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from .plan import GROUP, Arrays, Part, Plan
from .variables import Variables, parameter


class Memory:
    """Collects the parts of a run in memory, with the methods of `Store`."""

    def __init__(self, path: Path, plan: Plan, seen: Variables, attributes: dict[str, Any]):
        self.path, self.plan = path, plan
        self._seen, self._attributes = seen, attributes
        self._arrays = {name: np.empty(variable.shape, variable.dtype) for name, variable in seen.items()}
        self._whole: Arrays = {}
        self.first_bad = np.full(plan.bodies, plan.saves, np.int32)

    @contextmanager
    def writing(self) -> Generator[None]:
        """Writes the file atomically when the context is left without an error."""
        yield
        said, seen = self._attributes, self._seen
        contents: dict[str, Any] = {name: value for name, value in said.items() if not isinstance(value, dict)}
        contents |= {parameter(name): value for name, value in said["parameters"].items()}
        contents |= {name: values for name, values in self._arrays.items() if seen[name].dims[0] != GROUP}
        unfinished = self.path.with_name(f"{self.path.name}.new-{os.getpid()}")
        try:
            # Not by `numpy.savez`, whose own arguments have names, too. It never writes a pickle.
            with zipfile.ZipFile(unfinished, "w") as archive:
                for name, values in {**contents, **self._whole, "first_bad": self.first_bad}.items():
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                        np.lib.format.write_array(entry, np.asanyarray(values), allow_pickle=False)
            os.replace(unfinished, self.path)
        finally:
            unfinished.unlink(missing_ok=True)

    def write(self, part: Part, seen: Arrays, first_bad: np.ndarray) -> None:
        for name, values in seen.items():
            self._arrays[name][self.plan.place(part, self._seen[name].dims)] = values
        self.first_bad[self.plan.bodies_of(part.group)] = first_bad

    def write_whole(self, values: Arrays) -> None:
        self._whole |= values

    def keep(self, group: int, arrays: Arrays) -> None:
        """Does nothing, because a stopped run in memory is lost."""

    def checkpoint(self, group: int) -> None:
        """Nothing is kept."""

    def damaged(self, group: int, spans: int) -> list[str]:
        return []

    def read(self, name: str) -> np.ndarray:
        return self._arrays[name]
