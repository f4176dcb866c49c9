"""Where this project and its tests' data lie, and the knee's table, worked out apart from this project."""

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
DATA = ROOT / "tests" / "data"
KNEE_TABLE = json.loads((DATA / "knee.json").read_text(encoding="utf-8"))
