"""The pages docs/coming-from/: each has the same form, and both of its columns are programs with the same motion."""

import re
from functools import cache

import pytest
from laboratory.coming_from import MARK, PAGES, columns, missing, module_of, page_of, quantities, tables
from laboratory.coming_from.alone import run
from laboratory.coming_from.compare import agree

SECTIONS = ("The same run in both", "Words", "What becomes faster or more accurate", "Keep {} for", "Traps")


@cache
def outcome(name, side):
    return run(columns(name)[side], quantities(name))


@pytest.mark.parametrize("name", PAGES)
def test_the_page_has_the_form_of_all(name):
    text, title = page_of(name).read_text(), module_of(name).TITLE
    programs = getattr(module_of(name), "HEADS", (title,))
    assert text.startswith(f"# Coming from {title}\n")
    heads = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert [head for head in heads if head in [s.format(title) for s in SECTIONS]] == [
        s.format(title) for s in SECTIONS
    ]
    assert all(f"<th>{program}</th><th>midlie_jax</th>" in text for program in programs)
    assert f"python benchmarks/coming_from.py {name} --write" in text
    assert re.search(rf"<!-- {MARK} -->\n\| one core \| {title} \| midlie_jax \| ratio \|\n", text)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", PAGES)
def test_both_columns_give_the_same_motion(name):
    """Within the error that the page states."""
    if absent := missing(name):
        pytest.skip(f"{' and '.join(absent)} is not installed")
    agree(name, outcome(name, 0), outcome(name, 1))


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", [name for name in PAGES if len(tables(name)) > 1])
def test_further_columns_give_the_same_motion(name):
    """Those of a second table, which may need what stands in the first; `FURTHER` is what its page allows there."""
    if absent := missing(name):
        pytest.skip(f"{' and '.join(absent)} is not installed")
    left, right = ("\n".join(codes) for codes in zip(*tables(name), strict=True))
    within = getattr(module_of(name), "FURTHER", None)
    agree(name, run(left, quantities(name)), run(right, quantities(name)), within)
