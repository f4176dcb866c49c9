"""`python -m linkplan`: the command line."""

import sys

from linkplan.studies.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
