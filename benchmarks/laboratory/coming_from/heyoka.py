"""The rows of docs/coming-from/heyoka.md."""

import re
from collections.abc import Iterator

from . import columns, quantities, tables
from .alone import Outcome, run
from .compare import Row, agree, as_they_stand, changed, errors, row

NAME, TITLE, NEEDS = "heyoka", "heyoka", ("heyoka",)
WITHIN = 1e-8  # radians

_WIDTHS = (1, 2, 4)
# From the asymmetric body to the fast top, and to the methods that fit it.
_TOP_LEFT = (("1.0, 2.0, 3.0, 3.0", "5.0, 5.0, 1.0, 20.0"), ("[1.1, -0.35, 4.0 / 3", "[0.0, 0.0, 50.0"))
_TOP_RIGHT = (
    ("[1.0, 2.0, 3.0]", "[5.0, 5.0, 1.0]"),
    ("HeavyTop(3.0)", "HeavyTop(20.0)"),
    ("[1.1, -0.35, 4.0 / 3]", "[0.0, 0.0, 50.0]"),
    ("PGBS12", "SYMMETRIC[SRKN14a]"),
    ("dt=0.2, steps=50", "dt=0.1, steps=100"),
)


def rows() -> Iterator[Row]:
    left, right = columns(NAME)
    yield from as_they_stand(NAME)
    ends = [run(code, quantities(NAME)) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, _finest(left))
    one, many = tables(NAME)
    left, right = (f"{first}\n{second}" for first, second in zip(one, many, strict=True))
    yield from _many("1024 bodies", left, right)
    yield from _many("1024 fast tops", changed(left, *_TOP_LEFT), changed(right, *_TOP_RIGHT))


def _many(label: str, left: str, right: str) -> Iterator[Row]:
    built = [run(changed(left, ("width = 1 *", f"width = {n} *")), quantities(NAME), 20) for n in _WIDTHS]
    theirs, ours = min(built, key=lambda found: found.later), run(right, quantities(NAME), 20)
    agree(NAME, theirs, ours)
    yield row(label, theirs.later, ours.later)
    yield errors(f"largest error of the {label}, rad", [theirs, ours], _finest(left))


def _finest(code: str) -> Outcome:
    return run(re.sub(r"tol=1e-\d+", "tol=1e-16", code), quantities(NAME))
