"""The pages docs/coming-from/*.md: each shows the same run in another program and in this one, and this proves it.

Both programs are read from the page and run as they stand there, each in a separate process.
"""

from . import bodies as bodies
from . import craft as craft
from . import solvers as solvers
from .compare import MARK as MARK
from .compare import PAGES as PAGES
from .compare import agree as agree
from .compare import columns as columns
from .compare import joined as joined
from .compare import missing as missing
from .compare import tables as tables
