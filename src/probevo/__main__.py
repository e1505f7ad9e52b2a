"""Run ``probevo`` as ``python -m probevo``."""

import sys

from probevo.cli.main import main

sys.exit(main())
