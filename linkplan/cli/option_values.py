"""Conversion of an option's text to the value of the public function's parameter. This file has no heavy imports."""

import argparse
import math
from typing import Any

from linkplan.api.names import TRACKERS


class Tabled(argparse.Action):
    """A repeatable option NAME=VALUE. Its value is a table with one entry per name."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option_string: str | None = None
    ) -> None:
        """Add a value under its name."""
        del parser, option_string
        name, value = values
        table = getattr(namespace, self.dest, {})
        if name in table:
            raise argparse.ArgumentError(self, f"names joint {name} twice; give one value per joint")
        setattr(namespace, self.dest, {**table, name: value})


def names(text: str) -> tuple[str, ...]:
    """Return the names in a comma-separated text."""
    found = tuple(name.strip() for name in text.split(","))
    if not all(found):
        raise argparse.ArgumentTypeError(f"takes names separated by commas, got '{text}'")
    return found


def trackers(text: str) -> tuple[str, ...]:
    """Return the names of trackers; "all" means all built-in trackers."""
    if text.strip() == "all":
        return TRACKERS
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if not found:
        raise argparse.ArgumentTypeError(f"trackers are names separated by commas, or all; got '{text}'")
    return found


def numbers(text: str) -> list[float]:
    """Return the numbers in a comma-separated text."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"takes numbers separated by commas, got '{text}'") from None


def frequencies(text: str) -> list[float]:
    """Return frequencies [Hz]: comma-separated numbers, or LOW:HIGH:N for N frequencies with equal ratios."""
    if ":" not in text:
        return numbers(text)
    try:
        ends, count = [float(part) for part in text.split(":")[:2]], int(text.split(":", 2)[2])
        low, high = ends
    except (ValueError, IndexError):
        raise argparse.ArgumentTypeError(f"takes F,F,... or LOW:HIGH:N, got '{text}'") from None
    if not (0 < low < high < math.inf and 2 <= count <= 1000):
        raise argparse.ArgumentTypeError(f"LOW:HIGH:N has 0 < LOW < HIGH and N from 2 to 1000, got '{text}'")
    return [low * (high / low) ** (k / (count - 1)) for k in range(count)]


def pose(text: str) -> dict[str, float] | float:
    """Return a pose: comma-separated JOINT=VALUE pairs, or a single number for the only joint."""
    found: dict[str, float] = {}
    for part in text.split(","):
        name, equals, value = part.rpartition("=")
        number = _number(value)
        if not equals and "," not in text and math.isfinite(number):
            return number
        if not name.strip() or not math.isfinite(number):  # 'O=1,5': a comma separates joints and is not a decimal point
            raise argparse.ArgumentTypeError(f"takes JOINT=VALUE, separated by commas, got '{text}'")
        if name.strip() in found:
            raise argparse.ArgumentTypeError(
                f"names joint {name.strip()} twice in '{text}'; use a decimal point, not a comma"
            )
        found[name.strip()] = number
    return found


def joint_value(text: str) -> tuple[str, float]:
    """Return a joint and its position, JOINT=VALUE."""
    name, _, value = text.rpartition("=")
    number = _number(value)
    if not name.strip() or not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"takes JOINT=VALUE, in degrees or metres, got '{text}'")
    return name.strip(), number


def joint_range(text: str) -> tuple[str, list[float]]:
    """Return a joint and its range, JOINT=LOW:HIGH."""
    name, _, both = text.partition("=")
    ends = [_number(end) for end in both.split(":")]
    if not name.strip() or len(ends) != 2 or not all(map(math.isfinite, ends)):
        raise argparse.ArgumentTypeError(f"takes JOINT=LOW:HIGH, got '{text}'")
    return name.strip(), ends


def tolerance(text: str) -> tuple[str, float]:
    """Return the name, or pattern of names, and the tolerance [SI] of NAME=VALUE."""
    name, equals, value = text.rpartition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"a tolerance is NAME=VALUE in SI units, such as '*.length=1e-4', got '{text}'")
    try:
        return name, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"the tolerance of {name} is a number, got '{value}'") from None


def site_force(text: str) -> tuple[str, list[float]]:
    """Return a site and a force on it, SITE=X,Y,Z [N]."""
    name, _, values = text.partition("=")
    force = [_number(value) for value in values.split(",")]
    if not name.strip() or len(force) != 3 or not all(map(math.isfinite, force)):
        raise argparse.ArgumentTypeError(f"takes SITE=X,Y,Z in newtons, got '{text}'")
    return name.strip(), force


def size(text: str) -> tuple[int, int]:
    """Return width and height of WxH."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"takes WIDTHxHEIGHT in pixels, such as 800x600, got '{text}'") from None
    return width, height


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
