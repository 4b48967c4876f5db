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
    assert not [f"{a} -> {b}" for a, targets in graph().items() for b in targets if floor(b) > floor(a)]


def test_the_page_on_extending_lists_every_folder():
    page = (ROOT / "docs" / "extending.md").read_text()
    assert set(re.findall(r"^\| `(\w+)/` \|", page, re.MULTILINE)) == set(FLOORS) - {"", "_lazy"}


def test_no_application_imports_another():
    rooms = {name: name.split(".")[0] for name in modules()}
    arrows = [(a, b) for a, targets in graph().items() for b in targets]
    assert not [(a, b) for a, b in arrows if {rooms[a], rooms[b]} <= set(ROOMS) and rooms[a] != rooms[b]]


def test_a_run_imports_no_application():
    """Nor does the registry of methods, which finds the methods of applications by name."""
    code = (
        "import sys, midlie_jax as ml\n"
        "ml.integrate, ml.ensemble, ml.simulate, ml.stepper, ml.fit, ml.check, ml.recommend, ml.diffrax.LieSolver\n"
        "ml.method('JACOBI[BM4]'), ml.observe.energy, ml.torques.HeavyTop\n"
        f"print([name for name in sys.modules for room in {ROOMS!r} if name.startswith(f'midlie_jax.{{room}}')])"
    )
    assert printed(code).split() == ["[]"]


def test_a_run_imports_only_the_state_the_method_and_the_torque_that_it_reads():
    code = (
        "import sys, midlie_jax as ml; ml.integrate\n"
        "print(*(name for name in sys.modules if name.startswith('midlie_jax.')))"
    )
    loaded = set(printed(code).split())
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
    assert not loaded & {f"midlie_jax.{name}" for name in lazy}
    assert len(loaded) < 85  # 80; 152 with all of them


def test_a_quantity_is_an_observable_of_the_first_statistic():
    code = "import midlie_jax as ml; print(ml.observe.Histogram(ml.observe.energy, [0.0, 1.0]).observable)"
    assert printed(code) == "energy\n"


LAZY = ["advice", "drivers/observe", "model/baths", "model/orbits", "model/states", "model/torques", *ROOMS]


@pytest.mark.parametrize("name", LAZY)
def test_no_public_name_is_also_a_module_of_the_same_package(name):
    """Python would replace the name by the module."""
    shown = re.findall(
        r"^from \.+\w[\w.]* import (\w+) as", (ROOT / PACKAGE / name / "__init__.pyi").read_text(), re.MULTILINE
    )
    assert shown
    assert not set(shown) & {path.stem for path in (ROOT / PACKAGE / name).iterdir()}


def test_no_modules_import_each_other_in_a_circle():
    TopologicalSorter(graph()).prepare()


def test_nothing_but_the_command_imports_the_command():
    assert not [name for name, targets in graph().items() if floor(name) < floor("cli") and any(
        target.split(".")[0] == "cli" for target in targets
    )]  # fmt: skip


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


def test_only_the_plug_in_imports_diffrax():
    assert users_of("diffrax") == {"diffrax"}


def test_nothing_imports_the_laboratory():
    """It stays behind when the package is installed."""
    assert users_of("laboratory") == set()


def test_nothing_imports_the_optimisers():
    """A custom solver may call them."""
    assert users_of("optimistix") | users_of("optax") == set()


@pytest.mark.sample(0)
def test_fitting_stands_beside_the_plug_in():
    assert not [name for name, targets in graph().items() if name.split(".")[0] == "fitting" and any(
        target.split(".")[0] == "diffrax" for target in targets
    )]  # fmt: skip


@pytest.mark.sample(0)
def test_all_names_are_shown_and_imported_without_the_optimisers():
    """And help(midlie_jax) and an import of all names work."""
    code = (
        "import importlib.util as u\n"
        "find = u.find_spec\n"
        "u.find_spec = lambda name, *more: None if name in ('optimistix', 'optax') else find(name, *more)\n"
        "import midlie_jax as ml\n"
        "from midlie_jax import *\n"
        "print('fit' in dir(ml), 'fitting' in ml.__all__, integrate is ml.integrate, hasattr(ml, 'a.b'))"
    )
    assert printed(code).split() == ["True", "True", "True", "False"]


def test_help_of_a_class_leaves_out_what_equinox_adds():
    code = (
        "import pydoc, midlie_jax as ml\n"
        "for kind in (ml.RigidState, ml.CoupledState, ml.FreeBody, ml.torques.HeavyTop):\n"
        "    text = pydoc.plain(pydoc.render_doc(kind))\n"
        "    parts = ('__init__(self', 'from equinox', '__abstract', '__dataclass', '__hash__')\n"
        "    print(*(part in text for part in parts))\n"
        "print('__add__' in dir(ml.torques.HeavyTop))"
    )
    assert printed(code).split() == ["True", "False", "False", "False", "False"] * 4 + ["True"]


def test_the_package_shows_the_names_of_its_stub():
    """And each is what it is in the file that the stub names, also after the folder `methods` was imported."""
    code = (
        "import ast, sys, midlie_jax as ml; print('jax' in sys.modules); import midlie_jax.integrators.registry\n"
        "nodes = ast.parse(open(ml.__file__ + 'i').read()).body\n"
        "where = {a.asname: n.module for n in nodes if isinstance(n, ast.ImportFrom) for a in n.names}\n"
        "shown = {name: getattr(ml, name) for name in dir(ml)}\n"
        "print(set(shown) == {*where, '__version__'} == {*ml.__all__, '__version__'})\n"
        "from importlib import import_module as load\n"
        "same = [n for n, m in where.items() if m and shown[n] is getattr(load(f'midlie_jax.{m}'), n)]\n"
        "print(*sorted(set(where) - set(same)))"
    )
    first, second, others = printed(code).splitlines()
    assert (first, second) == ("False", "True")
    folders = {"advice", "diffrax", "fitting", "plot", "simulation", *ROOMS}
    assert set(others.split()) == folders


@pytest.mark.sample(0)
def test_fitting_is_imported_when_it_is_first_asked_for():
    """And without optax and optimistix, which only a custom solver may need."""
    code = (
        "import sys; sys.modules['optax'] = sys.modules['optimistix'] = None; import midlie_jax as ml\n"
        "print('midlie_jax.fitting' in sys.modules, ml.fit is ml.fitting.fit, 'midlie_jax.fitting' in sys.modules)"
    )
    assert printed(code).split() == ["False", "True", "True"]


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


@pytest.mark.sample(0)
def test_diffrax_is_imported_when_a_solver_is_asked_for():
    code = (
        "import sys, midlie_jax as ml; print('diffrax' in sys.modules, 'optimistix' in sys.modules); "
        "ml.diffrax.LieSolver, ml.diffrax.LieInterpolation; print('diffrax' in sys.modules)"
    )
    assert printed(code).split() == ["False", "False", "True"]
