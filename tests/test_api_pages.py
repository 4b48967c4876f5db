"""The entries of the API: every public name has one on the page of its topic, and every one has a docstring."""

import importlib.util
import inspect
import re
from pathlib import Path

import pytest

import midlie_jax as ml

ROOT = Path(__file__).resolve().parent.parent

_spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
assert _spec
assert _spec.loader
hooks = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(hooks)

TOPICS = hooks.topics((ROOT / "docs" / "api.md").read_text())
ENTRIES = {Path(page).stem: hooks.ENTRY.findall(text) for page, text in TOPICS.items()}
SHOWN = [entry for entries in ENTRIES.values() for entry in entries]

# What `ml` reaches besides classes and functions.
MODULES = [name for name in hooks.public_names("midlie_jax") if inspect.ismodule(getattr(ml, name))]
NAMES = [f"midlie_jax.{module}" for module in MODULES]


@pytest.fixture(scope="module")
def objects():
    """What the entries stand for."""
    return [hooks.module_of(entry) for entry in SHOWN]


def test_there_is_something_to_show():
    assert {"torques", "observe", "distributions", "so3", "flights", "schemes", "orbits", "densities"} <= set(MODULES)
    assert len(SHOWN) > 100
    assert len(set(SHOWN)) == len(SHOWN)


@pytest.mark.parametrize("module", ["midlie_jax", *NAMES])
def test_every_public_name_has_an_entry(module, objects):
    """Under this name or, for what `ml` takes from a module that has a topic, under that of the module."""
    missing = [
        entry for entry in hooks.entries(module) if not any(hooks.module_of(entry) is known for known in objects)
    ]
    assert not missing, "docs/api.md lists names by topic"
    assert hooks.entries(module)


@pytest.mark.parametrize("module", ["midlie_jax", *NAMES])
def test_every_public_name_has_a_docstring_of_its_own(module):
    """Which begins with a sentence."""
    assert hooks.module_of(module).__doc__
    for entry in hooks.entries(module):
        found = hooks.module_of(entry)
        text = vars(found).get("__doc__") if inspect.isclass(found) else found.__doc__
        assert text, entry
        paragraph = inspect.cleandoc(text).split("\n\n")[0]
        assert re.search(r"[^\s.]\.(\s|$)", paragraph), entry


def test_a_new_name_is_on_its_page_by_itself(monkeypatch):
    """Without a change of api.md; what is no class or function of the package has no entry."""
    source = "from .a import new as new\nfrom .b import hidden\nfrom typing import Any as Any\n_private = 1\n"
    monkeypatch.setattr(hooks.inspect, "getsource", lambda module: source)
    monkeypatch.setattr(ml.plot, "new", ml.plot.bands, raising=False)
    monkeypatch.setattr(ml.plot, "Any", int, raising=False)
    made = hooks.topics("# API\n\n## Two words\n\n`ml.bands` is one.\n\n`ml.plot`\n\n## Text\n\nNone.\n")
    assert made == {"api-two-words.md": "# Two words\n\n`ml.bands` is one.\n\n::: midlie_jax.plot.new\n\n"}
