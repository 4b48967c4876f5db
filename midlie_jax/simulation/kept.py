"""The incomplete part of a group, stored in one file `checkpoint/begun-GROUP.npz` of a store.

The file exists while a long part is computed, until the part is written. It is always replaced as a whole, and holds a
checksum of each array, like every .npz. It is therefore complete whenever the process is killed.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np

from .plan import Part
from .sink import Begun

_SEEN, _CARRIED = "seen_", "carried_"


class Kept:
    """The files of a store for incomplete parts."""

    def __init__(self, folder: Path):
        self._folder = folder

    def write(self, part: Part, begun: Begun) -> None:
        """Stores an incomplete part and replaces the previous file of its group."""
        arrays: dict[str, Any] = {"span": part.span, "steps": begun.steps, "first_bad": begun.first_bad}
        arrays |= {f"{_SEEN}{name}": values for name, values in begun.seen.items()}
        arrays |= {f"{_CARRIED}{i}": values for i, values in enumerate(begun.carried)}
        file = self._file(part.group)
        with file.with_suffix(".new").open("wb") as unfinished:
            np.savez(unfinished, **arrays)
            unfinished.flush()
            os.fsync(unfinished.fileno())
        file.with_suffix(".new").replace(file)

    def read(self, part: Part) -> Begun | None:
        """The stored incomplete part; None if there is none, or only one of an earlier part.

        Raises:
            ValueError: the file is damaged.
        """
        try:
            with self._file(part.group).open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                arrays = dict(file)
            if int(arrays["span"]) != part.span:
                return None
            seen = {name.removeprefix(_SEEN): values for name, values in arrays.items() if name.startswith(_SEEN)}
            carried = [arrays[f"{_CARRIED}{i}"] for i in range(sum(name.startswith(_CARRIED) for name in arrays))]
            return Begun(int(arrays["steps"]), seen, carried, arrays["first_bad"])
        except FileNotFoundError:
            return None
        except Exception as error:  # reading a damaged file can raise anything
            raise ValueError(f"what is kept of {part} is damaged ({type(error).__name__}: {error}).") from error

    def remove(self, group: int) -> None:
        for file in (self._file(group), self._file(group).with_suffix(".new")):
            file.unlink(missing_ok=True)

    def _file(self, group: int) -> Path:
        return self._folder / f"begun-{group}.npz"
