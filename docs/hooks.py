"""What mkdocs does in addition, for the site: entries of public names, notebooks, links of names, formulas.

- `api.md` lists the public names by topic. The site has a page for each topic, with an entry for each name from its
  docstring, by mkdocstrings; a module in a list stands for all of its public names.
- Notebooks and the changelog, which are outside `docs/`, become pages. A notebook is shown as stored.
- A name in backticks becomes a link to its entry where it is certain what it means, and an entry links to the guide.
- Formulas, `$...$` and `$$...$$`, become MathML, which browsers show without a script.
"""

import ast
import base64
import inspect
import json
import posixpath
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache, reduce
from html import unescape
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
CHANGES = "CHANGELOG.md"
sys.path.insert(0, str(ROOT))  # these sources, whatever is installed

# The guide that explains a name, by the longest beginning that fits. Where one guide explains all of a topic, api.md
# links to it.
EXPLAINED = {
    "heat.md": ["baths.", "schemes.measured_weak_order"],
    "spins.md": ["spins."],
    "bodies-together.md": ["Coupled", "molecules.", "asteroids.MutualGravity", "torques.OnEach"],
    "travelling.md": [
        *("FreeBody", "FreeState", "FreeAxisState", "SymmetricRotor", "AxisState", "torques.Wrench"),
        *("torques.UniformGravity", "torques.PointMass", "torques.Oblateness", "torques.Drag", "torques.Magnus"),
        *("spacecraft.Thrust", "observe.linear_", "observe.position"),
    ],
    "surfaces.md": [
        *("Surface", "asteroids.Sunlight", "spacecraft.FreeMolecularDrag", "asteroids.Brightness"),
        "asteroids.EllipsoidBrightness",
    ],
    "solids.md": ["Particle"],
    "conventions.md": [
        *("RigidBody", "TensorBody", "RigidState", "MomentumState", "DirectionState", "CompensatedState", "RESULTS"),
        *("observe.angular_velocity", "observe.spatial_", "Path"),
    ],
    "choosing-a-method.md": [
        *("method", "recommend", "check", "advice.", "integrate_variable_step"),
        "densities.",
    ],
    "gradients.md": ["adjoints."],
    "ensembles.md": ["ensemble", "simulate", "simulation."],
    "scatter.md": ["scatter"],
    "orbits.md": ["orbits.", "densities.OrbitalDistance", "spacecraft.GravityGradient", "asteroids.tumb"],
    "extending.md": ["base.", "flights.Flight", "flights.Inertia", "schemes.Scheme", "torques.Torque"],
}
_TOPIC = re.compile(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
# A paragraph that is a list of names.
_LIST = re.compile(r"^`ml\.[\w.]+`(?:,\s`ml\.[\w.]+`)*$", re.MULTILINE)
ENTRY = re.compile(r"^::: ([\w.]+)$", re.MULTILINE)
_LINK = re.compile(r"(?<=\]\()[^)#:\s]+\.(?:md|ipynb)\b")
# What holds no text, or is a link or the name of an argument; else a name.
_CODE = re.compile(r"<(a|b|pre|h[1-6])\b.*?</\1>|<code>([\w.]+)</code>", re.DOTALL)
# A formula between lines, as GitHub reads it; or code, where there is none.
_DISPLAYED = re.compile(r"^(```+).*?^\1$|^\$\$.+?\$\$$", re.MULTILINE | re.DOTALL)
# What pymdownx.arithmatex makes of formulas, in a line and between lines.
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.+?)\\[)\]]</\1>', re.DOTALL)


def module_of(name: str) -> Any:
    """What users reach by this name, such as midlie_jax.torques, wherever its file is."""
    package, *rest = name.split(".")
    return reduce(getattr, rest, import_module(package))


def public_names(name: str) -> list[str]:
    """The public names of a module, in the order of its source.

    They are what it defines without an underscore, and what it imports as `X as X`, the mark of a name for others. The
    package itself has them in a stub.
    """
    module = module_of(name)
    stub = Path(inspect.getfile(module)).with_suffix(".pyi")
    names = []
    for node in ast.parse(stub.read_text() if stub.exists() else inspect.getsource(module)).body:
        if isinstance(node, (ast.ImportFrom, ast.Import)):
            names += [alias.name for alias in node.names if alias.asname == alias.name]
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.append(node.name)
    return [found for found in dict.fromkeys(names) if not found.startswith("_")]


def entries(name: str) -> list[str]:
    """The public names of a module that have an entry of their own, as dotted names: its classes and functions."""
    module = module_of(name)
    found = {public: getattr(module, public) for public in public_names(name)}
    return [f"{name}.{public}" for public, value in found.items() if _has_entry(value)]


def _has_entry(value: Any) -> bool:
    """Modules have topics instead, and the names of types and tables have no docstrings."""
    ours = getattr(value, "__module__", "").startswith("midlie_jax")
    return callable(value) and not isinstance(value, ModuleType) and ours


def entries_of(names: str) -> list[str]:
    """The dotted names that a list of api.md stands for."""
    dotted = [f"midlie_jax.{name}" for name in re.findall(r"`ml\.([\w.]+)`", names)]
    modules = [isinstance(module_of(name), ModuleType) for name in dotted]
    return [
        entry
        for name, is_module in zip(dotted, modules, strict=True)
        for entry in (entries(name) if is_module else [name])
    ]


def topics(api: str) -> dict[str, str]:
    """The pages of the topics of api.md that have lists of names, each name an entry."""
    pages = {}
    for title, text in _TOPIC.findall(api):
        if _LIST.search(text):
            slug = title.lower().replace(" ", "-")
            pages[f"api-{slug}.md"] = f"# {title}\n{_LIST.sub(_as_entries, text)}"
    return pages


def _as_entries(names: re.Match[str]) -> str:
    return "\n\n".join(f"::: {entry}\n\n{explained(entry)}".rstrip() for entry in entries_of(names[0]))


def explained(entry: str) -> str:
    """A sentence with a link to the guide that explains an entry; "" if none does."""
    rest = entry.removeprefix("midlie_jax.")
    fitting = [(len(begin), page) for page, begins in EXPLAINED.items() for begin in begins if rest.startswith(begin)]
    if not fitting:
        return ""
    page = max(fitting)[1]
    title = (DOCS / page).read_text().partition("\n")[0].removeprefix("# ")
    return f"See [{title}]({page})."


@cache
def places() -> dict[str, str]:
    """The page of each entry."""
    pages = topics((DOCS / "api.md").read_text())
    return {entry: page for page, text in pages.items() for entry in ENTRY.findall(text)}


def entry_of(name: str, page: str) -> str | None:
    """The entry that a name in the text of a page means; None if that is not certain."""
    rest = name.removeprefix("midlie_jax.").removeprefix("ml.")
    own = [entry for entry in places() if entry.rpartition(".")[2] == rest]
    if "." in rest:
        return f"midlie_jax.{rest}" if f"midlie_jax.{rest}" in places() else None
    here = [entry for entry in own if places()[entry] == page]
    of_package = [entry for entry in own if entry == f"midlie_jax.{rest}"]
    if rest == name and rest.islower():  # perhaps an argument or a method
        return next((entry for entry in of_package or here if rest not in _taken()), None)
    if rest != name:
        chosen = own if len(own) == 1 else of_package
    else:  # those who come from another package have classes of the same name, such as SciPy's Rotation
        chosen = here or (of_package if page.startswith("coming-from/") else own)
    return chosen[0] if len(chosen) == 1 else None


@cache
def _taken() -> frozenset[str]:
    """The names of arguments and methods, which mean nothing but themselves in a text."""
    taken: set[str] = set()
    for value in map(module_of, places()):
        with suppress(TypeError, ValueError):  # an enumeration has no signature
            taken |= set(inspect.signature(value).parameters)
        taken |= set(dir(value)) if inspect.isclass(value) else set()
    return frozenset(taken)


def notebook(path: Path) -> tuple[str, dict[str, bytes]]:
    """A stored notebook as Markdown, and its pictures by their names."""
    pictures: dict[str, bytes] = {}

    def shown(output: dict[str, Any]) -> str:
        data = output.get("data", {"text/plain": output.get("text", "")})
        for kind in ("png", "gif"):
            if picture := data.get(f"image/{kind}"):
                name = f"{path.stem}-{len(pictures) + 1}.{kind}"
                pictures[name] = base64.b64decode(picture)
                return f"![]({name})"
        return f"``` {{ .text .output }}\n{''.join(data['text/plain']).rstrip()}\n```"

    def parts() -> Iterator[str]:
        for cell in json.loads(path.read_text())["cells"]:
            source = "".join(cell["source"])
            yield source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```"
            yield from map(shown, cell.get("outputs", []))

    return "\n\n".join(parts()), pictures


def relinked(markdown: str, page: str) -> str:
    """Links between files of the repository as links between pages of the site, where docs/ is the root."""
    source = page if page.startswith("notebooks/") or page == CHANGES else f"docs/{page}"

    def link(found: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), found[0]))
        path = path.removeprefix("docs/").removesuffix(".ipynb") + (".md" if path.endswith(".ipynb") else "")
        return posixpath.relpath(path, posixpath.dirname(page) or ".")

    return _LINK.sub(link, markdown)


def with_mathml(page: str, name: str) -> str:
    """HTML of a page with its formulas as MathML. What is no LaTeX ends the build."""
    from math_core import LatexError, LatexToMathML

    convert = LatexToMathML(fancy_error=False).convert_with_local_state

    def shown(found: re.Match[str]) -> str:
        formula = unescape(found[2])
        try:
            return convert(formula, displaystyle=found[1] == "div")
        except LatexError as error:
            raise ValueError(f"{name} must have formulas in LaTeX, got {formula}: {error}") from None

    return _FORMULA.sub(shown, page)


def with_links(page: str, name: str) -> str:
    """HTML of a page with names as links to their entries; the plugin autorefs makes links of these elements."""

    def link(found: re.Match[str]) -> str:
        target = entry_of(found[2], name) if found[2] else None
        return f'<autoref identifier="{target}" optional>{found[0]}</autoref>' if target else found[0]

    return _CODE.sub(link, page)


def on_files(files: Any, config: Any, **_: Any) -> None:
    """Called by mkdocs with what it found in docs/."""
    from mkdocs.structure.files import File

    pages: dict[str, str | bytes] = dict(topics((DOCS / "api.md").read_text()))
    for name in (CHANGES, "notebooks/README.md"):
        pages[name] = (ROOT / name).read_text()
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text, pictures = notebook(path)
        pages |= {f"notebooks/{path.stem}.md": text, **{f"notebooks/{name}": data for name, data in pictures.items()}}
    for name, content in pages.items():
        files.append(File.generated(config, name, content=content))


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Called by mkdocs for every page."""
    name = page.file.src_uri
    if name == "api.md":  # a module as the list of its names
        markdown = _LIST.sub(lambda found: ", ".join(f"`{entry}`" for entry in entries_of(found[0])), markdown)
        markdown = markdown.replace("`midlie_jax.", "`ml.")
    # Between empty lines it is a paragraph, as pymdownx.arithmatex wants it.
    markdown = _DISPLAYED.sub(lambda found: found[0] if found[1] else f"\n{found[0]}\n", markdown)
    return relinked(markdown, name)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Called by mkdocs with what a page becomes."""
    name = page.file.src_uri
    return with_links(with_mathml(html, name), name)
