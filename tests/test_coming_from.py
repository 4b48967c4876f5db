"""The pages docs/coming-from/: each has the same form, and both of its columns are programs with the same motion."""

import re

import coming_from as bodies
import pytest
from alone import run
from coming_from import FOLDER, MARK, PAGES, agree, columns, joined, missing, tables

NAMES = sorted(path.stem for path in FOLDER.glob("*.md"))


@pytest.mark.parametrize("name", NAMES)
def test_the_page_is_measured_and_its_columns_are_programs(name):
    text, title = (FOLDER / f"{name}.md").read_text(), PAGES[name].title
    assert text.startswith(f"# Coming from {title}\n")
    assert all(f"<th>{program}</th><th>midlie_jax</th>" in text for program in PAGES[name].heads or (title,))
    assert tables(name)
    assert f"python benchmarks/coming_from.py {name} --write" in text
    assert re.search(rf"<!-- {MARK} -->\n\| one core \| {title} \| midlie_jax \| ratio \|\n", text)


def programs(name):
    """The pairs of programs of a page, and what it allows: of its first table, and of all together or of LAMMPS."""
    yield columns(name), None
    if name == "molecular-dynamics":
        yield bodies.programs()[1], None
    elif len(tables(name)) > 1:
        yield joined(name), PAGES[name].further


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", NAMES)
def test_both_columns_give_the_same_motion(name):
    """Within the error that the page states."""
    if absent := missing(name):
        pytest.skip(f"{' and '.join(absent)} is not installed")
    for codes, within in programs(name):
        agree(name, *(run(code, PAGES[name].quantities) for code in codes), within)
