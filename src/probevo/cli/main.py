"""``probevo``: picks the command by the first word, and turns errors into one message."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module

from probevo import __version__
from probevo.errors import InputError, ProbevoError

COMMANDS = {
    "run": "probevo.cli.run",
    "train": "probevo.cli.train",
    "compare": "probevo.cli.compare",
    "inspect": "probevo.cli.inspect",
    "eval": "probevo.cli.eval",
    "info": "probevo.cli.info",
    "simulate": "probevo_sim.command",
    "paper": "probevo_paper.command",
    "demo": "probevo.cli.demo",
}
"""Each is a module of its own, imported only if it is called: `probevo --help` should not wait for
SciPy."""
HELP = f"""\
probevo {__version__}: stereo odometry that learns how far to trust each feature, and says how sure it is of its motion.

  probevo run SEQUENCE --out DIR    from a recording to a trajectory, a covariance for every step, and a report
  probevo train SEQUENCE… --out MODEL
                                    learn from recordings how far to trust each feature
  probevo compare SEQUENCE… --noise ESTIMATOR… --out DIR
                                    several estimators on several recordings, side by side
  probevo inspect SEQUENCE --model MODEL --out DIR
                                    what a model learned, and how it sees the features of a frame
  probevo eval RUN --gt POSES       compare a run, or a trajectory file, with true poses
  probevo info SEQUENCE             what a recording is, whether its calibration is sane, what will be used
  probevo simulate WORLD --out DIR  a recording of a simulated world, point or scene, whose truth is known
  probevo paper EXPERIMENT --out DIR
                                    an experiment of the papers repeated: blur, table-i, table-1.2, table-1.3
  probevo demo --out DIR            two simulated drives, each noise model on both, side by side on one page

`probevo COMMAND --help` shows the options of a command; `probevo --version` the version."""
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0, 2 for a mistake in the input, 130 for Ctrl-C."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        return _dispatch(words)
    except ProbevoError as error:
        _complain(str(error), error)
        return 2
    except KeyboardInterrupt as stop:
        _complain("stopped.", stop)
        return INTERRUPTED
    except BrokenPipeError:  # whoever read our output, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _dispatch(words: list[str]) -> int:
    first = words[0] if words else ""
    if first in ("-h", "--help", "help"):
        print(HELP)
        return 0
    if first == "--version":
        print(f"probevo {__version__}")
        return 0
    if not first:
        print(HELP, file=sys.stderr)
        return 2
    if first not in COMMANDS:
        close = get_close_matches(first, COMMANDS, n=1)
        cure = (
            f"Did you mean {close[0]}?"
            if close
            else f"Commands are {', '.join(COMMANDS)}; see `probevo --help`."
        )
        raise InputError(first, "this is not a command.", cure)
    # No step has a product of matrices that OpenBLAS would share out, but it starts a thread for
    # each core of the host.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import_module(COMMANDS[first]).main(words[1:])
    return 0


def _complain(message: str, error: BaseException) -> None:
    notes = "".join(f"\n         {note}" for note in getattr(error, "__notes__", []))
    print(f"probevo: {message}{notes}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
