"""The description of a store: `zarr.json` of its root, which also holds a copy of the description of every array.

A checksum seals the description, because nothing else in the store can detect a change of it. The store is read by the
copies. If the own description of an array is lost or damaged, it is written again from the copy.

Dict attributes of the root are written as JSON strings, because NetCDF has no dict attributes, and the dataset of a run
can be written to a NetCDF file without change.
"""

import json
import os
import zlib
from pathlib import Path
from typing import Any

ATTRIBUTE = "midlie_jax"  # the attribute of the root with the data for resuming
_FOLDED = "parameters", "versions", ATTRIBUTE
_FILE, _COPIES, _SEAL, _SEALED = "zarr.json", "consolidated_metadata", "seal", "sealed"
Document = dict[str, Any]


def read(path: Path) -> Document:
    """The description of a store.

    Raises:
        ValueError: the folder is not the store of a run, or its description is damaged.
    """
    try:
        document = json.loads((path / _FILE).read_text())
        document["attributes"] = unfolded(document["attributes"])
        if document["attributes"][ATTRIBUTE][_SEAL] != _checksum(document):
            raise ValueError("its checksum is wrong")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is not the store of a run, or its description {_FILE} is damaged ({type(error).__name__}: "
            f"{error}); delete the folder or choose another one."
        ) from error
    return document


def folded(attributes: Document) -> Document:
    """The attributes with dicts as JSON strings."""
    return {name: json.dumps(value) if isinstance(value, dict) else value for name, value in attributes.items()}


def unfolded(attributes: Document) -> Document:
    """The inverse of `folded`; the attributes of a store of an earlier version are unchanged."""
    texts = {name: value for name in _FOLDED if isinstance(value := attributes.get(name), str)}
    return {**attributes, **{name: json.loads(value) for name, value in texts.items()}}


def seal(path: Path) -> None:
    """Seals the description of a new store: its present attributes (more may be added later), and all copies."""
    document = json.loads((path / _FILE).read_text())
    document["attributes"] = unfolded(document["attributes"])
    document["attributes"][ATTRIBUTE][_SEALED] = sorted(document["attributes"])
    write(path, document)


def write(path: Path, document: Document) -> None:
    """Writes a description with a new seal atomically."""
    document["attributes"][ATTRIBUTE][_SEAL] = _checksum(document)
    unfinished = path.with_name(f"{path.name}.description-{os.getpid()}")  # in the store it would look like an array
    try:
        unfinished.write_text(json.dumps({**document, "attributes": folded(document["attributes"])}, indent=2))
        os.replace(unfinished, path / _FILE)
    finally:
        unfinished.unlink(missing_ok=True)


def add_copy(path: Path, document: Document, name: str) -> None:
    """Adds the copy of the description of an array."""
    document[_COPIES]["metadata"][name] = json.loads((path / name / _FILE).read_text())


def lost(path: Path, document: Document) -> list[str]:
    """The files with descriptions of arrays and groups that are unreadable or differ from their copies."""
    return [name for name, copy in _copies(document).items() if _found(path / name) != copy]


def restore(path: Path, document: Document, names: list[str]) -> None:
    for name in names:
        file = path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps(_copies(document)[name], indent=2))


def _copies(document: Document) -> dict[str, Document]:
    copies = document[_COPIES]["metadata"]
    return {f"{name}/{_FILE}": _bare(copy) for name, copy in copies.items()}


def _bare(document: Any) -> Any:
    """A description without the copies that a group may contain."""
    return {k: v for k, v in document.items() if k != _COPIES} if isinstance(document, dict) else document


def _found(file: Path) -> Any:
    try:
        return _bare(json.loads(file.read_text()))
    except (OSError, ValueError):
        return None


def _checksum(document: Document) -> int:
    attributes = document["attributes"]
    own = {name: value for name, value in attributes[ATTRIBUTE].items() if name != _SEAL}
    others = {name: attributes[name] for name in own[_SEALED] if name != ATTRIBUTE}
    text = json.dumps([own, others, _copies(document)], sort_keys=True)
    return zlib.crc32(text.encode())
