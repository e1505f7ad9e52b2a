"""The entry point ``probevo``: it calls the command, and turns errors into one message."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from threading import current_thread, main_thread
from types import FrameType

from probevo import __version__
from probevo.errors import InputError, ProbevoError

COMMANDS = {
    "run": "probevo.cli.run",
    "train": "probevo.cli.train",
    "compare": "probevo.cli.compare",
    "inspect": "probevo.cli.inspect",
    "eval": "probevo.cli.eval",
    "info": "probevo.cli.info",
    "calibrate-check": "probevo.cli.calibrate_check",
    "covariance-check": "probevo.cli.covariance_check",
    "convert": "probevo.cli.convert",
    "fetch": "probevo.cli.fetch",
    "simulate": "probevo_sim.command",
    "stress": "probevo.cli.stress",
    "paper": "probevo_paper.command",
    "demo": "probevo.cli.demo",
}
"""The module of each command, imported only if it is called: `probevo --help` should not wait for
SciPy."""
HELP = f"""\
probevo {__version__}: stereo visual odometry that learns the noise of each feature
and estimates the covariance of each step.

  probevo run SEQUENCE --out DIR
      estimate the trajectory of a recording, with covariances and a report
  probevo train SEQUENCE… --kind student-t --supervision none --out MODEL
      learn a noise model from recordings, here without ground truth
  probevo compare SEQUENCE… --noise MODEL… --out DIR
      run several estimators on several recordings and compare them
  probevo inspect SEQUENCE --model MODEL --out DIR
      show what a model learned, and the noise it predicts for the features of a frame
  probevo eval RUN --gt POSES
      compare a run, or a trajectory file, with true poses
  probevo info SEQUENCE
      describe a recording, check its calibration, and say what will be used
  probevo calibrate-check SEQUENCE
      say what a recording itself tells of its calibration, with the cure
  probevo covariance-check SEQUENCE
      test the claimed covariances on a recording, without any truth
  probevo convert SEQUENCE --out PATH
      write a recording as a folder of images or as a bag, or a run as a bag of its odometry
  probevo fetch NAME
      download public recordings: KITTI, EuRoC, TUM-VI, TartanAir
  probevo simulate WORLD --out DIR
      simulate a recording of a world, point or scene, with exact ground truth
  probevo stress SEQUENCE --out DIR
      run on spoiled versions of a recording, and compare errors with claims
  probevo paper EXPERIMENT --out DIR
      repeat an experiment of the papers: blur, table-i, table-1.2, table-1.3, sun, hydranet,
      dpc-net
  probevo demo --out DIR
      compare all noise models on two simulated drives, on one page

`probevo COMMAND --help` shows the options of a command, `probevo --version` the version."""
_received: list[int] = []
"""Numbers of the signals that asked this call to stop."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code.

    It is 0, or 2 for bad input, or as a shell has it after a signal, 128 + its number: 130 for
    Ctrl-C, 143 for SIGTERM. Both signals end a command in the same way.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    _open_standard_streams()
    if isinstance(sys.stdout, TextIOWrapper):
        # In a locale such as C, or of a name that is no text: ? for what cannot be written.
        sys.stdout.reconfigure(errors="replace")
    with _stopped_by_signals():
        try:
            code = _dispatch(words)
            # Code that an import or a callback runs may have swallowed the interrupt.
            return _stop_code() if _received else code
        except ProbevoError as error:
            _print_error(str(error), error)
            return 2
        except KeyboardInterrupt as stop:
            _print_error("stopped.", stop)
            return _stop_code()
        except BrokenPipeError:
            # The reader of our output, such as `head`, has closed the pipe. Python flushes stdout
            # at exit, and must not fail again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except OSError as error:
            # What the system refuses of a path that the user gave, such as a name that is too long;
            # or a full disk behind stdout, where files of ours would have been named.
            if error.filename is not None:
                where = os.fsdecode(error.filename)
            elif error.errno == errno.ENOSPC:
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                where = "stdout"
            else:
                raise
            _print_error(f"{where}: {error.strerror}.", error)
            return 2


def _open_standard_streams() -> None:
    """Let standard streams that are closed lead nowhere.

    Otherwise a file of ours could become number 1, and get what other code prints; and joblib
    cannot start a process without a stdout.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free number is this one.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            nowhere = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
            setattr(sys, name, nowhere)


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt at Ctrl-C and at SIGTERM, and keep in mind that they came.

    Only the main thread of a process may set this; and what its caller has set is left alone.
    """
    _received.clear()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    is_allowed = current_thread() is main_thread()
    replaced = {
        number: handler
        for number, handler in handlers.items()
        if is_allowed and handler in (signal.default_int_handler, signal.SIG_DFL)
    }
    for number in replaced:
        signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number, handler in replaced.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise KeyboardInterrupt(signal.Signals(number).name)


def _stop_code() -> int:
    return 128 + (_received[-1] if _received else signal.SIGINT)


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
        similar = get_close_matches(first, COMMANDS, n=1)
        if similar:
            cure = f"Did you mean {similar[0]}?"
        else:
            cure = f"Commands are {', '.join(COMMANDS)}; see `probevo --help`."
        raise InputError(first, "this is not a command.", cure)

    # OpenBLAS would start a thread for each core of the host, but no matrix of a step is so large
    # that more than one thread helps.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    command = import_module(COMMANDS[first])
    if _received:
        raise KeyboardInterrupt
    command.main(words[1:])
    return 0


def _print_error(message: str, error: BaseException) -> None:
    notes = "".join(f"\n         {note}" for note in getattr(error, "__notes__", []))
    print(f"probevo: {message}{notes}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
