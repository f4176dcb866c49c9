"""The source files that a command enters: those of which a function runs.

    python -m tests.bench.entered plan knee-reach

The script runs the command in this process, prints the files by folder on stderr after the command's own output, and their
number last. A file that is only imported does not count: the bodies of classes and comprehensions run then, too.
"""

import collections
import inspect
import runpy
import sys
import threading
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("models", "planner", "controllers", "studies", "linkplan")
COMPREHENSIONS = ("<genexpr>", "<listcomp>", "<dictcomp>", "<setcomp>")


def entered_files(arguments: list[str]) -> list[str]:
    """Return the files, relative to the project's folder, of which `linkplan ARGUMENTS` runs a function."""
    found = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_flags & inspect.CO_NEWLOCALS and code.co_name not in COMPREHENSIONS:
            found.add(code.co_filename)

    before, sys.argv = sys.argv, ["linkplan", *arguments]
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        runpy.run_module("linkplan", run_name="__main__")
    except SystemExit:
        pass
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
        sys.argv = before
    places = {Path(name).resolve() for name in found}
    relative = {place.relative_to(ROOT) for place in places if place.is_relative_to(ROOT)}
    return sorted(str(path) for path in relative if path.parts[0] in PACKAGES)


def main() -> None:
    """Run the command that the arguments are, and print the files that it entered and their number."""
    files = entered_files(sys.argv[1:])
    by_folder = collections.defaultdict(list)
    for file in files:
        by_folder[str(Path(file).parent)].append(Path(file).stem)
    for folder, names in by_folder.items():
        print(f"{folder}: {', '.join(names)}", file=sys.stderr)
    print(len(files), file=sys.stderr)


if __name__ == "__main__":
    main()
