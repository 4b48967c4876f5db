"""The site: its pages, links of names where it is certain what they mean, notebooks as stored, formulas."""

import re

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


def test_explained_names_are_public():
    """And their pages are there, with a title."""
    entries = [entry.removeprefix("midlie_jax.") for entry in SHOWN]
    for page, begins in hooks.EXPLAINED.items():
        assert (DOCS / page).read_text().startswith("# ")
        assert [begin for begin in begins if not any(entry.startswith(begin) for entry in entries)] == []
    assert "::: midlie_jax.baths.Langevin\n\nSee [Bodies in a heat bath](heat.md)." in TOPICS["api-heat-baths.md"]


def test_formulas_become_mathml():
    pytest.importorskip("math_core")  # of the extra docs
    made = hooks.with_mathml(r'<p>A <span class="arithmatex">\(a &lt; b\)</span>, <code>$x$</code>.</p>', "heat.md")
    assert made == "<p>A <math><mi>a</mi><mo>&lt;</mo><mi>b</mi></math>, <code>$x$</code>.</p>"
    assert 'display="block"' in hooks.with_mathml('<div class="arithmatex">\\[\na\n\\]</div>', "heat.md")
    with pytest.raises(ValueError, match=r"heat\.md must have formulas in LaTeX, got"):
        hooks.with_mathml(r'<span class="arithmatex">\(\nothing\)</span>', "heat.md")
