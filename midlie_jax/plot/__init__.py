"""Pictures of motions on matplotlib's axes, and animations of motions (extra `plot`).

`import midlie_jax` imports neither this folder nor matplotlib nor plotly; each is imported on first use.

Modules: on the user's axes `bands` (quantiles of an ensemble), `curves` (`axis_path`, `polhode` and `track`),
`conservation` (`conserved`) and `poincare`; files `animate` (GIF, by `drawing`) and `view` (HTML), both from scenes in
`model`. Lower modules: `motion` (the trustworthy part of a path), `solids` (shapes of bodies), `artists` (for 3-D
axes) and `style`. `cli` also uses the lower modules.
"""

from .animate import animate as animate
from .bands import Bands as Bands
from .bands import bands as bands
from .conservation import Conserved as Conserved
from .conservation import conserved as conserved
from .curves import axis_path as axis_path
from .curves import polhode as polhode
from .curves import track as track
from .poincare import Crossings as Crossings
from .poincare import poincare as poincare
from .view import View as View
from .view import view as view
