"""Links from names in a text to their entries on the API pages, and from entries to the pages that explain them.

mkdocs calls this after `hooks.py`, for the site; `benchmarks/api_pages.py` makes the same links in the Markdown.
`tests/test_cross_links.py` says what is linked.
"""

import inspect
import re
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]  # these sources, whatever is installed

import hooks  # noqa: E402

# The page that explains a name, by the longest beginning that fits. Where one page explains all of a module, the text
# above its entries says so.
EXPLAINED = {
    "heat.md": ["torques.Langevin", "torques.baths_in", "torques.without_bath", "schemes.measured_weak_order"],
    "spins.md": [
        *("Spins", "SpinState", "checkerboard", "torques.Exchange", "torques.Anisotropy", "torques.CubicAnisotropy"),
        *("torques.AppliedField", "torques.DzyaloshinskiiMoriya", "torques.SpinField", "torques.OwnField"),
        "torques.ThermalField",
    ],
    "bodies-together.md": [
        *("Coupled", "from_points", "sites", "wrench_on_sites", "molecules.", "straight_rod", "StraightRod"),
        *("torques.MutualGravity", "torques.Rod", "torques.OnEach"),
    ],
    "travelling.md": [
        *(
            "FreeBody",
            "FreeState",
            "FreeAxisState",
            "Rotor",
            "AxisState",
            "Wrench",
            "velocity",
            "linear_momentum",
            "torques.UniformGravity",
        ),
        *("torques.PointMass", "torques.Oblateness", "torques.Drag", "torques.Magnus", "torques.Thrust"),
    ],
    "surfaces.md": ["Surface", "torques.Sunlight", "torques.FreeMolecularDrag", "observe.Brightness"],
    "solids.md": ["Particle"],
    "conventions.md": [
        *("RigidBody", "TensorBody", "RigidState", "MomentumState", "DirectionState", "CompensatedState", "RESULTS"),
        *("angular_velocity", "spatial_", "Path"),
    ],
    "choosing-a-method.md": [
        *("method", "recommend", "Recommendation", "check", "Check", "advice.", "integrate_adaptive", "AdaptivePath"),
        "densities.",
    ],
    "gradients.md": ["Checkpointed", "Reversible", "Forward"],
    "ensembles.md": ["ensemble", "simulate", "Simulation", "simulation."],
    "scatter.md": ["scatter"],
    "orbits.md": ["orbits.", "densities.OrbitalDistance", "torques.GravityGradient"],
    "extending.md": ["Body", "State", "flights.Flight", "flights.Inertia", "schemes.Scheme", "torques.Torque"],
}
_FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"(?<!\[)`([\w.]+)`(?!\])")
# What holds no text, or is a link or the name of an argument; else a name.
_HTML = re.compile(r"<(a|b|pre|h[1-6])\b.*?</\1>|<code>([\w.]+)</code>", re.DOTALL)


@cache
def places() -> dict[str, str]:
    """Page and anchor of each entry in the Markdown, such as api.md#rigidbody, as GitHub makes anchors."""
    found = {}
    for page in sorted(DOCS.glob("api*.md")):
        counted: dict[str, int] = {}
        for line in _FENCED.sub("", hooks.written_out(page.read_text())).splitlines():
            entry = hooks.ENTRY.match(line)
            title = entry[1].rpartition(".")[2] if entry else line.lstrip("#").strip() if line.startswith("#") else ""
            slug = re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")
            if entry:
                found[entry[1]] = f"{page.name}#{slug}" + (f"-{counted[slug]}" if counted.get(slug) else "")
            counted[slug] = counted.get(slug, 0) + 1
    return found


def entry_of(name: str, page: str) -> str | None:
    """The entry that a name in the text of a page means; None if that is not certain."""
    rest = name.removeprefix("midlie_jax.").removeprefix("ml.")
    own = [entry for entry in places() if entry.rpartition(".")[2] == rest]
    if "." in rest:
        return f"midlie_jax.{rest}" if f"midlie_jax.{rest}" in places() else None
    here = [entry for entry in own if places()[entry].startswith(f"{page}#")]
    of_package = [entry for entry in own if entry == f"midlie_jax.{rest}"]
    if rest == name and rest.islower():  # perhaps an argument or a method
        return next((entry for entry in of_package or here if rest not in _taken()), None)
    chosen = (own if len(own) == 1 else of_package) if rest != name else here or own
    return chosen[0] if len(chosen) == 1 else None


@cache
def _taken() -> frozenset[str]:
    """The names of arguments and methods, which mean nothing but themselves in a text."""
    taken: set[str] = set()
    for value in map(hooks.module_of, places()):
        with suppress(TypeError, ValueError):  # an enumeration has no signature
            taken |= set(inspect.signature(value).parameters)
        taken |= set(dir(value)) if inspect.isclass(value) else set()
    return frozenset(taken)


def explained(entry: str) -> str:
    """A sentence with a link to the page that explains an entry; "" if none does."""
    rest = entry.removeprefix("midlie_jax.")
    fitting = [(len(begin), page) for page, begins in EXPLAINED.items() for begin in begins if rest.startswith(begin)]
    if not fitting:
        return ""
    page = max(fitting)[1]
    title = (DOCS / page).read_text().partition("\n")[0].removeprefix("# ")
    return f"See [{title}]({page})."


def linked(text: str, entry: str) -> str:
    """Markdown of an entry with its names as links; that of the entry itself is none."""
    page = places()[entry].partition("#")[0]

    def link(found: re.Match[str]) -> str:
        target = entry_of(found[1], page)
        if target is None or target == entry:
            return found[0]
        return f"[{found[0]}]({places()[target].removeprefix(page)})"

    return _CODE.sub(link, text)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs for every page, after that of `hooks.py`."""
    return hooks.ENTRY.sub(lambda found: f"{found[0]}\n\n{explained(found[1])}", markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Called by mkdocs with what a page becomes. Its plugin autorefs makes links of these elements."""

    def link(found: re.Match[str]) -> str:
        target = entry_of(found[2], page.file.src_uri) if found[2] else None
        return f'<autoref identifier="{target}" optional>{found[0]}</autoref>' if target else found[0]

    return _HTML.sub(link, html)
