"""Counts of constructions that are hard to read, in package and pages; the allowed counts may only fall."""

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


def of_module(source):
    """Docstrings, other strings and comments of a module, without format specifications and with single spaces."""
    lines, texts, tree = source.split("\n"), [], ast.parse(source)
    specifications = [node.format_spec for node in ast.walk(tree) if isinstance(node, ast.FormattedValue)]
    left_out = {id(part) for each in specifications if each for part in ast.walk(each)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in left_out:
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
