"""The Python of README and docs runs as it is written, block after block, and what they name is there."""

import contextlib
import os
import re
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

import jax
import jupytext
import nbformat
import pytest
from cases import benchmark

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
    rows = [row for scene in harness.by_scene("work-precision").values() for row in scene]
    reached = [row[f"general / {program}"] for row in rows for program in ("heyoka", "diffrax")]
    assert all(float(ratio) < 1 for ratio in reached if ratio != "-")  # the first sentence of the report


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


RUN = [page for page in PAGES if blocks(page)]
PARTS = 6  # of these pages; each is one group of conftest.py, so that two workers share them


@pytest.mark.sample(0)
@pytest.mark.parametrize("part", range(PARTS))
def test_python_runs_as_written(part):
    """In a process with the settings of a reader and not of the tests; no path or solution of a page has failed."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    command = [sys.executable, __file__, str(part)]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr


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


# ---- pictures, notebooks, programs beside ours ----


def test_every_picture_is_on_a_page_with_its_command_and_small():
    """`make figures` draws those of docs/; what is in the repository has less than 4 MB in all."""
    figures = benchmark("figures")
    files = {path.name for path in DOCS.rglob("*") if path.suffix in (".png", ".gif")}
    shown = {Path(name).name for page in PAGES[1:] for name, _ in figures.PICTURE.findall(page.read_text())}
    assert files
    assert files == shown == set(figures.commands())
    for command in figures.commands().values():
        program, script, *_ = command.split()
        assert program == "midlie" or (ROOT / script).is_file()
    total = sum(path.stat().st_size for folder in (DOCS, ROOT / "tests") for path in folder.rglob("*.[pg][ni][gf]"))
    total += sum(len(output.get("data", {}).get("image/png", "")) for script in SCRIPTS for output in outputs(script))
    assert total < 4e6, f"{total / 1e6:.2f} MB of pictures"


SCRIPTS = sorted((ROOT / "notebooks").glob("*.py"))
# What names the machine on which a notebook was executed, or an address in its memory.
OF_A_MACHINE = re.compile(r"/(?:home|root|work|tmp|Users|var|opt)/|site-packages|[A-Z]:\\| at 0x|ipykernel_\d")


def outputs(script):
    cells = nbformat.read(script.with_suffix(".ipynb"), 4).cells
    return [output for cell in cells if cell.cell_type == "code" for output in cell.outputs]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_notebook_is_its_script_executed_once_without_errors(script):
    """As stored; `make notebooks` executes them. Nothing in it names the machine, and the index names it."""
    notebook, source = nbformat.read(script.with_suffix(".ipynb"), 4), jupytext.read(script, fmt="py:percent")
    assert [(cell.cell_type, cell.source) for cell in notebook.cells] == [(c.cell_type, c.source) for c in source.cells]
    written = [cell for cell in notebook.cells if cell.cell_type == "code" and cell.source.strip()]
    assert [cell.execution_count for cell in written] == list(range(1, len(written) + 1))
    assert outputs(script)
    for output in outputs(script):
        assert output.output_type != "error"
        assert output.get("name") != "stderr", output.text
        data = {key: value for key, value in output.get("data", {}).items() if "image" not in key}
        text = "\n".join(map(str, [output.get("text", ""), *data.values()]))
        assert not OF_A_MACHINE.search(text), text
    assert f"({script.stem}.ipynb)" in (ROOT / "notebooks" / "README.md").read_text()


if __name__ == "__main__":
    wrong = 0
    for page in RUN[int(sys.argv[1]) :: PARTS]:
        try:
            run_page(page)
        except Exception:  # one wrong page must not hide what is wrong with the others
            wrong += 1
            print(f"{name_of(page)}: {traceback.format_exc()}", file=sys.stderr)
    sys.exit(wrong)
