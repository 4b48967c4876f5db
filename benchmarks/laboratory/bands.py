"""How the frontiers of the families of methods are drawn."""

from typing import NamedTuple

from midlie_jax.plot.style import BLACK, BLUE, GREEN


class Band(NamedTuple):
    """How the frontier of a family of methods is drawn.

    Attributes:
        colour: of the line, of the name of the family, and of its methods.
        width: points.
        alpha: opacity.
    """

    colour: str
    width: float
    alpha: float


# From the widest to the narrowest, drawn in this order: where frontiers coincide, each is seen beside the next.
BANDS = {
    "general": Band(BLUE, 11.0, 0.4),
    "conserving": Band(GREEN, 6.0, 1.0),
    "symplectic": Band(BLACK, 2.4, 1.0),
}
