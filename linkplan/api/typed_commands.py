"""Commands that pages and problem files tell the user to type."""

import shlex
from pathlib import Path


def sample_again(folder: Path, tracker: str, sample: int) -> str:
    """Return the command that repeats a tracker's run on a sample of an experiment."""
    place = f"sample-{sample}-{tracker}"
    return f"linkplan track {shlex.quote(str(folder))} --sample {sample} --tracker {tracker} --report -o {place}"


def first_steps(file: str) -> tuple[str, str]:
    """Return the commands that plan a new problem file and track the plan."""
    return f"linkplan plan {file} -o planned", "linkplan compare planned -o compared"
