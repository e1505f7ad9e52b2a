"""``python -m probevo``: the same as ``probevo``."""

import sys

from probevo.cli.main import main

sys.exit(main())
