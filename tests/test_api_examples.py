"""Every public name has an entry on the page of its topic, a docstring, and an example that prints what it says."""

import doctest
import importlib.util
import inspect
import re
from itertools import zip_longest
from pathlib import Path

import pytest

import midlie_jax as ml

DOCS = Path(__file__).resolve().parent.parent / "docs"

_spec = importlib.util.spec_from_file_location("hooks", DOCS / "hooks.py")
assert _spec
assert _spec.loader
hooks = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(hooks)

TOPICS = hooks.topics((DOCS / "api.md").read_text())
ENTRIES = {Path(page).stem: hooks.ENTRY.findall(text) for page, text in TOPICS.items()}
SHOWN = [entry for entries in ENTRIES.values() for entry in entries]
OBJECTS = [hooks.module_of(entry) for entry in SHOWN]
# The package, and what `ml` reaches besides classes and functions.
NAMES = [name for name in hooks.public_names("midlie_jax") if inspect.ismodule(getattr(ml, name))]
MODULES = ["midlie_jax", *(f"midlie_jax.{name}" for name in NAMES)]


@pytest.mark.parametrize("module", MODULES)
def test_every_public_name_has_an_entry_and_a_docstring_of_its_own_with_an_example(module):
    """The entry is under this name or, for what `ml` takes from a module that has a topic, under that of the module."""
    assert hooks.module_of(module).__doc__
    assert hooks.entries(module)
    for entry in hooks.entries(module):
        found = hooks.module_of(entry)
        assert any(found is known for known in OBJECTS), f"docs/api.md lists names by topic; it lacks {entry}"
        text = vars(found).get("__doc__") if inspect.isclass(found) else found.__doc__
        assert text, entry
        assert re.search(r"[^\s.]\.(\s|$)", inspect.cleandoc(text).split("\n\n")[0]), entry  # a sentence
        assert "\nExamples:\n    >>> " in inspect.cleandoc(text), entry


def test_pages_explain_public_names():
    shown = [entry.removeprefix("midlie_jax.") for entry in SHOWN]
    assert len(set(shown)) == len(shown) > 100
    for begins in hooks.EXPLAINED.values():
        assert [begin for begin in begins if not any(entry.startswith(begin) for entry in shown)] == []


# The example that writes the file which others read.
WRITERS = {"midlie_jax.spacecraft.attitudes": "midlie_jax.spacecraft.attitudes.write"}
ASSUMED = {}  # what every example can use: the names that the docstring of the package defines
for line in doctest.DocTestParser().get_examples(ml.__doc__):
    exec(line.source, ASSUMED)


def example(entry):
    return doctest.DocTestParser().get_doctest(hooks.module_of(entry).__doc__, dict(ASSUMED), entry, None, None)


# The first name of each page, then the second of each, and so on, so that the first of the list are of all pages.
IN_TURN = [entry for row in zip_longest(*ENTRIES.values()) for entry in row if entry]
WITH_EXAMPLE = [entry for entry in IN_TURN if example(entry).examples]


@pytest.mark.sample(0)
@pytest.mark.filterwarnings("ignore:Setting the shape on a NumPy array:DeprecationWarning")  # in ase
@pytest.mark.parametrize("entry", WITH_EXAMPLE)
def test_the_example_prints_what_it_says(entry, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    report = []
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    for each in dict.fromkeys((WRITERS.get(entry.rpartition(".")[0], entry), entry)):
        failed, _ = runner.run(example(each), out=report.append)
        assert not failed, "".join(report)
