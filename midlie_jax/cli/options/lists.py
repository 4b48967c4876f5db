"""The names that `midlie methods` and `midlie scenes` take."""

import argparse

from ..readers import OWN


def names(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"only these, {what}{OWN}")
