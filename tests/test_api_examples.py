"""Every public name has an example in its docstring, and what the example prints is what it says.

The examples are of the standard module doctest: lines after >>> in a section "Examples:". The docstring of the package
lists the names that they use without a definition.
"""

import doctest
import inspect
from itertools import zip_longest

import pytest
from test_api_pages import ENTRIES, hooks

import midlie_jax as ml

WRITERS = {
    "midlie_jax.spacecraft.attitudes": "midlie_jax.spacecraft.attitudes.write"
}  # its example writes the file that others read


def assumed():
    """The names that every example can use: those that the docstring of the package defines."""
    names = {}
    for line in doctest.DocTestParser().get_examples(ml.__doc__):
        exec(line.source, names)
    return names


ASSUMED = assumed()


def example(entry):
    """The example in the docstring of a public name."""
    return doctest.DocTestParser().get_doctest(hooks.module_of(entry).__doc__, dict(ASSUMED), entry, None, None)


# The first name of each page, then the second of each, and so on, so that the first of the list are of all pages.
IN_TURN = [entry for row in zip_longest(*ENTRIES.values()) for entry in row if entry]
WITH_EXAMPLE = [entry for entry in IN_TURN if example(entry).examples]


@pytest.mark.parametrize("page", ENTRIES)
def test_every_public_name_has_an_example(page):
    """In the section that the site shows as one."""
    texts = {entry: inspect.cleandoc(hooks.module_of(entry).__doc__) for entry in ENTRIES[page]}
    assert [entry for entry, text in texts.items() if "\nExamples:\n    >>> " not in text] == []


@pytest.mark.sample(0)
@pytest.mark.filterwarnings("ignore:Setting the shape on a NumPy array:DeprecationWarning")  # in ase
@pytest.mark.parametrize("entry", WITH_EXAMPLE)
def test_the_example_prints_what_it_says(entry, monkeypatch, tmp_path):
    """In an empty folder, where it may write files."""
    monkeypatch.chdir(tmp_path)
    report = []
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    for each in dict.fromkeys((WRITERS.get(entry.rpartition(".")[0], entry), entry)):
        failed, _ = runner.run(example(each), out=report.append)
        assert not failed, "".join(report)
