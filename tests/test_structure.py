"""The structure of the package: folders are floors, imports point down, and there are no circles of imports."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from midlie_jax._lazy import ROOMS

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "midlie_jax"
# From the ground up. A folder may import those below it, and itself.
FLOORS = (
    "_lazy", "_xla", "_math", "_checks", "model", "scattering", "integrators", "drivers", "advice", "diffrax",
    "fitting", "plot", "simulation", "asteroids", "molecules", "spacecraft", "spins", "", "cli",
)  # fmt: skip


def modules() -> dict[str, Path]:
    """The modules of the package by their dotted names below it; "" is the package itself."""
    found = {}
    for path in (ROOT / PACKAGE).rglob("*.py"):
        parts = path.relative_to(ROOT / PACKAGE).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found | {"": ROOT / PACKAGE / "__init__.pyi"}  # where the package says what it shows


@cache
def statements() -> dict[str, list[ast.Import | ast.ImportFrom]]:
    """The imports of each module, anywhere in its text."""
    trees = {name: ast.walk(ast.parse(path.read_text())) for name, path in modules().items()}
    return {
        name: [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)] for name, nodes in trees.items()
    }


def imports_of(name: str, is_package: bool, known: set[str]) -> set[str]:
    """The modules of the package that a module imports."""
    found = set()
    parents = name.split(".") if is_package or not name else name.split(".")[:-1]
    for node in statements()[name]:
        if isinstance(node, ast.Import):
            found |= {a.name.partition(".")[2] for a in node.names if a.name.split(".")[0] == PACKAGE}
        if isinstance(node, ast.ImportFrom):
            module = node.module or ""
            if node.level:
                base = [p for p in parents if p][: len([p for p in parents if p]) - node.level + 1]
                module = ".".join([*base, *([module] if module else [])])
            elif module.split(".")[0] == PACKAGE:
                module = module.partition(".")[2]
            else:
                continue
            # `from a import b` imports the module a.b where there is one, else the module a.
            found |= {inner if (inner := f"{module}.{a.name}".lstrip(".")) in known else module for a in node.names}
    return found


def graph() -> dict[str, set[str]]:
    """For each module those that it imports."""
    files = modules()
    return {name: imports_of(name, path.name == "__init__.py", set(files)) - {name} for name, path in files.items()}


def floor(name: str) -> int:
    folder = name.split(".")[0] if name != "__main__" else "cli"
    return FLOORS.index(folder)


def test_every_folder_is_a_floor_and_every_import_points_down():
    """Without circles; applications, and fits and the plug-in, stand beside each other. Few import outside packages."""
    arrows = [(a, b) for a, targets in graph().items() for b in targets]
    assert not [f"{a} -> {b}" for a, b in arrows if floor(b) > floor(a)]
    TopologicalSorter(graph()).prepare()
    rooms = {name: name.split(".")[0] for name in modules()}
    assert not [(a, b) for a, b in arrows if {rooms[a], rooms[b]} <= set(ROOMS) and rooms[a] != rooms[b]]
    assert not [(a, b) for a, b in arrows if (rooms[a], rooms[b]) == ("fitting", "diffrax")]
    assert users_of("diffrax") == {"diffrax"}
    assert users_of("laboratory") | users_of("optimistix") | users_of("optax") == set()


def test_the_page_on_extending_lists_every_folder():
    page = (ROOT / "docs" / "extending.md").read_text()
    assert set(re.findall(r"^\| `(\w+)/` \|", page, re.MULTILINE)) == set(FLOORS) - {"", "_lazy"}


def test_a_run_imports_only_what_it_reads():
    """No application, though the registry finds the methods of applications by name; no state, method or torque that it
    does not have; pictures without matplotlib; each part when it is first asked for, and fits without the optimisers,
    which only a custom solver calls."""
    code = (
        "import sys, midlie_jax as ml; ml.integrate\n"
        "def loaded(*starts): return [name for name in sys.modules if name.startswith(starts)]\n"
        "print(*loaded('midlie_jax.'))\n"
        "ml.ensemble, ml.simulate, ml.stepper, ml.check, ml.recommend, ml.method('JACOBI[BM4]'), ml.observe.energy\n"
        "ml.torques.HeavyTop, ml.plot.view, ml.plot.bands\n"
        "print(*loaded('matplotlib', 'plotly', 'PIL', 'diffrax', 'optimistix', 'midlie_jax.fitting'))\n"
        "sys.modules['optax'] = sys.modules['optimistix'] = None; print(ml.fit is ml.fitting.fit)\n"
        "del sys.modules['optax'], sys.modules['optimistix']; print(ml.diffrax.LieSolver.__name__)\n"
        f"print(*loaded(*(f'midlie_jax.{{room}}' for room in {ROOMS!r})))\n"
        "print(ml.observe.Histogram(ml.observe.energy, [0.0, 1.0]).observable)"
    )
    first, early, fit, solver, rooms, observable = printed(code).split("\n")[:6]
    lazy = (
        *(
            "model.states.rigid",
            "model.torques.travel",
            "model.orbits.kepler",
            "model.baths.langevin",
            "model.densities",
        ),
        *("model.surface", "integrators.registry", "integrators.flights", "integrators.schemes"),
        *("integrators.runge_kutta", "drivers.observe.spectra"),
    )
    assert not set(first.split()) & {f"midlie_jax.{name}" for name in lazy}
    assert len(first.split()) < 85  # 80; 152 with all of them
    assert (early, fit, solver, rooms, observable) == ("", "True", "LieSolver", "", "energy")


LAZY = ["advice", "drivers/observe", "model/baths", "model/orbits", "model/states", "model/torques", *ROOMS]


@pytest.mark.parametrize("name", LAZY)
def test_no_public_name_is_also_a_module_of_the_same_package(name):
    """Python would replace the name by the module."""
    shown = re.findall(
        r"^from \.+\w[\w.]* import (\w+) as", (ROOT / PACKAGE / name / "__init__.pyi").read_text(), re.MULTILINE
    )
    assert shown
    assert not set(shown) & {path.stem for path in (ROOT / PACKAGE / name).iterdir()}


def users_of(package: str) -> set[str]:
    """The folders with a module that imports an outside package."""
    users = [
        name
        for name, nodes in statements().items()
        for node in nodes
        if (isinstance(node, ast.Import) and any(a.name.split(".")[0] == package for a in node.names))
        or (isinstance(node, ast.ImportFrom) and not node.level and (node.module or "").split(".")[0] == package)
    ]
    return {name.split(".")[0] for name in users}


def printed(code: str) -> str:
    """What a program prints in a process of its own."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout


def test_the_package_shows_the_names_of_its_stub():
    """Each is what it is in the file that the stub names, also after the folder `methods` was imported. Help of a class
    leaves out what equinox adds."""
    code = (
        "import ast, pydoc, sys, midlie_jax as ml; print('jax' in sys.modules)\n"
        "import midlie_jax.integrators.registry\n"
        "nodes = ast.parse(open(ml.__file__ + 'i').read()).body\n"
        "where = {a.asname: n.module for n in nodes if isinstance(n, ast.ImportFrom) for a in n.names}\n"
        "shown = {name: getattr(ml, name) for name in dir(ml)}\n"
        "print(set(shown) == {*where, '__version__'} == {*ml.__all__, '__version__'})\n"
        "from importlib import import_module as load\n"
        "same = [n for n, m in where.items() if m and shown[n] is getattr(load(f'midlie_jax.{m}'), n)]\n"
        "print(*sorted(set(where) - set(same)))\n"
        "text = pydoc.plain(pydoc.render_doc(ml.CoupledState))\n"
        "parts = ('__init__(self', 'from equinox', '__abstract', '__dataclass', '__hash__')\n"
        "print(*(part in text for part in parts), '__add__' in dir(ml.torques.HeavyTop), hasattr(ml, 'a.b'))"
    )
    first, second, others, third = printed(code).splitlines()
    assert (first, second) == ("False", "True")
    folders = {"advice", "diffrax", "fitting", "plot", "simulation", *ROOMS}
    assert set(others.split()) == folders
    assert third.split() == ["True", "False", "False", "False", "False", "True", "False"]


@pytest.mark.sample(0)
def test_importing_computes_nothing():
    """A program may choose the devices, or join other processes (`jax.distributed.initialize`), after its imports."""
    names = [f"{PACKAGE}.{name}" for name in modules() if name and not name.endswith("__main__")]
    code = (
        f"import importlib\nfor name in {names!r}: importlib.import_module(name)\n"
        "import jax; jax.config.update('jax_num_cpu_devices', 3); print(len(jax.devices('cpu')))"
    )
    assert printed(code).split() == ["3"]


def test_one_file_uses_what_jax_does_not_document():
    """See midlie_jax/_xla/internals.py; custom derivatives are documented."""
    private = re.compile(r"^\s*(?:from|import) jax\.(?:core|extend|interpreters|_src)\b", re.MULTILINE)
    assert [name for name, path in modules().items() if private.search(path.read_text())] == ["_xla.internals"]
