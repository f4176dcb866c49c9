"""A command's matrices are small: numpy's own threads cost more than they gain."""

import os
import subprocess
import sys

ASK = """
import os, sys
from linkplan.__main__ import main
sys.argv = ["linkplan", "list"]
main()
os.write(2, os.environ["OPENBLAS_NUM_THREADS"].encode())
"""


def test_a_command_uses_one_thread_unless_told_otherwise():
    given = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    for more, threads in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")):
        done = subprocess.run([sys.executable, "-c", ASK], env=given | more, capture_output=True, text=True, check=True)
        assert done.stderr == threads
