"""`python -m midlie_jax`: the `midlie` command where its script is not on the path. See `midlie_command`."""

import sys

from midlie_command import main

sys.exit(main())
