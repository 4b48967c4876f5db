"""The drivers take the same arguments under the same names, in the same order, with the same defaults.

docs/api.md has the table: `python tests/test_signatures.py` prints it.
"""

import inspect
from pathlib import Path

import pytest

import midlie_jax as ml

DRIVERS = {
    "integrate": ml.integrate,
    "ensemble": ml.ensemble,
    "simulate": ml.simulate,
    "integrate_variable_step": ml.integrate_variable_step,
    "check": ml.check,
    "recommend": ml.recommend,
    "free_motion": ml.free_motion,
    "fit": ml.fit,
}
FIRST = ("method", "body", "torque", "start")  # by position, in this order; all else by keyword
OWN = {"free_motion": ("times",), "fit": ("model", "guess", "measurements")}  # by position, in one driver alone
# What a driver does without being told differs where its work does: the reason.
DEFAULTS = {
    ("save_every", "integrate"): "1: a path of one body is small",
    ("save_every", "integrate_variable_step"): "1: a path of one body is small",
    ("steps", "check"): "None: as many as a trial needs",
    ("method", "fit"): "by keyword, JACOBI[EA]: most fits take it",
    ("dt", "fit"): "None: the closed form of the free motion has no step",
}
PAGE = Path(__file__).parents[1] / "docs" / "api.md"


def parameters(name):
    return inspect.signature(DRIVERS[name]).parameters


def shown(parameter):
    """A cell of the table."""
    if parameter.default is inspect.Parameter.empty:
        return "required"
    return f"`{parameter.default!r}`".replace("'", '"')


def table():
    """The table of docs/api.md."""
    order = {}
    for name in DRIVERS:
        for key in parameters(name):
            order.setdefault(key, []).append(name)
    names = [*(key for key in FIRST if key in order), *(key for key in order if key not in FIRST)]
    lines = [
        "| argument | " + " | ".join(f"`{name}`" for name in DRIVERS) + " |",
        "|---" * (len(DRIVERS) + 1) + "|",
    ]
    for key in names:
        if len(order[key]) < 2:
            continue  # of one driver alone: its docstring tells
        cells = [shown(parameters(name)[key]) if key in parameters(name) else "" for name in DRIVERS]
        lines.append(f"| `{key}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


@pytest.mark.parametrize("name", DRIVERS)
def test_what_moves_comes_first_and_all_else_is_named(name):
    by_position = [p.name for p in parameters(name).values() if p.kind is not inspect.Parameter.KEYWORD_ONLY]
    own = OWN.get(name, ())
    assert by_position == [key for key in (*FIRST, *own) if key in by_position]
    assert set(own) <= set(by_position)
    for key in FIRST:
        assert key not in parameters(name) or key in by_position or (key, name) in DEFAULTS


def test_an_argument_has_one_default():
    for name in DRIVERS:
        for key, parameter in parameters(name).items():
            others = {
                shown(parameters(other)[key])
                for other in DRIVERS
                if key in parameters(other) and (key, other) not in DEFAULTS
            }
            assert (key, name) in DEFAULTS or others == {shown(parameter)}, key


def test_the_page_has_the_table():
    assert table() in PAGE.read_text(), "python tests/test_signatures.py prints the table"


if __name__ == "__main__":
    print(table())
