"""The API pages of docs/: every public name has its entry on one of them, and every one has a docstring."""

import importlib.util
import inspect
import re
from pathlib import Path

import pytest
from cases import benchmark

import midlie_jax as ml

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted((ROOT / "docs").glob("api*.md"))

_spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
assert _spec
assert _spec.loader
hooks = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(hooks)

pages = benchmark("api_pages")

# What `ml` reaches besides classes and functions.
MODULES = [name for name in hooks.public_names("midlie_jax") if inspect.ismodule(getattr(ml, name))]
NAMES = [f"midlie_jax.{module}" for module in MODULES]


def shown():
    """The dotted names that have an entry."""
    return [entry for page in PAGES for entry in hooks.ENTRY.findall(hooks.written_out(page.read_text()))]


@pytest.fixture(scope="module")
def objects():
    """What the entries of the pages stand for."""
    return [hooks.module_of(entry) for entry in shown()]


def test_there_is_something_to_show():
    assert {"torques", "observe", "distributions", "so3", "flights", "schemes", "orbits", "densities"} <= set(MODULES)
    assert len(shown()) > 100
    assert len(set(shown())) == len(shown())


@pytest.mark.parametrize("module", ["midlie_jax", *NAMES])
def test_every_public_name_has_an_entry(module, objects):
    """Under this name or, for what `ml` takes from a module that has a page, under that of the module."""
    missing = [
        entry for entry in hooks.entries(module) if not any(hooks.module_of(entry) is known for known in objects)
    ]
    assert not missing
    assert hooks.entries(module)


@pytest.mark.parametrize("module", ["midlie_jax", *NAMES])
def test_every_public_name_has_a_docstring_of_its_own(module):
    assert hooks.module_of(module).__doc__
    for entry in hooks.entries(module):
        found = hooks.module_of(entry)
        assert vars(found).get("__doc__") if inspect.isclass(found) else found.__doc__, entry


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_markdown_has_the_signatures_of_now(page):
    """Also for those who read the pages in the repository."""
    assert pages.filled(page.read_text()) == page.read_text(), "write them anew: python benchmarks/api_pages.py"


def test_every_entry_has_its_signature_and_a_sentence():
    for page in PAGES:
        text = page.read_text()
        for entry in hooks.ENTRY.findall(hooks.written_out(text)):
            name = entry.rpartition(".")[2]
            found = re.search(rf"^### {name}\n\n```py\n{name}([(.].*?)\n```\n\n(.+)$", text, re.MULTILINE | re.DOTALL)
            assert found, entry
            members = found[1].startswith(".")  # of an enumeration
            compile(f"{name}{found[1]}" if members else f"def {name}{found[1]}: ...", page.name, "exec")  # it is Python
            assert found[2].split("\n\n")[0].endswith("."), entry


def test_a_signature_is_as_the_source_has_it():
    """Of functions, of classes with an `__init__` of their own or by inheritance, and of those made of fields."""
    axis = "axes: Any, path: AnyPath[OrientedState], axis: str | int | ArrayLike = 2"
    parameters = (axis, "*", "colour: str | None = None, label: str | None = None")
    assert " ".join(pages.signature(ml.plot.axis_path).split()) == f"( {', '.join(parameters)}, ) -> np.ndarray"
    assert pages.signature(ml.Particles) == "(mass: Any)"
    assert pages.signature(ml.Checkpointed) == "(every: int | None = None)"
    assert pages.signature(ml.flights.Jacobi) == "()"
    assert pages.signature(ml.torques.Sum) == "(*terms: TorqueLike | None)"
    assert pages.signature(ml.scatter).endswith("**quantities: Any) -> dict[str, Any]")


def test_a_new_name_is_on_its_page_by_itself(monkeypatch):
    """Without a change of the page; what is no class or function of the package has no entry."""
    source = "from .a import new as new\nfrom .b import hidden\nfrom typing import Any as Any\n_private = 1\n"
    monkeypatch.setattr(hooks.inspect, "getsource", lambda module: source)
    monkeypatch.setattr(ml.plot, "new", ml.plot.bands, raising=False)
    monkeypatch.setattr(ml.plot, "Any", int, raising=False)
    assert hooks.written_out("<!-- api: midlie_jax.plot -->\n\nold\n\n<!-- /api -->") == "::: midlie_jax.plot.new"
