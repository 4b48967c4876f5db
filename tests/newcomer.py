"""What a newcomer does, with the wheel in an empty environment and an empty folder: `make test-release`.

First the package alone; then every command of README and docs, as written: lines of shell blocks and words between
backticks that begin with `midlie`, `pip install`, `python -m` or `eval`. A command that takes long has a comment on its
page, `<!-- not run: COMMAND; REASON -->`, where COMMAND may end in " ..." for all that begin so.
"""

import contextlib
import os
import re
import shlex
import subprocess
import textwrap
import venv
from pathlib import Path

import pytest
from cases import benchmark
from test_release import PROJECT, ROOT, build, unpacked

from midlie_jax.cli.main import read

PROGRAMS = ("midlie", "pip", "python", "eval")
PAGES = [ROOT / "README.md", *(ROOT / "docs" / f"{name}.md" for name in ("index", "start"))]
PAGES += [page for page in sorted((ROOT / "docs").rglob("*.md")) if page not in PAGES]
STARTS = ("midlie", "pip install", "python -m", "eval")
PLACEHOLDER = re.compile(r"\b(SCENE|NAME|COMMAND|DATA\.csv|RUN\.zarr|FILE)\b")
NOT_RUN = re.compile(r"<!-- not run: (.+?); (.+?) -->")
OUTPUT = (".png", ".npz", ".csv", ".zarr", ".gif", ".html", ".md")
LIMIT = 900  # seconds for one command, on a busy machine


def commands():
    pages = benchmark("figures")
    for page in PAGES:
        text = page.read_text()
        not_run = [what for what, _ in NOT_RUN.findall(text)]
        for line in dict.fromkeys(pages.commands_in(NOT_RUN.sub("", text), PROGRAMS)):
            wanted = line.startswith(STARTS) and not PLACEHOLDER.search(line)
            left = (line.startswith(w[:-4]) if w.endswith(" ...") else line == w for w in not_run)
            if wanted and not any(left):
                yield line, page.relative_to(ROOT).as_posix()


@pytest.fixture(scope="session")
def newcomer(tmp_path_factory):
    """Runs a command in an empty folder, in an environment with the wheel and its core dependencies."""
    folder = tmp_path_factory.mktemp("empty")
    home = tmp_path_factory.mktemp("environment")
    wheel, sdist = (build(ROOT, tmp_path_factory.mktemp(kind), kind) for kind in ("wheel", "sdist"))
    sources = unpacked(sdist, tmp_path_factory.mktemp("sources"))
    venv.create(home, with_pip=True)
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "XLA_FLAGS", "VIRTUAL_ENV")}
    quiet = {"PIP_QUIET": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_FIND_LINKS": str(wheel.parent)}
    environment = kept | quiet | {"PATH": f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}"}

    def run(line):
        place = sources if "'.[" in line else folder  # the only command that needs a copy of the repository
        command = ["bash", "-c", line]
        done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, timeout=LIMIT)
        return done, folder

    done, _ = run(f"pip install {shlex.quote(str(wheel))}")
    assert done.returncode == 0, done.stderr
    return run


def test_the_core_alone_integrates_and_has_a_command(newcomer):
    """With what the wheel depends on and no more; what an extra brings is asked for by name."""
    program = """
        import jax, jax.numpy as jnp
        jax.config.update("jax_enable_x64", True)
        import midlie_jax as ml
        from importlib.util import find_spec

        assert "site-packages" in ml.__file__
        extras = ("matplotlib", "tqdm", "mpmath", "zarr", "xarray", "optax", "argcomplete", "pytest")
        assert not [name for name in extras if find_spec(name)]
        body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
        path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        energy = ml.observe.energy
        assert path.ok and abs(energy(body, torque, path) - energy(body, torque, start)).max() < 1e-3
        print(ml.__version__)
    """
    done, _ = newcomer(f"python -c {shlex.quote(textwrap.dedent(program))}")
    assert done.stdout.strip() == PROJECT["version"], done.stderr
    for line in ("midlie scenes", "python -m midlie_jax methods", "midlie --version"):
        done, _ = newcomer(line)
        assert done.returncode == 0, done.stderr
        assert done.stdout
    done, _ = newcomer("midlie run P1 --steps 10 --plot run.png")
    assert done.returncode == 2
    assert "pip install 'midlie_jax[cli]'" in done.stderr


def mentioned_only(line):
    """The name of the program or of one of its commands, such as `midlie run`, which is no whole command."""
    *_, words = line.replace("python -m midlie_jax", "midlie").partition("midlie")
    if not line.startswith(("midlie", "python -m midlie_jax")) or len(words.split()) > 1:
        return False
    with contextlib.suppress(SystemExit):  # --help and --version
        try:
            read(words.split())
        except ValueError:
            return True
    return False


# What installs an extra comes first, as a reader would have it before the commands that need it.
TO_RUN = dict(sorted(dict(commands()).items(), key=lambda item: "pip install" not in item[0]))


@pytest.mark.parametrize("line", TO_RUN, ids=lambda line: f"{TO_RUN[line]}: {line}")
def test_the_command_runs_as_written(newcomer, line):
    done, folder = newcomer(f"{line} --help" if mentioned_only(line) else line)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    written = [word for word in shlex.split(line) if Path(word).suffix in OUTPUT]
    assert [word for word in written if not (folder / word).exists()] == []
