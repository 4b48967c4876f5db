"""Plain words: counts of constructions that are hard to read, in the prose of the package and of the pages.

The allowed counts may only fall: where a count is lower than its number, lower the number.
"""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PATTERNS = {  # and the counts allowed in the package, and in docs and README
    "that of": (r"\bthat of\b", 3, 0),  # repeat the noun
    "those of": (r"\bthose of\b", 9, 0),
    "fronted Of": (r"\bOf\b(?= )", 1, 0),  # "For a body ..." or "If a body ..."
    "decimal without zero": (r"(?<![^\s(±-])\.\d", 1, 0),  # 0.1
    "as fast as": (r"\bas fast as\b", 0, 2),  # N times faster than
    "asks": (r"\basks\b", 1, 0),  # software requires, returns, raises
    "knows": (r"\bknows\b", 0, 1),
    "whoever or nobody": (r"\b(whoever|nobody)\b", 0, 0),
}


def strings(node):
    """The string constants below a node, without the format specifications of f-strings."""
    if isinstance(node, ast.Constant):
        if isinstance(node.value, str):
            yield node
    elif isinstance(node, ast.FormattedValue):
        yield from strings(node.value)
    else:
        for child in ast.iter_child_nodes(node):
            yield from strings(child)


def of_module(source):
    """Docstrings, other strings and comments of a module, with single spaces."""
    lines, texts = source.split("\n"), []
    for node in strings(ast.parse(source)):
        texts.append(node.value)
        if node.end_lineno > node.lineno:
            lines[node.lineno - 1 : node.end_lineno] = [""] * (node.end_lineno - node.lineno + 1)
    for line in lines:
        comment = re.search(r"(?:^\s*|  )# (.*)", line)
        texts.append(comment[1] if comment else "\n")
    return " ".join(" ".join(texts).split())


def of_page(markdown):
    """The prose of a page, without code and without what is written from docstrings, with single spaces."""
    prose = re.sub(r"^<!-- api: .*?^<!-- /api -->$", "", markdown, flags=re.MULTILINE | re.DOTALL)
    prose = re.sub(r"^( *)```.*?^\1```$|`[^`\n]*`", "", prose, flags=re.MULTILINE | re.DOTALL)
    return " ".join(prose.split())


@cache
def areas():
    package = " ".join(of_module(path.read_text()) for path in sorted(ROOT.glob("midlie_jax/**/*.py")))
    pages = [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
    return package, " ".join(of_page(page.read_text()) for page in pages)


@pytest.mark.parametrize("name", PATTERNS)
def test_plain_words_become_more_common(name):
    pattern, *most = PATTERNS[name]
    found = [len(re.findall(pattern, text)) for text in areas()]
    assert all(map(int.__le__, found, most)), (found, most)
