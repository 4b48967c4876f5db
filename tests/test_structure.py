"""The structure of the package: imports point down, without circles, and drivers take the same arguments.

docs/api.md has their table: `python tests/test_structure.py` prints it.
"""

import ast
import inspect
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import midlie_jax as ml
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


PROGRAM = """
import ast, pydoc, sys, midlie_jax as ml
from importlib import import_module
assert "jax" not in sys.modules

def loaded(*starts):
    return {name for name in sys.modules if name.startswith(starts)}

ml.integrate
assert not loaded(*(f"midlie_jax.{name}" for name in LAZY)), loaded("midlie_jax")
assert len(loaded("midlie_jax.")) < 85  # 80; 152 with all of them
ml.ensemble, ml.simulate, ml.stepper, ml.check, ml.recommend, ml.method("JACOBI[BM4]"), ml.observe.energy
ml.torques.HeavyTop, ml.plot.view, ml.plot.bands
assert not loaded("matplotlib", "plotly", "PIL", "diffrax", "optimistix", "midlie_jax.fitting")
sys.modules["optax"] = sys.modules["optimistix"] = None
assert ml.fit is ml.fitting.fit
del sys.modules["optax"], sys.modules["optimistix"]
assert ml.diffrax.LieSolver.__name__ == "LieSolver"
assert not loaded(*(f"midlie_jax.{room}" for room in ROOMS))
assert str(ml.observe.Histogram(ml.observe.energy, [0.0, 1.0]).observable) == "energy"

import midlie_jax.integrators.registry
nodes = ast.parse(open(ml.__file__ + "i").read()).body
where = {a.asname: n.module for n in nodes if isinstance(n, ast.ImportFrom) for a in n.names}
shown = {name: getattr(ml, name) for name in dir(ml)}
assert set(shown) == {*where, "__version__"} == {*ml.__all__, "__version__"}
same = {n for n, m in where.items() if m and shown[n] is getattr(import_module(f"midlie_jax.{m}"), n)}
assert set(where) - same == {"advice", "diffrax", "fitting", "plot", "simulation", *ROOMS}
text = pydoc.plain(pydoc.render_doc(ml.CoupledState))
assert "__init__(self" in text
assert not any(part in text for part in ("from equinox", "__abstract", "__dataclass", "__hash__"))
assert "__add__" in dir(ml.torques.HeavyTop) and not hasattr(ml, "a.b")
"""


def test_a_run_imports_only_what_it_reads_and_the_package_shows_the_names_of_its_stub():
    """No application, though the registry finds its methods; pictures without matplotlib; fits without optimisers.

    Each public name is what it is in the file that the stub names. Help of a class leaves out what equinox adds.
    """
    lazy = [
        *("model.states.rigid", "model.torques.travel", "model.orbits.kepler", "model.baths.langevin"),
        *("model.densities", "model.surface", "integrators.registry", "integrators.flights", "integrators.schemes"),
        *("integrators.runge_kutta", "drivers.observe.spectra"),
    ]
    printed(f"LAZY, ROOMS = {lazy!r}, {ROOMS!r}\n{PROGRAM}")


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
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


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


DRIVERS = {
    "integrate": ml.integrate,
    "ensemble": ml.ensemble,
    "simulate": ml.simulate,
    "integrate_variable_step": ml.integrate_variable_step,
    "check": ml.check,
    "recommend": ml.recommend,
    "free_motion": ml.free_motion,
    "fit": ml.fit,
}
FIRST = ("method", "body", "torque", "start")  # by position, in this order; all else by keyword
OWN = {"free_motion": ("times",), "fit": ("model", "guess", "measurements")}  # by position, in one driver alone
# What a driver does without being told differs where its work does: the reason.
DEFAULTS = {
    ("save_every", "integrate"): "1: a path of one body is small",
    ("save_every", "integrate_variable_step"): "1: a path of one body is small",
    ("steps", "check"): "None: as many as a trial needs",
    ("method", "fit"): "by keyword, JACOBI[EA]: most fits take it",
    ("dt", "fit"): "None: the closed form of the free motion has no step",
}


def parameters(name):
    return inspect.signature(DRIVERS[name]).parameters


def shown(parameter):
    return "required" if parameter.default is parameter.empty else f"`{parameter.default!r}`".replace("'", '"')


def table():
    """The table of docs/api.md: arguments of two drivers and more."""
    every = [key for name in DRIVERS for key in parameters(name)]
    names = [key for key in dict.fromkeys([*FIRST, *every]) if every.count(key) > 1]
    rows = [[f"`{key}`", *(shown(p[key]) if key in p else "" for p in map(parameters, DRIVERS))] for key in names]
    head = ["argument", *(f"`{name}`" for name in DRIVERS)], ["---"] * (len(DRIVERS) + 1)
    lines = ["| " + " | ".join(row) + " |" for row in (head[0], *rows)]
    return "\n".join([lines[0], "|" + "|".join(head[1]) + "|", *lines[1:]])


@pytest.mark.parametrize("name", DRIVERS)
def test_what_moves_comes_first_and_all_else_is_named(name):
    by_position = [p.name for p in parameters(name).values() if p.kind is not inspect.Parameter.KEYWORD_ONLY]
    own = OWN.get(name, ())
    assert by_position == [key for key in (*FIRST, *own) if key in by_position]
    assert set(own) <= set(by_position)
    for key in FIRST:
        assert key not in parameters(name) or key in by_position or (key, name) in DEFAULTS


def test_an_argument_has_one_default():
    every = [(key, name, shown(p)) for name in DRIVERS for key, p in parameters(name).items()]
    for key in {key for key, _, _ in every}:
        assert len({default for k, name, default in every if k == key and (key, name) not in DEFAULTS}) <= 1, key


def test_the_page_has_the_table():
    assert table() in (ROOT / "docs" / "api.md").read_text(), "python tests/test_structure.py prints the table"


if __name__ == "__main__":
    print(table())
