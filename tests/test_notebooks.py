"""The stored notebooks: each has the cells of its script, the outputs of one clean run, and small pictures.

`make notebooks` executes them; nothing is executed here.
"""

import re
from pathlib import Path

import jupytext
import nbformat
import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "notebooks"
SCRIPTS = sorted(FOLDER.glob("*.py"))
LARGEST = 4e6  # bytes of all pictures of the repository
# What names the machine on which a notebook was executed, or an address in its memory.
OF_A_MACHINE = re.compile(r"/(?:home|root|work|tmp|Users|var|opt)/|site-packages|[A-Z]:\\| at 0x|ipykernel_\d")


def stored(script):
    return nbformat.read(script.with_suffix(".ipynb"), 4)


def outputs(script):
    return [output for cell in stored(script).cells if cell.cell_type == "code" for output in cell.outputs]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_notebook_is_its_script_executed_once_without_errors(script):
    """No error, no warning, every cell executed once, in order; and nothing that names the machine."""
    notebook, source = stored(script), jupytext.read(script, fmt="py:percent")
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


def test_pictures_are_small_and_the_index_names_every_notebook():
    """`python benchmarks/notebooks.py --times` puts the seconds there."""
    files = [path for folder in ("docs", "docs/reports", "notebooks", "tests") for path in (ROOT / folder).iterdir()]
    total = sum(path.stat().st_size for path in files if path.suffix in (".png", ".gif"))
    total += sum(len(output.get("data", {}).get("image/png", "")) for script in SCRIPTS for output in outputs(script))
    assert total < LARGEST, f"{total / 1e6:.2f} MB of pictures"
    rows = re.findall(r"\((\S+)\.ipynb\) \| (\d+) \|", (FOLDER / "README.md").read_text())
    assert sorted(name for name, _ in rows) == [path.stem for path in SCRIPTS]
