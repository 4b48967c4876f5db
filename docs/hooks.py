"""What mkdocs does before it renders a page: it writes out the names of the API pages.

What stands between `<!-- api: midlie_jax.torques -->` and `<!-- /api -->` becomes an entry for each public name of that
module, with all that its docstring says. The marker may also list single names, as in
`<!-- api: midlie_jax.energy, midlie_jax.kinetic_energy -->`. In the Markdown of the repository signatures, first
sentences and examples stand there, which `benchmarks/api_pages.py` writes. `tests/test_api_pages.py` calls the same
functions.
"""

import ast
import inspect
import re
import sys
from functools import reduce
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

MARKED = re.compile(r"^<!-- api: ([\w., ]+) -->$.*?^<!-- /api -->$", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"^::: ([\w.]+)$", re.MULTILINE)


def module_of(name: str) -> ModuleType:
    """The module that users reach by this name, such as midlie_jax.torques, wherever its file is."""
    package, *rest = name.split(".")
    return reduce(getattr, rest, import_module(package))


def public_names(name: str) -> list[str]:
    """The public names of a module, in the order of its source.

    They are what it defines without an underscore, and what it imports as `X as X`, the mark of a name for others. The
    package itself has them in a stub.
    """
    module = module_of(name)
    stub = Path(inspect.getfile(module)).with_suffix(".pyi")
    names = []
    for node in ast.parse(stub.read_text() if stub.exists() else inspect.getsource(module)).body:
        if isinstance(node, (ast.ImportFrom, ast.Import)):
            names += [alias.name for alias in node.names if alias.asname == alias.name]
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.append(node.name)
    return [found for found in dict.fromkeys(names) if not found.startswith("_")]


def entries(name: str) -> list[str]:
    """The public names of a module that have an entry of their own, as dotted names: its classes and functions."""
    module = module_of(name)
    found = {public: getattr(module, public) for public in public_names(name)}
    return [f"{name}.{public}" for public, value in found.items() if _has_entry(value)]


def _has_entry(value: Any) -> bool:
    """Modules have pages instead, and the names of types and tables have no docstrings."""
    ours = getattr(value, "__module__", "").startswith("midlie_jax")
    return callable(value) and not isinstance(value, ModuleType) and ours


def entries_of(marker: str) -> list[str]:
    """The dotted names that a marker stands for: those of modules, and single ones."""
    names = [name.strip() for name in marker.split(",")]
    modules = {name: isinstance(module_of(name), ModuleType) for name in names}
    return [entry for name in names for entry in (entries(name) if modules[name] else [name])]


def written_out(markdown: str) -> str:
    """The page with an entry for each public name in the place of what the markers enclose."""
    return MARKED.sub(lambda found: "\n\n".join(f"::: {entry}" for entry in entries_of(found[1])), markdown)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs for every page."""
    root = str(Path(__file__).resolve().parent.parent)
    if root not in sys.path:  # these sources, whatever is installed
        sys.path.insert(0, root)
    return written_out(markdown)
