"""Run ``probevo`` as ``python -m probevo``."""

import sys
from pathlib import Path

# Python puts the working directory first on the path of a module that it runs, and a recording may
# lie there with files named like modules.
if sys.path[0] == str(Path.cwd()) and sys.path[0] != str(Path(__file__).parents[1]):
    del sys.path[0]

from probevo.cli.main import main

sys.exit(main())
