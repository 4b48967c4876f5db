"""The stored notebooks: each has the cells of its script, the outputs of one clean run, and small pictures.

`make notebooks` executes them; nothing is executed here.
"""

import base64
import re
from io import BytesIO
from pathlib import Path

import jupytext
import nbformat
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "notebooks"
SCRIPTS = sorted(FOLDER.glob("*.py"))
LIMIT = 180  # seconds, as of `make notebooks`
LARGEST = 4e6  # bytes of all pictures of the repository
# What names the machine on which a notebook was executed, or an address in its memory.
OF_A_MACHINE = re.compile(r"/(?:home|root|work|tmp|Users|var|opt)/|site-packages|[A-Z]:\\| at 0x|ipykernel_\d")


def stored(script):
    return nbformat.read(script.with_suffix(".ipynb"), 4)


def cells(notebook):
    return [(cell.cell_type, cell.source) for cell in notebook.cells]


def code_cells(script):
    return [cell for cell in stored(script).cells if cell.cell_type == "code"]


def pictures(script):
    """The sizes of the pictures of a notebook, as stored."""
    outputs = [output for cell in code_cells(script) for output in cell.outputs]
    return [len(output.data["image/png"]) for output in outputs if "image/png" in output.get("data", {})]


each = pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)


def test_every_notebook_has_its_script():
    assert SCRIPTS
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == {path.stem for path in SCRIPTS}


@each
def test_the_cells_are_those_of_the_script(script):
    """After a change of the script, `make notebooks-write`."""
    assert cells(stored(script)) == cells(jupytext.read(script, fmt="py:percent"))


@each
def test_the_outputs_are_of_one_run_without_errors(script):
    """No error, no warning, every cell executed once, in order; and nothing that names the machine."""
    written = [cell for cell in code_cells(script) if cell.source.strip()]
    assert [cell.execution_count for cell in written] == list(range(1, len(written) + 1))
    outputs = [output for cell in written for output in cell.outputs]
    assert outputs
    assert pictures(script)
    for output in outputs:
        assert output.output_type != "error"
        assert output.get("name") != "stderr", output.text
        data = {key: value for key, value in output.get("data", {}).items() if "image" not in key}
        text = "\n".join(map(str, [output.get("text", ""), *data.values()]))
        assert not OF_A_MACHINE.search(text), text


def test_all_pictures_are_small():
    files = [path for folder in ("docs", "docs/reports", "notebooks", "tests") for path in (ROOT / folder).iterdir()]
    files = [path for path in files if path.suffix in (".png", ".gif")]
    total = sum(path.stat().st_size for path in files) + sum(sum(pictures(script)) for script in SCRIPTS)
    assert total < LARGEST, f"{total / 1e6:.2f} MB of pictures"


@each
def test_every_picture_has_a_ground_of_its_own(script):
    """Without one, dark text would be lost on a dark page."""
    for output in (output for cell in code_cells(script) for output in cell.outputs):
        for kind in ("image/png", "image/gif"):
            if kind in output.get("data", {}):
                picture = Image.open(BytesIO(base64.b64decode(output.data[kind]))).convert("RGBA")
                assert picture.getchannel("A").getextrema() == (255, 255)


def test_the_index_has_the_seconds_of_every_notebook():
    """`python benchmarks/notebooks.py --times` puts them there: of one core, and `make notebooks` has two."""
    rows = re.findall(r"\((\S+)\.ipynb\) \| (\d+) \|", (FOLDER / "README.md").read_text())
    assert sorted(name for name, _ in rows) == [path.stem for path in SCRIPTS]
    assert all(0 < int(seconds) < 2 * LIMIT for _, seconds in rows)
