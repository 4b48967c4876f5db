"""Pictures of motions on matplotlib's axes, and animations of motions (extra `plot`).

`import midlie_jax` imports neither this folder nor matplotlib nor plotly; each is imported when it is first needed.

Modules: on the user's axes `bands` (quantiles of an ensemble), `axis_path`, `track`, `polhode`, `conserved` and
`poincare` (one path each); files `animate` (GIF, of `scene`s) and `view` (HTML, of `traces`). Below them: `motion` (the
part of a path that can be trusted), `several` (paths side by side), `turning`, `travel` and `shape` (the body at evenly
spaced times), `conservation` and `kept` (what the exact motion conserves), `ellipsoid`, `space` and `labels3d` (artists
for 3-D axes), `edge`, `apart` and `room` (names that neither collide nor are cut off) and `style`. `cli` uses these
lower modules, too.
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
