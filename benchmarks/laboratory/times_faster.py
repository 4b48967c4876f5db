"""What the data of docs/reports/work-precision.md say: the fastest methods, and docs/times-faster.png.

Nothing is measured here. Above the line at 1 of the picture, the fastest of our methods takes less time than the other
program.
"""

import re
from collections.abc import Iterator
from typing import Any

from harness import DOCS, Line, Panel, Table, by_scene, chart

from midlie_jax.cli.figures import FAINT, INK

PICTURE = DOCS / "times-faster.png"
COLUMNS = {"heyoka": "general / heyoka", "diffrax": "general / diffrax"}
LOOKS = {
    "P1": ("fast heavy top", "#0072B2", "o"),
    "bruls-cardona": ("heavy top of Brüls and Cardona", "#009E73", "s"),
    "tumbling-brick": ("tumbling brick", "#D55E00", "^"),
    "asymmetric-top": ("asymmetric heavy top", "#7F3C8D", "D"),
    "gravity-gradient-10": ("satellite, ten orbits", "#222222", "v"),
    "orbit": ("body in orbit", "#A6761D", "P"),
    "axis": ("axis of the fast top", "#56B4E9", "X"),
}
NOTE = "Run time of the other program over the fastest method's, at equal error; 1024 bodies, one core, float64."


def measured() -> dict[str, dict[str, list[tuple[float, float]]]]:
    """For each program and scene the errors and our times over theirs."""
    scenes = by_scene("work-precision")
    return {
        name: {
            scene: [(float(row["error"]), float(row[column])) for row in rows if row[column] != "-"]
            for scene, rows in scenes.items()
        }
        for name, column in COLUMNS.items()
    }


def inverse(ratios: str) -> str:
    """How many times faster, to two digits, from ratios of times such as "0.032 to 0.12"; words stay as they are."""
    known, *rest = ratios.partition(" (")
    found = [float(f"{1 / float(number):.2g}") for number in re.findall(r"\d[\d.]*(?:e[+-]\d+)?", known)]
    words = [f"{times:.0f}" if times >= 10 else f"{times:g}" for times in reversed(found)]
    return " to ".join(words) + "".join(rest) if words else ratios


def _digits(number: float) -> str:
    return f"{float(f'{number:.2g}'):g}"


def draw() -> None:
    def more(axes: Any) -> None:
        axes.axhline(1.0, color=FAINT, linewidth=1.2)
        axes.annotate("equal", (2.4e-3, 1.06), color=INK, fontsize=9)
        axes.set_xticks([1e-3, 1e-6, 1e-9, 1e-12], minor=False)
        axes.set_yticks([1, 3, 10, 30, 100, 300, 1000], ["1", "3", "10", "30", "100", "300", "1000"])

    every, panels = measured(), list[Panel]()
    spans = {name: [1 / ratio for rows in scenes.values() for _, ratio in rows] for name, scenes in every.items()}
    faster = [f"{_digits(min(span))} to {_digits(max(span))} times faster than {name}" for name, span in spans.items()]
    limits: Any = {"xscale": "log", "yscale": "log", "xlim": (3e-3, 3e-13), "ylim": (0.7, 2000)}
    for name, scenes in every.items():
        lines = list[Line]()
        for scene, (label, colour, marker) in LOOKS.items():
            if scene in scenes:
                errors, ratios = zip(*scenes[scene], strict=True)
                options: Any = {"marker": marker, "markersize": 5, "linewidth": 1.8}
                lines.append(Line(label, errors, [1 / ratio for ratio in ratios], colour, options=options))
        words = f"Compared with {name}", "error at the end [-]", "times faster [-]"
        panels.append(Panel(*words, lines, limits, more))
    title = f"midlie_jax is {' and '.join(faster)}"
    chart(PICTURE, [panels], (13.0, 5.6), title, NOTE, bottom=0.12, wspace=0.2)
    print(f"wrote {PICTURE.name}")


# ---- the fastest methods at four errors ----

ERRORS = ("1e-03", "1e-06", "1e-09", "1e-12")
TOLD = {"general": "any", "symplectic": "symplectic"}  # the family in the data file, and what readers are told
EQUAL = "any, symplectic"


def _cell(row: dict[str, str], family: str) -> str:
    """Method and time of a family at one error; "same" stands for the column to its left."""
    order = ["general: µs per body", "conserving: µs per body", "symplectic: µs per body"]
    place = order.index(f"{family}: µs per body")
    while row[order[place]] == "same":
        place -= 1
    name, _, time = row[order[place]].partition(": ")
    return f"`{name}` {time.split()[0]}" if time else "-"


def fastest_rows() -> Iterator[list[str]]:
    """For each scene the fastest of all methods and of the symplectic ones, with µs per body; one row if equal."""
    for scene, table in by_scene("work-precision").items():
        at = {row["error"]: row for row in table}
        found = {told: [_cell(at[error], family) for error in ERRORS] for family, told in TOLD.items()}
        first, second = found.values()
        for told, cells in ({EQUAL: first} if first == second else found).items():
            yield [scene, told, *cells]


FASTEST = Table(
    "choosing-a-method.md", "fastest", ["scene", "method", *(f"error {error}" for error in ERRORS)], fastest_rows
)
