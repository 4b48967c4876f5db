"""The pictures of docs/: each is on a page with the command that draws it, and that command can be run.

None is drawn here; `make figures` draws them all.
"""

import re
from pathlib import Path

import pytest
from cases import benchmark

from midlie_jax.cli.parser import read

with_pages = benchmark("figures")
choosing = benchmark("choosing")
ROOT, DOCS = with_pages.ROOT, with_pages.DOCS
COMMANDS = with_pages.commands()
FILES = {path.name: path for path in DOCS.rglob("*") if path.suffix in (".png", ".gif")}
PICTURES = sorted(FILES)


def test_every_picture_is_on_a_page_with_its_command():
    shown = {Path(name).name for page in DOCS.rglob("*.md") for name, _ in with_pages.PICTURE.findall(page.read_text())}
    assert PICTURES
    assert set(PICTURES) == shown
    assert set(PICTURES) == set(COMMANDS)


@pytest.mark.parametrize("picture", PICTURES)
def test_the_command_can_be_run(picture, monkeypatch):
    """midlie knows its options; a script is there and has the option, and its page or the script names the picture."""
    monkeypatch.chdir(ROOT)
    _, *words = with_pages.as_run(COMMANDS[picture])
    if words[:2] == ["-m", "midlie_jax"]:
        read(words[2:])
        assert FILES[picture] in [ROOT / word for word in words]
        return
    script, *options = words
    code = (ROOT / script).read_text()
    assert all(f'"{option}"' in code for option in options if option.startswith("--"))
    stem = picture.partition(".")[0]
    assert stem in code or any(re.search(rf"\b{stem.removesuffix(word)}\{{name}}\.png", code) for word in options)


def test_a_command_is_found_in_a_block_and_between_backticks():
    page = "see `midlie scenes`\n\n```\nmidlie chart P1 --out a.png    # minutes\n```\n\n```python\nmidlie = 1\n```\n"
    assert with_pages.commands_in(page) == ["midlie chart P1 --out a.png", "midlie scenes"]


@pytest.mark.parametrize("below", ["<!-- drawn by: `python a.py b` -->", "Drawn by `python a.py b`.", "Text."])
def test_a_command_is_found_in_a_comment_or_a_line_below_its_picture(below):
    command = "" if below == "Text." else "python a.py b"
    assert with_pages.PICTURE.findall(f"![A top](top.gif)\n{below}\n") == [("top.gif", command)]


def test_the_fastest_methods_are_those_of_the_measured_page():
    """`python benchmarks/choosing.py --write` after a change of docs/reports/tables/work-precision.csv."""
    text = (DOCS / "choosing-a-method.md").read_text()
    table = text.split(choosing.BEGIN)[1].split(choosing.END)[0]
    rows = [f"| {' | '.join(cells)} |" for cells in choosing.rows()]
    assert len({row.split(" | ")[0] for row in rows}) == 7  # scenes
    assert table.strip().splitlines()[2:] == rows
