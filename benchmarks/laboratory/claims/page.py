"""The tables of the claims, for the terminal, for docs/reports/claims.md and for its data files."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from harness import REPORTS, compact, link, part, put, save, table
from harness import cells as cells_of

from midlie_jax.integrators.base import Method

from .measure import Measured
from .verdicts import DECLARED, RANK, Verdict, paper_verdicts, published_verdicts, registry_verdicts, trend

HEADS = (
    *("method", "order", "defect, h=0.1", "area, h=0.1", "R Pi", "reversal", "top: shift", "top: osc."),
    *("drift: first", "last", "ev.", "solves", "error, top", "error, P1", "ok"),
)

TRIED = ("method", "claim", "measured", "verdict", "command")
SHOWN = (0, 1, 2, 4, 5, 8, 9, 13)  # the columns of `HEADS` on the page; the data file has all


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
    picture: str | None,
) -> None:
    """Writes what was measured into docs/reports/claims.md, or a page of its own, and the data files beside it.

    Args:
        file: the page.
        methods, all_found: the methods, and what was measured of each.
        command: the command that measured it.
        given: how the command calls a method, by its name, where it does not call it so.
        chaos: the sentence that shows that the motion of the tops is chaotic.
        picture: name of the picture beside the page, if there is one.
    """

    def alone(method: str) -> str:
        return f"python benchmarks/claims.py --methods '{given.get(method, method)}'"

    def tried(verdicts: Sequence[Verdict]) -> list[str]:
        rows = [
            [f"`{v.method}`", v.claim, v.measured, word(v), f"`{command if v.key == RANK else alone(v.method)}`"]
            for v in verdicts
        ]
        return table(TRIED, rows)

    paper = paper_verdicts(methods, all_found)
    claims, drifts = tried(paper), tried(published_verdicts(all_found))
    figures = table(HEADS, [[f"`{row[0]}`", *row[1:]] for row in map(cells, all_found)])
    data = {"claims": claims, "drifts": drifts, "figures": figures, "declared": _declared(methods, all_found)}
    for name, lines in data.items():
        save(f"claims-{name}", lines, file.parent / "tables")
    sections = {
        "claims outcome": [outcome(paper)],
        "claims chaos": [f"The motion of the tops is chaotic: {chaos}"],
        "claims verdicts": [*_of_first_method(claims), "", link("claims-claims")],
        "claims drifts": [*part(drifts, columns=range(4)), "", link("claims-drifts")],
        "claims values": [*part(figures, columns=SHOWN), "", link("claims-figures")],
        "claims declared": [summary(methods, all_found), "", link("claims-declared")],
    }
    if file.resolve() == REPORTS / "claims.md":
        for mark, lines in sections.items():
            put("reports/claims.md", mark, lines)
        return
    drawn = [f"![Energy over the two long runs]({picture})", ""] if picture else []
    text = [line for lines in sections.values() for line in (*map(compact, lines), "")]
    file.write_text("\n".join(["# The claims", "", f"Written by `{command}`.", "", *text, *drawn]))


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


def _of_first_method(lines: Sequence[str]) -> list[str]:
    """Claims, measured values and verdicts for the first method of the table."""
    first = cells_of(lines[2])[0] if len(lines) > 2 else ""
    return part(lines, lambda row: row[0] == first, range(1, 4))


def _declared(methods: Sequence[Method], all_found: Sequence[Measured]) -> list[str]:
    rows: list[list[str]] = []
    for method, found in zip(methods, all_found, strict=True):
        words = {v.key: word(v) for v in registry_verdicts(method, found)}
        rows.append([f"`{found.method}`", *(words.get(key, "-") for key in DECLARED)])
    return table(["method", *DECLARED], rows)
