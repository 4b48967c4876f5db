"""The tables of the claims, for the terminal and for docs/reports/claims.md."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from midlie_jax.methods.base import Method

from .measure import Measured
from .verdicts import DECLARED, RANK, Verdict, paper_verdicts, published_verdicts, registry_verdicts, trend

HEADS = (
    *("method", "order", "defect, h=.1", "area, h=.1", "R Pi", "reversal", "top: shift", "top: osc."),
    *("drift: first", "last", "ev.", "solves", "error, top", "error, P1", "ok"),
)

ABOUT = """# The claims on trial

Written by `{command}`. Every figure is measured by that command, and every verdict is computed from the figures:
the paper's claims first, then what was published about the drift of the energy, then what the package itself declares
of its methods. The figures of one method come from `python benchmarks/claims.py --methods NAME`, those of all flights
with all schemes from `python benchmarks/claims.py --all`.

What is measured, for every method the same way:

- **order**: {tops} tops (the scene `asymmetric-top`, starts changed by a tenth) over two units of time, 2 to 128 steps;
  the slope between the two smallest steps whose errors are above rounding.
- **defect**: the largest entry of `M^T W M - W` for one step of a top, `M` the derivative of the step and `W` the
  canonical form of T*SO(3). **area**: by how much one step of a free body changes an area on the momentum sphere. Both
  with h = .4, .2 and .1; about 1e-13 is rounding.
- **R Pi**: the largest relative change of the spatial momentum of {bodies} free bodies over {steps:.0e} steps of .2 to
  .5 radians.
- **reversal**: how far from the start 64 steps of .1 and 64 of -.1 end.
- **top**: the energy error of {bodies} tops over {steps:.0e} steps of .05, relative. The shift is that of its mean from
  the first eighth of the run to the last, root mean square over the tops; the oscillation is its root mean square in
  the first eighth. A trend is a shift of more than a fifth of the oscillation and more than rounding. The motion is
  chaotic: {chaos}
- **drift**: the test of Bou-Rabee, Ortolan and Saccon (arXiv 1005.3078; the scene `drift-test`), T = 1e4 with h = .25:
  the mean energy error over the first and the last eighth.
- **ev.**: torque evaluations a step after the first, with directional derivatives, counted in the trace of a step.
  **solves**: equations that a step solves by iteration.
- **error**: of momentum (relative) and attitude (radians) together, on the tops at T = 2 with h = 1/32, and on the
  paper's fast top P1 at T = 10 with h = .005.

A method for bodies with two equal moments (`SYMMETRIC`) is measured on a top with the moments (1, 3, 3), with gravity
across the axis of symmetry.
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


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def summary(methods: Sequence[Method], all_found: Sequence[Measured]) -> str:
    """How many of the registry's declarations hold, in a sentence, and which fall."""
    verdicts = [v for m, f in zip(methods, all_found, strict=True) for v in registry_verdicts(m, f)]
    falls = [v for v in verdicts if not v.holds]
    text = f"{len(verdicts) - len(falls)} of {len(verdicts)} declarations of the registry hold."
    return text + "".join(f"\n{v.method}: {v.claim} FALLS, measured {v.measured}." for v in falls)


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
    """Writes the page as Markdown.

    Args:
        file: the page.
        methods, all_found: the methods, and what was measured of each.
        command: the command that measured it.
        given: how the command calls a method, by its name, where it does not call it so.
        chaos: the sentence that shows that the motion of the tops is chaotic.
        tops, bodies: how many tops and free bodies were measured.
        picture: name of the picture beside the page, if there is one.
    """

    def quoted(name: str) -> str:
        return f"`{name}`"

    def alone(method: str) -> str:
        return f"python benchmarks/claims.py --methods '{given.get(method, method)}'"

    def tried(verdicts: Sequence[Verdict]) -> str:
        rows = [
            [quoted(v.method), v.claim, v.measured, word(v), quoted(command if v.key == RANK else alone(v.method))]
            for v in verdicts
        ]
        return markdown(["method", "claim", "measured", "verdict", "command"], rows)

    steps = all_found[0].steps
    parts = [
        ABOUT.format(command=command, steps=steps, chaos=chaos, tops=tops, bodies=bodies),
        "## The paper's claims\n\nThe paper makes them of its alternating method: `LIEMID[EA]`, or `LIEMID[EA*]` "
        "when the same sequence is cut at another place. Its kind: second order, explicit with one torque a step, "
        "momentum kept.\n",
        tried(paper_verdicts(methods, all_found)),
        "## The published drift of the energy\n\nMeans over copies that differ by 1e-14. Where the copies part "
        "ways, the motion is chaotic by then, and the published figure is one draw.\n",
        tried(published_verdicts(all_found)),
        *([f"![Energy over the two long runs]({picture})\n\nDrawn by `{command}`.\n"] if picture else []),
        "## All figures\n",
        markdown(HEADS, [[quoted(row[0]), *row[1:]] for row in map(cells, all_found)]),
        "## What the package declares\n\n" + summary(methods, all_found) + " A dash: not declared.\n",
        _declared(methods, all_found),
    ]
    file.write_text("\n".join(parts))


def _declared(methods: Sequence[Method], all_found: Sequence[Measured]) -> str:
    rows: list[list[str]] = []
    for method, found in zip(methods, all_found, strict=True):
        words = {v.key: word(v) for v in registry_verdicts(method, found)}
        rows.append([f"`{found.method}`", *(words.get(key, "-") for key in DECLARED)])
    return markdown(["method", *DECLARED], rows)
