"""Draws the pictures of docs/ again, each by the command that stands beside it in its page: `make figures`.

    python benchmarks/figures.py [NAME ...]      all pictures, or those named, as in work-precision-P1; all take hours
    python benchmarks/figures.py --list          only says which command draws which picture

The command of a picture stands below it, in a comment `<!-- drawn by: `COMMAND` -->` or a line "Drawn by `COMMAND`."
Otherwise it is the command on its page that names the file, as in `midlie stability P1 --out stability-P1.png`.
Otherwise it is the script on its page that names the file in its source.
"""

import argparse
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from harness import DOCS, ROOT

PICTURE = re.compile(r"!\[[^\]]*\]\(([\w/.-]+\.(?:png|gif))\)(?:\s+(?:<!-- d|D)rawn by:? `([^`]+)`)?")
SPAN = re.compile(r"`([^`\n]+)`")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHELLS = ("", "sh", "bash", "console")


def commands_in(text: str, programs: Sequence[str] = ("midlie", "python")) -> list[str]:
    """The commands of a page: lines of blocks, and what stands between backticks, if it begins with a program."""
    lines = [line for kind, block in BLOCK.findall(text) if kind in SHELLS for line in block.splitlines()]
    found = [re.sub(r"\s+#.*", "", line).strip() for line in [*lines, *SPAN.findall(BLOCK.sub("", text))]]
    return [command for command in found if command.split(" ")[0] in programs]


def commands() -> dict[str, str]:
    """The command of each picture of the pages by the name of its file."""
    found: dict[str, str] = {}
    for page in sorted(DOCS.rglob("*.md")):
        text = page.read_text()
        known = commands_in(text)
        for picture, below in PICTURE.findall(text):
            name = Path(picture).name
            naming = [command for command in known if name in (Path(word).name for word in command.split())]
            drawing = [command for command in known if f'"{name}"' in _source(command)]
            if below or naming or drawing:
                found.setdefault(name, below or [*naming, *drawing][0])
    return found


def _source(command: str) -> str:
    """What the script of a command says; nothing if it is none of ours."""
    words = command.split()
    script = ROOT / words[1] if len(words) > 1 else ROOT
    return script.read_text() if script.suffix == ".py" and script.is_file() else ""


def as_run(command: str) -> list[str]:
    """The words of a command as it is run from the root: by this Python, and with its pictures in docs/."""
    program, *words = shlex.split(command)
    start = [sys.executable, "-m", "midlie_jax"] if program == "midlie" else [sys.executable]
    return start + [f"docs/{word}" if word.endswith((".png", ".gif")) and "/" not in word else word for word in words]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="pictures, without the ending; by default all")
    parser.add_argument("--list", action="store_true", help="only print the commands")
    options = parser.parse_args()
    known = commands()
    wanted = [name for name in known if Path(name).stem in options.names] if options.names else list(known)
    if unknown := set(options.names) - {Path(name).stem for name in known}:
        parser.error(f"no picture {', '.join(sorted(unknown))}; there are {', '.join(sorted(known))}.")
    done = set()
    for name in wanted:
        print(f"{name}: {known[name]}", flush=True)
        if not options.list and known[name] not in done:  # one command may draw several pictures
            subprocess.run(as_run(known[name]), cwd=ROOT, check=True)
            done.add(known[name])


if __name__ == "__main__":
    main()
