"""Names in the text of the API pages and of the site are links to their entries, where it is certain what they mean."""

import re
from types import SimpleNamespace

import pytest
from cases import benchmark
from test_api_pages import PAGES

links = benchmark("api_pages").cross_links
ENTRIES = [entry.removeprefix("midlie_jax.") for entry in links.places()]


def anchors(text):
    """Those that GitHub makes of the headings of a page."""
    found = []
    for title in re.findall(
        r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE
    ):
        slug = re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")
        number = sum(one.split("--")[0] == slug for one in found)
        found.append(f"{slug}--{number}" if number else slug)
    return {anchor.replace("--", "-") for anchor in found}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_between_the_pages_lead_somewhere(page):
    known = {other.name: anchors(other.read_text()) for other in PAGES}
    found = re.findall(r"\[`[\w.]+`\]\(([\w.-]*)#([\w-]+)\)", page.read_text())
    assert [(other, anchor) for other, anchor in found if anchor not in known[other or page.name]] == []


def test_other_pages_name_an_entry_and_do_not_link_to_it():
    """On the site its anchor is another than on GitHub. There, a name in backticks becomes a link by itself."""
    own = {place.partition("#")[2] for place in links.places().values()}
    pages = {page: page.read_text() for page in links.DOCS.rglob("*.md") if page not in PAGES}
    found = [
        (page.name, anchor)
        for page in pages
        for anchor in re.findall(r"\]\([./]*api[\w-]*\.md#([\w-]+)\)", pages[page])
    ]
    assert [(page, anchor) for page, anchor in found if anchor in own] == []


def test_there_are_links():
    text = "".join(page.read_text() for page in PAGES)
    assert "[`LieSolver`](#liesolver)" in text
    assert "[`VelocityDependent`](api-torques.md#velocitydependent)" in text
    assert "See [Bodies in a heat bath](heat.md)." in text


@pytest.mark.parametrize(
    ("name", "page", "entry"),
    [
        ("RigidBody", "heat.md", "RigidBody"),
        ("ml.torques.HeavyTop", "heat.md", "torques.HeavyTop"),
        ("midlie_jax.LieSolver", "heat.md", "diffrax.LieSolver"),  # `ml` has it from the module
        ("integrate", "heat.md", "integrate"),
        ("bands", "api-plot.md", "plot.bands"),
        ("ml.energy", "heat.md", "energy"),
        ("energy", "heat.md", None),  # also the name of an argument
        ("Moments", "heat.md", None),  # there are two
        ("Moments", "api-fitting.md", "fitting.Moments"),
        ("scipy.spatial.transform.Rotation", "heat.md", None),
    ],
)
def test_a_name_means_an_entry_or_nothing(name, page, entry):
    assert links.entry_of(name, page) == (entry and f"midlie_jax.{entry}")


def test_explained_names_are_public():
    """And their pages are there, with a title."""
    for page, begins in links.EXPLAINED.items():
        assert (links.DOCS / page).read_text().startswith("# ")
        assert [begin for begin in begins if not any(entry.startswith(begin) for entry in ENTRIES)] == []


def test_the_site_links_text_and_nothing_else():
    """Not a link, a block of code, a heading, or the name of an argument, which mkdocstrings writes bold."""
    page = SimpleNamespace(file=SimpleNamespace(src_uri="heat.md"))
    name = "<code>RigidBody</code>"
    alone = [
        f"<a href='x'>{name}</a>",
        f"<pre>{name}</pre>",
        f"<h3>{name}</h3>",
        f"<b>{name}</b>",
        "<code>RigidBodies</code>",
    ]
    assert [html for html in alone if links.on_page_content(html, page) != html] == []
    made = links.on_page_content(f"<p>A {name}.</p>", page)
    assert made == f'<p>A <autoref identifier="midlie_jax.RigidBody" optional>{name}</autoref>.</p>'


def test_the_search_finds_names():
    """The search of the site lists headings: every entry has one, with the name as its readers write it."""
    options = (links.DOCS.parent / "mkdocs.yml").read_text()
    assert "\n  - search\n" in options
    assert "show_root_heading: true" in options
    assert "show_root_full_path: false" in options
