"""Times of frames and samples: parsers from text to int64 ns, and their checks."""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple

import numpy as np

from probevo.arrays import IntArray
from probevo.errors import InputError, brief
from probevo.sequences.text import INT64_LIMIT, parse_stamp_ns, read_lines

NS_PER_S = 1_000_000_000
NAME_STAMP = re.compile(r"(?P<whole>[0-9]+)(?:\.(?P<decimals>[0-9]+))?$")
NS_OF_DIGITS = {13: 1_000_000, 16: 1_000, 19: 1}
"""Unit of a whole Unix time by its number of digits, which holds from 2001 to 2286."""
NS_DIGITS = 9
"""Decimals of a second in nanoseconds."""
SECONDS_DIGITS = 10
"""Digits of a Unix time in seconds, in the same years."""
MIN_EXPONENT = -100
MAX_EXPONENT = 9
"""Powers of ten of the smallest plausible time other than 0, s, and of the largest that int64 ns
hold, 9.2e9 s."""

RATE_TOLERANCE = 0.1
"""Relative difference of a rate that a user gives from the stamps' rate: a nominal rate and a
cheap clock differ by less, a wrong rate by more."""
GAP_FACTOR = 1.5
"""An interval longer than this many median ones is a gap."""
MAX_DIGITS_OF_COUNT = 9
"""Longer numbers are no counts of frames."""


def read_times(path: Path, count: int) -> IntArray:
    """Read the times of ``count`` frames, one a line, [count], ns.

    They are nanoseconds if every line is a whole number, and seconds otherwise. Seconds are read as
    decimals, so that Unix times keep their nanoseconds, which a float64 would lose.

    Raises:
        InputError: a line is no number, the times do not ascend strictly, or there are not
            ``count`` of them.
    """
    lines = read_lines(path, "It gives the time of each frame, in seconds, one a line.")
    if all(line.lstrip("-").isdigit() for _, line in lines):
        stamps = [parse_stamp_ns(line, where) for where, line in lines]
    else:
        # Check all lines for numbers first: one "nan" in a file of nanoseconds leads here, too.
        numbers = [_finite(line, where) for where, line in lines]
        cure = (
            "Are these nanoseconds? Then write all of them as whole numbers, without point or"
            " exponent."
        )
        stamps = [
            _to_ns(number, where, line, cure=cure)
            for number, (where, line) in zip(numbers, lines, strict=True)
        ]
    return check_stamps(np.array(stamps, dtype=np.int64), path, count)


def read_datetimes(path: Path, count: int) -> IntArray:
    """Read the times of ``count`` frames, one a line, [count], ns.

    They are written like KITTI's ``2011-09-26 13:04:32.351950336``.

    Raises:
        InputError: a line is no time, the times do not ascend strictly, or there are not ``count``
            of them.
    """
    lines = read_lines(path, "It gives the time of each frame.")
    stamps_ns = np.array([_datetime_to_ns(line, where) for where, line in lines])
    return check_stamps(stamps_ns, path, count)


def stamps_of_names(files: list[Path]) -> IntArray | None:
    """Return the times that the names of files are, [K], ns; None if they are no stamps.

    A stamp is the number at the end of the name: Unix time in seconds, of 10 digits, with decimals,
    or as a whole number of 13 (ms), 16 (µs) or 19 digits (ns), the same for all files. A number
    that begins with 0 is a frame's, and one of other digits may be a date.

    Raises:
        InputError: decimals may be fractions of a second, or nanoseconds without leading zeros.
    """
    numbers = [NAME_STAMP.search(file.stem) for file in files]
    matches = [number for number in numbers if number is not None]
    if not matches or len(matches) < len(files):
        return None
    num_digits = {len(number["whole"]) for number in matches}
    has_decimals = {number["decimals"] is not None for number in matches}
    if len(num_digits) > 1 or len(has_decimals) > 1:
        return None
    if any(number["whole"].startswith("0") for number in matches):
        return None
    if has_decimals == {True}:
        if num_digits != {SECONDS_DIGITS}:
            return None
        _check_decimals(files, matches)
        return np.array(
            [round(Decimal(number[0]) * NS_PER_S) for number in matches], dtype=np.int64
        )
    unit_ns = NS_OF_DIGITS.get(num_digits.pop())
    if unit_ns is None:
        return None
    return np.array([int(number["whole"]) * unit_ns for number in matches], dtype=np.int64)


def _check_decimals(files: list[Path], stamps: list[re.Match[str]]) -> None:
    """Refuse stamps whose decimals may be whole nanoseconds, written without leading zeros.

    Fractions that differ in length because their trailing zeros were left out have leading ones.

    Args:
        files: the files, for the message.
        stamps: seconds and decimals in the name of each.

    Raises:
        InputError: nothing tells, and as nanoseconds they would have another order.
    """
    decimals = [stamp["decimals"] for stamp in stamps]
    num_decimals = {len(text) for text in decimals}
    has_leading_zero = any(text.startswith("0") for text in decimals if text != "0")
    if len(num_decimals) == 1 or max(num_decimals) > NS_DIGITS or has_leading_zero:
        return
    as_fractions = sorted(range(len(stamps)), key=lambda index: Decimal(stamps[index][0]))
    as_whole_ns = sorted(
        range(len(stamps)), key=lambda index: (int(stamps[index]["whole"]), int(decimals[index]))
    )
    for one, other in zip(as_fractions, as_whole_ns, strict=True):
        if stamps[one][0] != stamps[other][0]:
            what = (
                f"the decimals of {files[one].name} and {files[other].name} may be fractions of a"
                " second, or nanoseconds without leading zeros, which gives another order."
            )
            cure = (
                "Pad the nanoseconds with leading zeros to nine digits, fractions with trailing"
                " ones."
            )
            raise InputError(files[one], what, cure)


def evenly_spaced(count: int, rate_hz: float) -> IntArray:
    """Return the times of frames that are equally spaced, from zero, [count], ns."""
    return np.round(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)


def spaced_by_number(files: list[Path], rate_hz: float) -> IntArray:
    """Return the times of frames at a rate, from zero, [K], ns, where some may be missing.

    Where the names are numbers that mostly count by one, a number that is left out is a lost frame.
    Any other names say nothing of the time, and the frames are equally spaced.
    """
    names = [file.stem for file in files]
    numbers = np.arange(len(files))
    if all(name.isdecimal() and len(name) <= MAX_DIGITS_OF_COUNT for name in names):
        counted = np.array([int(name) for name in names])
        counts_by_one = len(files) > 1 and np.median(np.diff(counted)) == 1.0
        if counts_by_one and (np.diff(counted) > 0).all():
            numbers = counted - counted[0]
    return np.round(numbers * (1e9 / rate_hz)).astype(np.int64)


class StampSource(NamedTuple):
    """Where stamps come from, in words."""

    text: str
    cure: str
    """What to do if they are wrong, and a rate is right."""


FILE_NAMES = StampSource(
    "the stamps in the file names", "If the names are no stamps, give the times in a times.txt."
)
TIMES = StampSource("its stamps", "If they are wrong, correct them.")


def check_rate(rate_hz: float, stamps_ns: IntArray, where: Path, *, source: StampSource) -> None:
    """Refuse a rate that the stamps of images contradict, or that hides their gaps.

    Args:
        rate_hz: of equally spaced frames, as the user gives it.
        stamps_ns: of the frames, [K], strictly ascending.
        where: the folder of the images, or the file of the stamps.
        source: where the stamps come from.

    Raises:
        InputError: the median interval is of another rate, or an interval is a gap.
    """
    if len(stamps_ns) < 2:
        return
    intervals_s = 1e-9 * np.diff(stamps_ns)
    median_s = float(np.median(intervals_s))
    longest = int(np.argmax(intervals_s))
    if abs(rate_hz * median_s - 1.0) > RATE_TOLERANCE:
        fault = f"are {median_s:.4g} s apart ({1.0 / median_s:.4g} Hz)"
    elif intervals_s[longest] > GAP_FACTOR * median_s:
        fault = f"have a gap of {intervals_s[longest]:.3f} s after frame {longest}"
    else:
        return
    what = f"the rate of {rate_hz:g} Hz contradicts {source.text}, which {fault}."
    raise InputError(where, what, f"Leave out --rate-hz. {source.cure}")


def check_stamps(stamps_ns: IntArray, where: str | Path, count: int | None = None) -> IntArray:
    """Return the stamps, [K], unchanged if they ascend strictly and there are ``count`` of them.

    Raises:
        InputError: names the first pair out of order, or both counts; or the stamps are so close
            together that they cannot be nanoseconds.
    """
    if count is not None and len(stamps_ns) != count:
        raise InputError(
            where, f"{len(stamps_ns)} stamps for {count} files.", "Each file needs exactly one."
        )
    backwards = np.flatnonzero(np.diff(stamps_ns) <= 0)
    if len(backwards):
        k = int(backwards[0])
        problem = "is a duplicate of" if stamps_ns[k + 1] == stamps_ns[k] else "is earlier than"
        what = f"stamp {k + 1} ({stamps_ns[k + 1]} ns) {problem} stamp {k} ({stamps_ns[k]} ns)."
        raise InputError(where, what, "Stamps must ascend strictly; stamps are counted from 0.")
    if len(stamps_ns) > 1 and int(stamps_ns[-1]) - int(stamps_ns[0]) < 1_000 * (len(stamps_ns) - 1):
        what = f"the stamps lie less than 1 µs apart ({stamps_ns[0]} to {stamps_ns[-1]} ns)."
        cure = "Whole numbers are read as nanoseconds; write seconds with a decimal point."
        raise InputError(where, what, cure)
    return stamps_ns


def seconds_to_ns(text: str, where: str) -> int:
    """Parse a decimal number of seconds to ns.

    Raises:
        InputError: the text is no finite number, or too large.
    """
    return _to_ns(_finite(text, where), where, text, cure="Are these nanoseconds?")


def _finite(text: str, where: str) -> Decimal:
    """Parse a finite decimal number.

    Raises:
        InputError: the text is no such number.
    """
    try:
        number = Decimal(text)
    except InvalidOperation:
        raise InputError(where, f"the time {brief(text)} is not a number of seconds.") from None
    if not number.is_finite():
        raise InputError(where, f"the time {brief(text)} is not a finite number of seconds.")
    if not number:
        return Decimal(0)  # whatever its exponent is
    if number.adjusted() < MIN_EXPONENT:
        raise InputError(where, f"the time {brief(text)} is too small for a number of seconds.")
    return number


def _to_ns(seconds: Decimal, where: str, text: str, *, cure: str) -> int:
    """Convert seconds to ns.

    Raises:
        InputError: the result does not fit in 64 bits.
    """
    # The exponent first: the product of a huge Decimal overflows, too.
    if seconds.adjusted() > MAX_EXPONENT or abs(seconds * NS_PER_S) >= INT64_LIMIT:
        raise InputError(
            where, f"the time {brief(text)} is too large for a number of seconds.", cure
        )
    return round(seconds * NS_PER_S)


def _datetime_to_ns(text: str, where: str) -> int:
    """Parse a date and time to ns since 1970.

    Raises:
        InputError: the text is no date and time.
    """
    try:
        moment: np.datetime64 = np.datetime64(text, "ns")
    except ValueError:
        moment = np.datetime64("NaT", "ns")
    # A year that 64 bits of nanoseconds cannot hold, such as 9999, becomes another one.
    if np.isnat(moment) or str(moment).partition("-")[0] != text.partition("-")[0]:
        raise InputError(
            where,
            f"the time {brief(text)} is not a date and time.",
            "Expected YYYY-MM-DD hh:mm:ss.nnnnnnnnn, and a year from 1678 to 2261.",
        )
    return int(moment.astype(np.int64))
