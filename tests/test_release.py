"""What a release is made of; `newcomer.py` installs it."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path

import pytest

import midlie_jax as ml
from midlie_jax.cli.main import main

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
VERSION = PROJECT["version"]
INFO = f"midlie_jax-{VERSION}.dist-info/"


def build(source: Path, folder: Path, kind: str) -> Path:
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (file,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return file


def unpacked(sdist: Path, folder: Path) -> Path:
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (root,) = folder.iterdir()
    return root


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    return build(ROOT, tmp_path_factory.mktemp("sdist"), "sdist")


@pytest.fixture(scope="module")
def wheel(sdist, tmp_path_factory):
    """Built from the sdist, as an installer does where there is no wheel."""
    source = unpacked(sdist, tmp_path_factory.mktemp("sources"))
    return build(source, tmp_path_factory.mktemp("wheel"), "wheel")


def test_the_wheel_is_the_package_alone_and_says_what_is_installed(wheel):
    with zipfile.ZipFile(wheel) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    ours = {path.relative_to(ROOT).as_posix() for path in (ROOT / "midlie_jax").rglob("*.py*") if path.suffix != ".pyc"}
    information = {f"{INFO}{name}" for name in ("METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE")}
    assert set(files) == ours | {"midlie_jax/py.typed"} | information
    assert "midlie_jax/__init__.pyi" in ours
    assert all(files[name] == (ROOT / name).read_bytes() for name in ours)
    assert b"midlie = midlie_jax.cli.main:command" in files[f"{INFO}entry_points.txt"]
    assert wheel.stat().st_size < 1e6
    metadata = message_from_bytes(files[f"{INFO}METADATA"])
    assert metadata["Version"] == VERSION
    required = [line for line in metadata.get_all("Requires-Dist", []) if "extra ==" not in line]
    assert {re.match(r"[\w-]+", line)[0] for line in required} == {"jax", "numpy", "diffrax", "equinox", "jaxtyping"}


def test_the_sdist_has_the_sources_and_little_else(sdist):
    with tarfile.open(sdist) as archive:
        tops = {name.split("/")[1] for name in archive.getnames()}
    files = {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "PKG-INFO"}
    assert tops - {".gitignore"} == {"midlie_jax"} | files
    assert sdist.stat().st_size < 1e6


def test_the_version_is_that_of_pyproject_everywhere(capsys):
    assert ml.__version__ == VERSION
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert capsys.readouterr().out == f"midlie_jax {VERSION}\n"
    assert f"\nversion: {VERSION}\n" in (ROOT / "CITATION.cff").read_text()
    headings = re.findall(r"^## \[(.*)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert next(heading for heading in headings if heading != "Unreleased") == VERSION


def test_a_shell_completes_options():
    """As bash asks argcomplete: what is typed is in the environment, and the answer goes to file descriptor 8."""
    typed = "midlie run P1 --bo"
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": typed, "COMP_POINT": str(len(typed)), "_ARGCOMPLETE_SHELL": "bash"}
    start = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from midlie_jax.cli.main import main; main([])"
    command = ["bash", "-c", '"$0" -c "$1" 8>&1 9>/dev/null >/dev/null', sys.executable, start]
    done = subprocess.run(command, env=os.environ | asked, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "--bodies", done.stderr
