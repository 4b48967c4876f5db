"""The name arguments of `midlie methods` and `midlie scenes`."""

import argparse

from ..readers import OWN


def names(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"only these, {what}{OWN}")
