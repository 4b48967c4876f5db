"""The pictures of docs/: each is on a page with the command that draws it; `make figures` draws them all."""

from pathlib import Path

import pytest
from cases import benchmark

figures = benchmark("figures")
FILES = {path.name: path for path in figures.DOCS.rglob("*") if path.suffix in (".png", ".gif")}


def test_every_picture_is_on_a_page_with_its_command():
    pages = [page.read_text() for page in figures.DOCS.rglob("*.md")]
    shown = {Path(name).name for text in pages for name, _ in figures.PICTURE.findall(text)}
    assert FILES
    assert set(FILES) == shown == set(figures.commands())


def test_the_commands_are_those_of_midlie_and_of_scripts():
    for command in figures.commands().values():
        program, script, *_ = command.split()
        assert program == "midlie" or (figures.ROOT / script).is_file()


def test_a_command_is_found_in_a_block_and_between_backticks():
    page = "see `midlie scenes`\n\n```\nmidlie chart P1 --out a.png    # minutes\n```\n\n```python\nmidlie = 1\n```\n"
    assert figures.commands_in(page) == ["midlie chart P1 --out a.png", "midlie scenes"]


@pytest.mark.parametrize("below", ["<!-- drawn by: `python a.py b` -->", "Drawn by `python a.py b`.", "Text."])
def test_a_command_is_found_in_a_comment_or_a_line_below_its_picture(below):
    command = "" if below == "Text." else "python a.py b"
    assert figures.PICTURE.findall(f"![A top](top.gif)\n{below}\n") == [("top.gif", command)]
