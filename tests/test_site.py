"""The site: its pages, and links of names where it is certain what they mean."""

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
