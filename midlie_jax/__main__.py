"""`python -m midlie_jax`: the `midlie` command where its script is not on the path. See `cli/main.py`."""

import sys

from .cli.main import command

sys.exit(command())
