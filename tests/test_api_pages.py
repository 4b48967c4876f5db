"""The site: every public name has an entry with a docstring on the page of its topic; pages, links and formulas."""

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


OBJECTS = [hooks.module_of(entry) for entry in SHOWN]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


@pytest.mark.parametrize("module", ["midlie_jax", *NAMES])
def test_every_public_name_has_an_entry_and_a_docstring_of_its_own(module):
    """The entry is under this name or, for what `ml` takes from a module that has a topic, under that of the module."""
    assert hooks.module_of(module).__doc__
    assert hooks.entries(module)
    for entry in hooks.entries(module):
        found = hooks.module_of(entry)
        assert any(found is known for known in OBJECTS), f"docs/api.md lists names by topic; it lacks {entry}"
        text = vars(found).get("__doc__") if inspect.isclass(found) else found.__doc__
        assert text, entry
        assert re.search(r"[^\s.]\.(\s|$)", inspect.cleandoc(text).split("\n\n")[0]), entry  # a sentence


def test_every_page_is_in_the_site_and_explains_public_names():
    """Also those that are made from other files."""
    nav = re.findall(r"([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    notebooks = [f"notebooks/{path.stem}.md" for path in (ROOT / "notebooks").glob("*.ipynb")]
    made = [*TOPICS, "notebooks/README.md", "CHANGELOG.md", *notebooks]
    assert sorted(nav) == sorted([*(page.relative_to(DOCS).as_posix() for page in PAGES[1:]), *made])
    shown = [entry.removeprefix("midlie_jax.") for entry in SHOWN]
    assert len(set(shown)) == len(shown) > 100
    for begins in hooks.EXPLAINED.values():
        assert [begin for begin in begins if not any(entry.startswith(begin) for entry in shown)] == []


def test_links_to_the_api_lead_to_a_topic():
    titles = re.findall(r"^#+ (.+)$", (DOCS / "api.md").read_text(), re.MULTILINE)
    anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
    for page in PAGES:
        assert set(re.findall(r"\bapi\.md#([\w-]+)", page.read_text())) <= anchors, page


def test_formulas_become_mathml():
    pytest.importorskip("math_core")  # of the extra docs
    made = hooks.with_mathml(r'<p>A <span class="arithmatex">\(a &lt; b\)</span>, <code>$x$</code>.</p>', "heat.md")
    assert made == "<p>A <math><mi>a</mi><mo>&lt;</mo><mi>b</mi></math>, <code>$x$</code>.</p>"
    with pytest.raises(ValueError, match=r"heat\.md must have formulas in LaTeX, got"):
        hooks.with_mathml(r'<span class="arithmatex">\(\nothing\)</span>', "heat.md")
