"""The site: its pages, links of names where it is certain what they mean, notebooks as stored, formulas."""

import base64
import json
import re
from types import SimpleNamespace

import pytest
from test_api_pages import ROOT, SHOWN, TOPICS, hooks

DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_every_page_is_in_the_site():
    """Also those that are made from other files."""
    nav = re.findall(r"([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    made = [*TOPICS, "notebooks/README.md", "CHANGELOG.md", *(f"notebooks/{path.stem}.md" for path in NOTEBOOKS)]
    written = [page.relative_to(DOCS).as_posix() for page in PAGES[1:]]
    assert sorted(nav) == sorted([*written, *made])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_to_the_api_lead_to_a_topic(page):
    """In the repository and on the site. On the site, a name in backticks becomes a link to its entry by itself."""
    titles = re.findall(r"^#+ (.+)$", (DOCS / "api.md").read_text(), re.MULTILINE)
    anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
    assert set(re.findall(r"\bapi\.md#([\w-]+)", page.read_text())) <= anchors


@pytest.mark.parametrize(
    ("name", "page", "entry"),
    [
        ("RigidBody", "heat.md", "RigidBody"),
        ("ml.torques.HeavyTop", "heat.md", "torques.HeavyTop"),
        ("midlie_jax.LieSolver", "heat.md", "diffrax.LieSolver"),  # `ml` has it from the module
        ("integrate", "heat.md", "integrate"),
        ("bands", "api-pictures.md", "plot.bands"),
        ("ml.energy", "heat.md", "energy"),
        ("energy", "heat.md", None),  # also the name of an argument
        ("Moments", "heat.md", None),  # there are two
        ("Moments", "api-fitting.md", "fitting.Moments"),
        ("scipy.spatial.transform.Rotation", "heat.md", None),
        ("Rotation", "coming-from/scipy.md", None),  # of SciPy
        ("RigidBody", "coming-from/scipy.md", "RigidBody"),
        ("ml.LieSolver", "coming-from/diffrax.md", "diffrax.LieSolver"),
    ],
)
def test_a_name_means_an_entry_or_nothing(name, page, entry):
    assert hooks.entry_of(name, page) == (entry and f"midlie_jax.{entry}")


def test_explained_names_are_public():
    """And their pages are there, with a title."""
    entries = [entry.removeprefix("midlie_jax.") for entry in SHOWN]
    for page, begins in hooks.EXPLAINED.items():
        assert (DOCS / page).read_text().startswith("# ")
        assert [begin for begin in begins if not any(entry.startswith(begin) for entry in entries)] == []
    assert "::: midlie_jax.torques.Langevin\n\nSee [Bodies in a heat bath](heat.md)." in TOPICS["api-torques.md"]


def test_the_site_links_text_and_nothing_else():
    """Not a link, a block of code, a heading, or the name of an argument, which mkdocstrings writes bold."""
    name = "<code>RigidBody</code>"
    alone = [
        f"<a href='x'>{name}</a>",
        f"<pre>{name}</pre>",
        f"<h3>{name}</h3>",
        f"<b>{name}</b>",
        "<code>RigidBodies</code>",
    ]
    assert [html for html in alone if hooks.with_links(html, "heat.md") != html] == []
    made = hooks.with_links(f"<p>A {name}.</p>", "heat.md")
    assert made == f'<p>A <autoref identifier="midlie_jax.RigidBody" optional>{name}</autoref>.</p>'


@pytest.mark.parametrize(
    ("page", "link", "made"),
    [
        ("heat.md", "spins.md#damping", "spins.md#damping"),
        ("heat.md", "reports/heat.md", "reports/heat.md"),
        ("heat.md", "../notebooks/rotors-in-a-bath.ipynb", "notebooks/rotors-in-a-bath.md"),
        ("heat.md", "../CHANGELOG.md", "CHANGELOG.md"),
        ("coming-from/scipy.md", "../../notebooks/README.md", "../notebooks/README.md"),
        ("notebooks/rotors-in-a-bath.md", "../docs/heat.md", "../heat.md"),
        ("notebooks/README.md", "rotors-in-a-bath.ipynb", "rotors-in-a-bath.md"),
        ("CHANGELOG.md", "docs/reports/speed.md#calls", "reports/speed.md#calls"),
        ("heat.md", "https://a.org/b/../c.md", "https://a.org/b/../c.md"),
    ],
)
def test_a_link_between_files_becomes_one_between_pages(page, link, made):
    assert hooks.relinked(f"f[0](t) and [text]({link}).", page) == f"f[0](t) and [text]({made})."


def test_a_notebook_is_shown_as_stored(tmp_path):
    path = tmp_path / "two.ipynb"
    picture = {"image/png": base64.b64encode(b"dots").decode(), "text/plain": ["<Figure>"]}
    outputs = [{"name": "stdout", "text": ["1\n", "2\n"]}, {"data": picture}, {"data": {"text/plain": ["3"]}}]
    cells = [
        {"cell_type": "markdown", "source": ["# Two\n", "\n", "Text."]},
        {"cell_type": "code", "source": ["print(1)"], "outputs": outputs},
    ]
    path.write_text(json.dumps({"cells": cells}))
    text, pictures = hooks.notebook(path)
    assert text.split("\n\n") == [
        *("# Two", "Text.", "```python\nprint(1)\n```", "``` { .text .output }\n1\n2\n```"),
        *("![](two-1.png)", "``` { .text .output }\n3\n```"),
    ]
    assert pictures == {"two-1.png": b"dots"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_output_of_the_notebooks_is_shown(path):
    outputs = [output for cell in json.loads(path.read_text())["cells"] for output in cell.get("outputs", [])]
    text, pictures = hooks.notebook(path)
    assert text.count("![](") + text.count("{ .text .output }") == len(outputs)
    assert all(f"![]({name})" in text for name in pictures)


def test_a_formula_between_lines_is_a_paragraph_and_code_stays_code():
    page = SimpleNamespace(file=SimpleNamespace(src_uri="heat.md"))
    made = hooks.on_page_markdown("Text\n$$a$$\n$$b,\nc$$\n\n```sh\n$$\necho $$\n```\n", page)
    assert made == "Text\n\n$$a$$\n\n\n$$b,\nc$$\n\n\n```sh\n$$\necho $$\n```\n"


def test_formulas_become_mathml():
    pytest.importorskip("math_core")  # of the extra docs
    made = hooks.with_mathml(r'<p>A <span class="arithmatex">\(a &lt; b\)</span>, <code>$x$</code>.</p>', "heat.md")
    assert made == "<p>A <math><mi>a</mi><mo>&lt;</mo><mi>b</mi></math>, <code>$x$</code>.</p>"
    assert 'display="block"' in hooks.with_mathml('<div class="arithmatex">\\[\na\n\\]</div>', "heat.md")
    with pytest.raises(ValueError, match=r"heat\.md must have formulas in LaTeX, got"):
        hooks.with_mathml(r'<span class="arithmatex">\(\nothing\)</span>', "heat.md")


def test_the_search_finds_names():
    """The search of the site lists headings: every entry has one, with the name as its readers write it."""
    options = (ROOT / "mkdocs.yml").read_text()
    assert "\n  - search" in options
    assert "show_root_heading: true" in options
    assert "show_root_full_path: false" in options
