"""Writes signature, first sentence and example of every public name into the API pages, for readers of the Markdown.

    python benchmarks/api_pages.py

Names of the package become links to their entries (`docs/cross_links.py`). On the pages,
`<!-- api: midlie_jax.torques -->` and `<!-- /api -->` enclose what this writes; `docs/hooks.py` replaces it on the site
by all that the docstrings say. `tests/test_api_pages.py` asks that the pages are as this writes them.
"""

import ast
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from enum import EnumType
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent.parent / "docs"
sys.path[:0] = [str(DOCS), str(DOCS.parent)]  # these sources, whatever is installed

import cross_links  # noqa: E402
import hooks  # noqa: E402

_WIDTH = 110
# The section of a docstring in Google's style, and what its lines are indented by.
_EXAMPLES = re.compile(r"^Examples:\n((?:    .*\n|\n)+)", re.MULTILINE)
_SENTENCE = re.compile(r"(.+?[^\s.]\.)(?= [A-Z`\"(]|$)")


def filled(markdown: str) -> str:
    """The page with the signatures, first sentences and examples of now."""

    def written(found: re.Match[str]) -> str:
        texts = [_entry(name) for name in hooks.entries_of(found[1])]
        return "\n\n".join([f"<!-- api: {found[1]} -->", *texts, "<!-- /api -->"])

    return hooks.MARKED.sub(written, markdown)


def _entry(name: str) -> str:
    value = hooks.module_of(name)
    own = name.rpartition(".")[2]
    # "py" and not "python": the tests run what is marked as "python".
    code = "\n".join(map(str, value)) if isinstance(value, EnumType) else own + signature(value)
    sentence = cross_links.linked(_first_sentence(value), name)
    text = " ".join(filter(None, (sentence, cross_links.explained(name))))
    parts = [f"### {own}", f"```py\n{code}\n```", text, *_examples(value)]
    if inspect.isclass(value):
        methods = [
            f"- `.{text}` {cross_links.linked(_first_sentence(method), name)}" for text, method in _methods(value)
        ]
        parts += ["\n".join(methods)] if methods else []
    return "\n\n".join(parts)


def _first_sentence(value: Any) -> str:
    paragraph = " ".join(inspect.cleandoc(value.__doc__ or "").partition("\n\n")[0].split())
    found = _SENTENCE.match(paragraph)
    return found[1] if found else paragraph


def _examples(value: Any) -> Iterator[str]:
    """The section "Examples" of a docstring: what begins with >>> as a block of code, the rest as it is."""
    section = _EXAMPLES.search(inspect.cleandoc(value.__doc__ or "") + "\n")
    for part in textwrap.dedent(section[1]).strip().split("\n\n") if section else []:
        # "pycon" is a session of Python. tests/test_api_examples.py runs these, from the docstrings.
        yield f"```pycon\n{part}\n```" if part.startswith(">>>") else part


def signature(value: Any) -> str:
    """The parameters, as the source writes them, and what is returned."""
    node = _initialiser(value) if inspect.isclass(value) else _node(value)
    if node is None:
        return _wrapped(list(_fields(value)), "")
    arguments = _arguments(node)
    returned = "" if inspect.isclass(value) or node.returns is None else f" -> {ast.unparse(node.returns)}"
    return _wrapped(arguments, returned)


def _node(value: Any) -> Any:
    return ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(value)))).body[0]


def _ours(value: Any) -> list[Any]:
    """The definitions of a class and of its bases in the package, in the order in which Python looks names up."""
    return [_node(base) for base in value.__mro__ if base.__module__.startswith("midlie_jax")]


def _initialiser(value: Any) -> Any:
    """The `__init__` that someone has written; None where it is made of the fields."""
    functions = [part for node in _ours(value) for part in node.body if isinstance(part, ast.FunctionDef)]
    return next((function for function in functions if function.name == "__init__"), None)


def _fields(value: Any) -> Iterator[str]:
    """The parameters of a class whose `__init__` is made of its fields."""
    written = {
        part.target.id: ast.unparse(part.annotation)
        for node in reversed(_ours(value))
        for part in node.body
        if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)
    }
    for parameter in inspect.signature(value).parameters.values():
        default = "" if parameter.default is parameter.empty else f" = {parameter.default!r}"
        yield f"{parameter.name}: {written.get(parameter.name, 'Any')}{default}"


def _arguments(node: Any) -> list[str]:
    """The parameters of a function, without `self`; `*` and `/` are texts of their own."""
    arguments = node.args
    found = [*arguments.posonlyargs, *arguments.args]
    defaults = [None] * (len(found) - len(arguments.defaults)) + arguments.defaults
    texts = [_argument(*pair) for pair in zip(found, defaults, strict=True)]
    if arguments.posonlyargs:
        texts.insert(len(arguments.posonlyargs), "/")
    if arguments.vararg or arguments.kwonlyargs:
        texts.append(f"*{ast.unparse(arguments.vararg)}" if arguments.vararg else "*")
    texts += [_argument(*pair) for pair in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)]
    texts += [f"**{ast.unparse(arguments.kwarg)}"] if arguments.kwarg else []
    return [text for text in texts if text.partition(":")[0] not in ("self", "cls")]


def _argument(argument: Any, default: Any) -> str:
    equals = " = " if argument.annotation else "="
    return ast.unparse(argument) + (f"{equals}{ast.unparse(default)}" if default is not None else "")


def _wrapped(arguments: list[str], returned: str) -> str:
    """The signature in one line, or in several that are as full as they can be."""
    line = f"({', '.join(arguments)}){returned}"
    if len(line) <= _WIDTH - 20:
        return line
    lines = [""]
    for text in arguments:
        if lines[-1] and len(lines[-1]) + len(text) + 2 > _WIDTH - 4:
            lines.append("")
        lines[-1] += f"{' ' if lines[-1] else ''}{text},"
    return "(\n" + "\n".join(f"    {line}" for line in lines) + f"\n){returned}"


def _methods(value: Any) -> Iterator[tuple[str, Any]]:
    """The public methods and properties that a class itself defines, with docstrings."""
    for part in _node(value).body:
        if not isinstance(part, ast.FunctionDef) or part.name.startswith("_"):
            continue
        method = inspect.getattr_static(value, part.name)
        if not ast.get_docstring(part):
            continue
        method = method.__func__ if isinstance(method, staticmethod | classmethod) else method
        returned = f" -> {ast.unparse(part.returns)}" if part.returns else ""
        named = any(isinstance(one, ast.Name) and one.id == "property" for one in part.decorator_list)
        yield part.name + ("" if named else f"({', '.join(_arguments(part))}){returned}"), method


def main() -> None:
    for page in sorted(DOCS.glob("api*.md")):
        page.write_text(filled(page.read_text()))


if __name__ == "__main__":
    main()
