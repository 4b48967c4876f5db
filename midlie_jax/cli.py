"""`python -m midlie_jax.cli`, and the command for those who call it from Python. See `midlie_command`."""

import sys

from midlie_command import main as main

if __name__ == "__main__":
    sys.exit(main())
