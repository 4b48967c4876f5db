"""The pages docs/coming-from/*.md: both columns are run as they stand, compared and measured.

    python benchmarks/coming_from.py NAME [--write]     the measured table of docs/coming-from/NAME.md

Times are processor times on one core, in processes of their own. A ratio above 1 is in favour of midlie_jax.
"""

import argparse

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

from laboratory.coming_from import BEGIN, END, PAGES, missing, module_of  # noqa: E402
from pages import put, shown  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=PAGES)
    parser.add_argument("--write", action="store_true", help="put the table into the page")
    options = parser.parse_args()
    if absent := missing(options.name):
        parser.error(f"the left column needs {' and '.join(absent)}, which is not installed.")
    module = module_of(options.name)
    heads = "one core", module.TITLE, "midlie_jax", "ratio"
    lines = shown(heads, module.rows())
    if options.write:
        put(f"coming-from/{options.name}.md", BEGIN, END, lines)


if __name__ == "__main__":
    main()
