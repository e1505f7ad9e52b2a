"""Commands as processes of their own, which start in a few milliseconds.

They are forked from a server that has imported everything already, where the system can do so; a
new Python takes two seconds to import NumPy, Numba and OpenCV.
"""

import multiprocessing
import sys
from multiprocessing.process import BaseProcess

from probevo.cli.main import main


def started(words: list[str]) -> BaseProcess:
    """Start ``probevo`` with these words."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        process: BaseProcess = multiprocessing.get_context("spawn").Process(
            target=_exit_with_code_of, args=(words,)
        )
    else:
        forking = multiprocessing.get_context("forkserver")
        forking.set_forkserver_preload([__name__, "probevo.cli.train", "probevo.training.api"])
        process = forking.Process(target=_exit_with_code_of, args=(words,))
    process.start()
    return process


def _exit_with_code_of(words: list[str]) -> None:
    sys.exit(main(words))
