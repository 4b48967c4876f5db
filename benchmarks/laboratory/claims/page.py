"""The tables of the claims, for the terminal, for docs/reports/claims.md and for its data files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from pages import cells as cells_of
from pages import compact, link, part, save

from midlie_jax.methods.base import Method

from .measure import Measured
from .verdicts import DECLARED, RANK, Verdict, paper_verdicts, published_verdicts, registry_verdicts, trend

HEADS = (
    *("method", "order", "defect, h=0.1", "area, h=0.1", "R Pi", "reversal", "top: shift", "top: osc."),
    *("drift: first", "last", "ev.", "solves", "error, top", "error, P1", "ok"),
)

TRIED = ("method", "claim", "measured", "verdict", "command")
SHOWN = (0, 1, 2, 4, 5, 8, 9, 13)  # the columns of `HEADS` on the page; the data file has all

ABOUT = """# The paper's claims, tested

Krysl (2004) claims that the method `LIEMID[EA]` is symplectic and the best explicit integrator of second order. Each
claim is measured here, and each verdict is computed from the figures. Written by `{command}`.

{outcome}

## What is measured

All methods are measured in the same way. A method for bodies with two equal moments (`SYMMETRIC`) uses a top with
moments (1, 3, 3), with gravity across the axis of symmetry.

- **Order**: {tops} tops (scene `asymmetric-top`, initial states changed by a tenth), T = 2, 2 to 128 steps. The order
  is the slope between the two smallest steps whose errors exceed rounding errors.
- **Defect**: the largest entry of `M^T W M - W` for one step of a top. `M` is the derivative of the step, and `W` is
  the canonical form of T*SO(3). An entry of 1e-13 is rounding error.
- **Area**: the change of an area on the momentum sphere in one step of a free body.
- **R Pi**: the largest relative change of the spatial momentum of {bodies} free bodies over {steps:.0e} steps of 0.2
  to 0.5 rad.
- **Reversal**: the distance from the initial state after 64 steps of 0.1 and 64 of -0.1.
- **Top**: the relative energy error of {bodies} tops over {steps:.0e} steps of 0.05. The shift is the change of its
  mean from the first to the last eighth of the run. The oscillation is its root mean square in the first eighth. A
  trend is a shift of more than a fifth of the oscillation and more than rounding error. The motion is chaotic:
  {chaos}
- **Drift**: the test of Bou-Rabee, Ortolan and Saccon (arXiv 1005.3078; scene `drift-test`), T = 1e4, h = 0.25. The
  numbers are the mean energy errors over the first and the last eighth.
- **Ev.**: torque evaluations per step after the first, with directional derivatives. **Solves**: iterative solves per
  step.
- **Error**: momentum (relative) and attitude [rad] together; the tops at T = 2 with h = 1/32, P1 at T = 10 with h =
  0.005.
"""


def cells(found: Measured) -> list[str]:
    """The row of a method, for `HEADS`."""
    shift, oscillation = trend(found)
    drifts = found.drift.eighths[0]
    return [
        found.method,
        f"{found.order:.2f}",
        f"{found.symplectic[-1]:.0e}",
        f"{found.area[-1]:.0e}",
        f"{found.momentum:.0e}",
        f"{found.reversal:.0e}",
        f"{shift:.1e}",
        f"{oscillation:.1e}",
        f"{drifts[0]:.1e}",
        f"{drifts[-1]:.1e}",
        str(found.work.evaluations) + ("" if found.work.explicit else " implicit"),
        str(found.solves),
        f"{found.accuracy:.1e}",
        f"{found.accuracy_p1:.1e}",
        "yes" if found.ok else "NO",
    ]


def word(verdict: Verdict) -> str:
    return "holds" if verdict.holds else "FALLS"


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table."""
    return [compact("| " + " | ".join(line) + " |") for line in (heads, ["---"] * len(heads), *rows)]


def summary(methods: Sequence[Method], all_found: Sequence[Measured]) -> str:
    """How many of the registry's declarations hold, in a sentence, and which fall."""
    verdicts = [v for m, f in zip(methods, all_found, strict=True) for v in registry_verdicts(m, f)]
    falls = [v for v in verdicts if not v.holds]
    text = f"{len(verdicts) - len(falls)} of {len(verdicts)} declarations of the registry hold."
    return text + "".join(f"\n{v.method}: {v.claim} FALLS, measured {v.measured}." for v in falls)


class Tables(NamedTuple):
    """The tables of the page, as lines of Markdown.

    Attributes:
        claims, drifts: the verdicts on the paper's claims and on the published drifts, with `TRIED` as heads.
        figures: what was measured of each method, with `HEADS`.
        declared: the verdicts on the registry's declarations.
    """

    claims: list[str]
    drifts: list[str]
    figures: list[str]
    declared: list[str]


def write_page(
    file: Path,
    methods: Sequence[Method],
    all_found: Sequence[Measured],
    *,
    command: str,
    given: Mapping[str, str],
    chaos: str,
    tops: int,
    bodies: int,
    picture: str | None,
) -> None:
    """Writes the page as Markdown, and its data files into the folder `tables` beside it.

    Args:
        file: the page.
        methods, all_found: the methods, and what was measured of each.
        command: the command that measured it.
        given: how the command calls a method, by its name, where it does not call it so.
        chaos: the sentence that shows that the motion of the tops is chaotic.
        tops, bodies: how many tops and free bodies were measured.
        picture: name of the picture beside the page, if there is one.
    """

    def alone(method: str) -> str:
        return f"python benchmarks/claims.py --methods '{given.get(method, method)}'"

    def tried(verdicts: Sequence[Verdict]) -> list[str]:
        rows = [
            [f"`{v.method}`", v.claim, v.measured, word(v), f"`{command if v.key == RANK else alone(v.method)}`"]
            for v in verdicts
        ]
        return markdown(TRIED, rows)

    paper = paper_verdicts(methods, all_found)
    tables = Tables(
        tried(paper),
        tried(published_verdicts(all_found)),
        markdown(HEADS, [[f"`{row[0]}`", *row[1:]] for row in map(cells, all_found)]),
        _declared(methods, all_found),
    )
    about = ABOUT.format(
        command=command, steps=all_found[0].steps, chaos=chaos, tops=tops, bodies=bodies, outcome=outcome(paper)
    )
    write_tables(file, tables, about, summary(methods, all_found), command, picture)


def outcome(verdicts: Sequence[Verdict]) -> str:
    """How many of the claims hold for each method that they are about, and which do not."""
    groups: dict[str, list[str]] = {}
    for method in dict.fromkeys(v.method for v in verdicts):
        own = [v for v in verdicts if v.method == method]
        falls = [v.claim for v in own if not v.holds]
        text = f"{len(own) - len(falls)} of {len(own)} claims hold."
        text += f" These do not:\n{'; '.join(falls)}." if falls else ""
        groups.setdefault(text, []).append(f"`{method}`")
    return "\n".join(f"For {' and '.join(methods)}, {text}" for text, methods in groups.items())


def write_tables(file: Path, tables: Tables, about: str, declared: str, command: str, picture: str | None) -> None:
    """Writes the page from its tables and its first section, and the data files."""
    folder = file.parent / "tables"
    for name, lines in zip(Tables._fields, tables, strict=True):
        save(f"claims-{name}", lines, folder)
    drawn = f"![Energy over the two long runs]({picture})\n\n<!-- drawn by: `{command}` -->\n"
    parts = [
        about,
        "## Verdicts\n\nThe paper makes these claims for its alternating method, `LIEMID[EA]`. The method "
        "`LIEMID[EA*]` is the same\nsequence, cut at another place; the data file has its rows and all commands. "
        "Methods of its kind have order 2,\nevaluate one torque per step explicitly, and conserve momentum.\n",
        *_with_link(_of_first_method(tables.claims), "claims-claims"),
        "## The published drift of the energy\n\nEach value is a mean over copies that differ by 1e-14. Where the "
        "copies separate, the motion is chaotic, and the\npublished value is one draw.\n",
        *_with_link(part(tables.drifts, columns=range(4)), "claims-drifts"),
        *([drawn] if picture else []),
        "## Measured values\n\nThe command `python benchmarks/claims.py --methods NAME` prints the values for one "
        "method; `--all` measures all flights with\nall schemes.\n",
        *_with_link(part(tables.figures, columns=SHOWN), "claims-figures"),
        f"## Properties that the package declares\n\n{declared} The file\n[claims-declared.csv]"
        "(tables/claims-declared.csv) lists them for each method. A dash means that a property is not declared.\n",
        "## Limits\n\nThe verdicts concern these scenes, steps and lengths of runs. A property that holds in one "
        "measurement is not proved for\nall bodies and torques.",
    ]
    file.write_text("\n".join(parts) + "\n")


def _of_first_method(lines: Sequence[str]) -> list[str]:
    """Claims, measured values and verdicts for the first method of the table."""
    first = cells_of(lines[2])[0] if len(lines) > 2 else ""
    return part(lines, lambda row: row[0] == first, range(1, 4))


def _with_link(lines: Sequence[str], name: str) -> list[str]:
    return [*map(compact, lines), "", link(name), ""]


def _declared(methods: Sequence[Method], all_found: Sequence[Measured]) -> list[str]:
    rows: list[list[str]] = []
    for method, found in zip(methods, all_found, strict=True):
        words = {v.key: word(v) for v in registry_verdicts(method, found)}
        rows.append([f"`{found.method}`", *(words.get(key, "-") for key in DECLARED)])
    return markdown(["method", *DECLARED], rows)
