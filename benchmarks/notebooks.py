"""Executes the notebooks of `notebooks/`, each from its first cell to its last, in a fresh Python.

    python benchmarks/notebooks.py [NAME ...]            executes what is stored; an error or a late end is a failure
    python benchmarks/notebooks.py --write [NAME ...]    makes the .ipynb from its script, with the outputs
    python benchmarks/notebooks.py --times [NAME ...]    also puts the seconds of each into notebooks/README.md

A notebook is written as a script in jupytext's percent format, `notebooks/NAME.py`; `notebooks/NAME.ipynb` has the same
cells and their outputs, and is never edited by hand. `tests/test_docs.py` checks that the two agree.
"""

import argparse
import base64
import re
import resource
import sys
import time
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError

from midlie_jax.cli.figures import few_colours

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
LIMIT = 180  # seconds for one notebook on two cores that do nothing else, with what it compiles
KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}


def from_script(path):
    """The notebook of a script, without outputs; the names of its cells do not vary from run to run."""
    notebook = jupytext.read(path, fmt="py:percent")
    notebook.metadata = nbformat.from_dict({"kernelspec": KERNEL})
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"
    return notebook


def shrink(notebook):
    """Makes the pictures of the outputs small, for the sake of the repository."""
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                small = few_colours(base64.b64decode(data["image/png"]))
                data["image/png"] = base64.b64encode(small).decode()


def processor_time():
    """Seconds of one core that ended children of this process have used."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def execute(notebook, limit):
    """Fills in the outputs; the seconds that this took, and those of one core."""
    began, used = time.monotonic(), processor_time()

    def left(cell):
        del cell
        return max(1, int(began + limit - time.monotonic()))

    resources = {"metadata": {"path": str(FOLDER)}}
    quiet = ["--log-level=ERROR"]
    client = {"record_timing": False, "resources": resources, "extra_arguments": quiet}
    NotebookClient(notebook, timeout_func=left, **client).execute()
    return time.monotonic() - began, processor_time() - used


def put_seconds(name, seconds):
    """Writes the seconds of a notebook into its row of notebooks/README.md, in the column after its name."""
    page = FOLDER / "README.md"
    text, count = re.subn(rf"(\({name}\.ipynb\) \|)[^|]*\|", rf"\1 {seconds:.0f} |", page.read_text())
    if count != 1:
        raise SystemExit(f"{page.name} has {count} rows of {name}.ipynb; it needs one.")
    page.write_text(text)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="notebooks, without .ipynb; by default all")
    parser.add_argument("--write", action="store_true", help="make each .ipynb from its script, with its outputs")
    parser.add_argument("--times", action="store_true", help="put the seconds of one core into notebooks/README.md")
    parser.add_argument(
        "--limit", type=float, default=LIMIT, metavar="SECONDS", help="for each; more on a busy machine"
    )
    options = parser.parse_args()
    suffix = ".py" if options.write else ".ipynb"
    known = sorted(path.stem for path in FOLDER.glob(f"*{suffix}"))
    unknown = sorted(set(options.names) - set(known))
    if unknown or not known:
        parser.error(f"no notebook {' or '.join(unknown)}; there are {', '.join(known)}.")
    failed = []
    for name in options.names or known:
        path = FOLDER / (name + suffix)
        notebook = from_script(path) if options.write else nbformat.read(path, 4)
        try:
            seconds, of_one_core = execute(notebook, options.limit)
        except (CellExecutionError, CellTimeoutError) as error:
            print(f"{path.name} failed, or took more than {options.limit} s:\n{error}", flush=True)
            failed.append(name)
            continue
        if options.write:
            shrink(notebook)
            nbformat.write(notebook, path.with_suffix(".ipynb"))
        if options.times:
            put_seconds(name, of_one_core)
        print(f"{path.name}: {seconds:.0f} s, {of_one_core:.0f} s of one core", flush=True)
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
