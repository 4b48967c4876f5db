"""The pages docs/coming-from/*.md: both columns are run as they stand, compared and measured.

    python benchmarks/coming_from.py NAME [--write]     the measured table of docs/coming-from/NAME.md

Times are processor times on one core, in separate processes. A ratio above 1 favours midlie_jax.
"""

import sys
from functools import partial
from typing import Any

import one_core  # noqa: F401
from harness import Table, main
from laboratory.coming_from import MARK, PAGES, missing


def measure(name: str, options: Any) -> None:
    if absent := missing(name):
        sys.exit(f"the left column needs {' and '.join(absent)}, which is not installed.")
    page = PAGES[name]
    heads = "one core", page.title, "midlie_jax", "ratio"
    Table(f"coming-from/{name}.md", MARK, heads, page.rows).show(options.write)


if __name__ == "__main__":
    main(__doc__, {name: partial(measure, name) for name in sorted(PAGES)})
