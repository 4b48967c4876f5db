"""A small run in memory, written to one .npz file at its end; it cannot be resumed."""

import os
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from .names import parameter
from .plan import Part, Plan
from .sink import Arrays, Begun, Sink
from .variables import GROUP, SPAN, Variable


class Memory(Sink):
    """Collects the parts of a run in memory.

    Attributes:
        plan: how the run is cut into parts.
    """

    def __init__(self, plan: Plan, seen: dict[str, Variable]):
        self.plan = plan
        self._arrays = {name: np.empty(variable.shape, variable.dtype) for name, variable in seen.items()}
        self._of_groups = {name for name, variable in seen.items() if variable.dims[0] == GROUP}
        self._of_spans = {name for name, variable in seen.items() if variable.dims[1] == SPAN}
        self._first_bad = np.full(plan.bodies, plan.saves, np.int32)

    def write(self, part: Part, seen: Arrays, state: Arrays, first_bad: np.ndarray) -> None:
        for name, values in seen.items():
            self._arrays[name][self.plan.place(part, name in self._of_groups, name in self._of_spans)] = values
        self._first_bad[self.plan.bodies_of(part.group)] = first_bad

    def keep(self, part: Part, begun: Begun) -> None:
        """Does nothing, because a stopped run in memory is lost."""

    def first_bad(self) -> np.ndarray:
        return self._first_bad

    def read(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def save(self, path: Path, whole: dict[str, np.ndarray], attributes: dict[str, Any]) -> None:
        """Writes the file atomically."""
        unfinished = path.with_name(f"{path.name}.new-{os.getpid()}")
        arrays = {name: values for name, values in self._arrays.items() if name not in self._of_groups}
        described = {name: np.asarray(value) for name, value in attributes.items() if not isinstance(value, dict)}
        shared = {parameter(name): np.asarray(value) for name, value in attributes.get("parameters", {}).items()}
        contents: dict[str, Any] = {**described, **shared, **arrays, **whole, "first_bad": self._first_bad}
        try:
            with open(unfinished, "wb") as file:  # for a file name, NumPy may append ".npz"
                _save(file, contents)
            os.replace(unfinished, path)
        finally:
            unfinished.unlink(missing_ok=True)


def _save(file: IO[bytes], arrays: dict[str, Any]) -> None:
    """`numpy.savez` for arrays of any names, including the names of its own arguments; it never writes a pickle."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asanyarray(values), allow_pickle=False)
