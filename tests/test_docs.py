"""The Python of README and docs runs as it is written, block after block, and what they name is there."""

import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

import jax
import pytest
from cases import benchmark

import midlie_jax as ml

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!http)([^)#]+)")


def name_of(page):
    """As the site names it: from docs/, where two folders may have pages of one name."""
    return page.relative_to(DOCS if page.is_relative_to(DOCS) else ROOT).as_posix()


def blocks(page):
    """Python blocks, each preceded by empty lines so that an error names the line of the page."""
    text = page.read_text()
    return ["\n" * text[: m.start(2)].count("\n") + m[2] for m in BLOCK.finditer(text) if m[1] == "python"]


def linked(page):
    """The files that a page has links to."""
    return {(page.parent / file).resolve() for file in LINK.findall(page.read_text())}


def test_readme_is_short_and_leads_to_every_page():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 90
    assert len(text.split()) <= 600
    named = linked(PAGES[0]) & set(PAGES)
    reached = named.union(*map(linked, named))
    assert [name_of(page) for page in PAGES[1:] if page.stem != "index" and page not in reached] == []


def test_the_ratios_of_readme_and_reports_are_those_measured():
    """`python benchmarks/work_precision.py --data` after a change of docs/reports/tables/work-precision*.csv."""
    harness, inverse = benchmark("harness"), benchmark("work_precision").inverse
    measured = harness.saved("work-precision-ratios")
    readme, report = (
        " ".join((ROOT / name).read_text().split()) for name in ("README.md", "docs/reports/work-precision.md")
    )
    for column, program in (("general / heyoka", "heyoka"), ("general / diffrax", "diffrax")):
        ranges = [row[column].split(" (")[0].split(" to ") for row in measured]
        least, most = min((low for low, _ in ranges), key=float), max((high for _, high in ranges), key=float)
        slowest, fastest = (f"{float(f'{1 / float(ratio):.2g}'):g}" for ratio in (most, least))
        assert f"{slowest} to {fastest} times faster than {program}" in readme
    for row in measured:
        assert f"| {row['scene']} | {' | '.join(map(inverse, list(row.values())[1:]))} |" in report
    table = (DOCS / "choosing-a-method.md").read_text().split("<!-- fastest -->\n")[1].split("<!-- /fastest -->")[0]
    fastest = benchmark("work_precision").fastest_rows()
    assert table.splitlines()[2:] == [harness.row_of(cells) for cells in fastest]
    rows = [row for scene in harness.by_scene("work-precision").values() for row in scene]
    reached = [row[f"general / {program}"] for row in rows for program in ("heyoka", "diffrax")]
    assert all(float(ratio) < 1 for ratio in reached if ratio != "-")  # the first sentence of the report
    assert {r["scene"] for r in rows if float(r["symplectic / heyoka"]) > 1} == {"asymmetric-top", "orbit"}


def test_the_tagline_is_the_same_everywhere():
    tagline = ml.__doc__.splitlines()[0].removesuffix(".")
    texts = [(ROOT / name).read_text() for name in ("README.md", "docs/index.md", "pyproject.toml", "CITATION.cff")]
    assert [tagline in text for text in texts] == [True] * 4


def tables_of(code):
    """The page and the mark of each table that a benchmark writes."""
    for constant in re.findall(r'^PAGE = (".+\.md")', code, re.MULTILINE):
        code = re.sub(r"\bPAGE,", f"{constant},", code)
    return re.findall(r'(?:Table|put)\(\s*(?:\*\(\s*)?"([\w/-]+\.md)",\s*"([\w -]+)"', code)


def test_tables_of_benchmarks_have_their_places():
    """Each has its two comments on its page, and all pairs of comments but one are those of a benchmark."""
    texts = {page.relative_to(DOCS).as_posix(): page.read_text() for page in DOCS.rglob("*.md")}
    marks = {(page, mark) for page, text in texts.items() for mark in re.findall(r"<!-- /([\w -]+) -->", text)}
    assert all(texts[page].count(f"<!-- {mark} -->\n") == 1 for page, mark in marks)
    assert all(texts[page].index(f"<!-- {mark} -->") < texts[page].index(f"<!-- /{mark} -->") for page, mark in marks)
    written = {place for path in (ROOT / "benchmarks").rglob("*.py") for place in tables_of(path.read_text())}
    written |= {(page, "measured") for page in texts if page.startswith("coming-from/")}
    claims = (ROOT / "benchmarks" / "claims.py").read_text()
    written |= {("reports/claims.md", mark) for mark in re.findall(r'"(claims \w+)"', claims)}
    written |= {("reports/work-precision.md", scene) for scene in benchmark("work_precision").SCENES}
    assert marks - written == {("how-it-compares.md", "features")}
    assert written - marks == set()


def test_data_files_are_written_by_a_benchmark_and_on_a_page():
    """Each whole table has a script that writes it, by its name, and a page that leads to it; none is empty."""
    harness = benchmark("harness")
    code = "".join(path.read_text() for path in (ROOT / "benchmarks").rglob("*.py"))
    text = "".join(path.read_text() for path in (DOCS / "reports").glob("*.md"))
    for name in sorted(path.stem for path in harness.DATA.iterdir()):
        assert f'"{name}"' in code or name.startswith("claims-")
        assert f"(tables/{name}.csv)" in text
        assert harness.saved(name)


def run_page(page):
    """Runs the blocks of a page in one namespace, in order, as a reader would copy them, in an empty folder."""
    names = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for block in blocks(page):
            exec(compile(block, page, "exec"), names)
        for name, value in names.items():
            ok = getattr(value, "ok", True)
            assert callable(ok) or bool(jax.numpy.all(ok)), f"{name}.ok is False"
    if "solution" in names:
        assert names["solution"].result == names["diffrax"].RESULTS.successful


@pytest.fixture(scope="module")
def failures():
    """What went wrong on each page, run in a process of its own: with the settings of a reader, not of the tests."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    found = subprocess.run([sys.executable, __file__], env=environment, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    return json.loads(found.stdout.splitlines()[-1])


RUN = [page for page in PAGES if blocks(page)]


@pytest.mark.sample(0)
@pytest.mark.parametrize("page", RUN, ids=name_of)
def test_python_runs_as_written(page, failures):
    """And no path or solution of theirs has failed."""
    assert failures[name_of(page)] == ""


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_files_and_commands_that_are_named_exist(page):
    text = page.read_text()
    assert [file for file in linked(page) if not file.exists()] == []
    # The files of others: in addresses, and in their programs.
    text = re.sub(r"https?://\S+|^```py\n.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    paths = re.findall(r"`?((?:benchmarks|tests|midlie_jax|docs)/[\w/]+\.(?:py|c|md|png))", text)
    assert all((ROOT / path).exists() for path in paths), paths
    named = set(re.findall(r"\b([a-z_]+\.py)\b", text))
    assert all(any(ROOT.glob(f"[bmt]*/**/{name}")) for name in named), named
    targets = set(re.findall(r"`(?:make) (\w+)", text)) | set(re.findall(r"^make (\w+)", text, re.MULTILINE))
    known = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert targets <= known, targets - known


def test_makefile_names_tests_that_exist():
    lists = re.findall(r"patsubst %,tests/test_%\.py,((?:[^)\\]|\\\n)+)\)", (ROOT / "Makefile").read_text())
    assert len(lists) == 2
    named = set(" ".join(lists).replace("\\", "").split())
    assert {name for name in named if not (ROOT / f"tests/test_{name}.py").exists()} == set()


if __name__ == "__main__":
    outcomes = {}
    for page in RUN:
        try:
            run_page(page)
            outcomes[name_of(page)] = ""
        except Exception:  # one wrong page must not hide what is wrong with the others
            outcomes[name_of(page)] = traceback.format_exc()
    print(json.dumps(outcomes))
