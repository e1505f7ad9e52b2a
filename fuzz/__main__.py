"""``python -m fuzz``: try many mutants, and print what was found.

Needs ``PYTHONPATH=src:tests``, as ``make fuzz`` sets it, and Linux for the bound on memory.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import cv2

from fuzz.pool import Mutant, run, try_mutant
from fuzz.targets import all_targets


def main() -> int:
    """Try the mutants; the exit code is 1 if one of them is a finding."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--number", type=int, default=10_000, help="mutants in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--only", nargs="*", default=[], help="names of classes")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--keep", type=Path, help="folder for the files of the findings")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    targets = all_targets()
    chosen = [targets[name] for name in given.only] or list(targets.values())

    # Compile, and see that the seeds themselves are accepted.
    for target in chosen:
        for start in target.seeds:
            if start.files[start.chosen[0]]:
                target.use_seed(start)

    numbers = range(given.first, given.first + -(-given.number // len(chosen)))
    mutants = [Mutant(target.name, given.seed, k) for k in numbers for target in chosen]
    counts: dict[str, Counter[str]] = {target.name: Counter() for target in chosen}
    longest_s = 0.0
    start_s = time.monotonic()
    seen: Counter[str] = Counter()
    for outcome in run(targets, mutants[: given.number], given.jobs):
        counts[outcome.mutant.target][outcome.kind] += 1
        longest_s = max(longest_s, outcome.took_s)
        if outcome.is_finding:
            last = outcome.text.strip().splitlines()[-1] if outcome.text else ""
            place = [line for line in outcome.text.splitlines() if "/probevo" in line][-1:]
            seen[f"{outcome.kind}: {last[:120]} {''.join(place).strip()}"] += 1
            print(f"{outcome.mutant}: {outcome.kind}: {last} {''.join(place).strip()}", flush=True)
            if given.keep:
                name = f"{outcome.mutant.target}-{given.seed}-{outcome.mutant.number}"
                _, files, _ = targets[outcome.mutant.target].mutant(*outcome.mutant[1:])
                for path, content in files.items():
                    (given.keep / name / path).parent.mkdir(parents=True, exist_ok=True)
                    (given.keep / name / path).write_bytes(content)
                (given.keep / name / "finding.txt").write_text(outcome.text)

    print(f"{'class':14}{'mutants':>9}{'refused':>9}{'value':>9}{'findings':>10}")
    for name, kinds in counts.items():
        findings = kinds.total() - kinds["refused"] - kinds["value"]
        print(f"{name:14}{kinds.total():9}{kinds['refused']:9}{kinds['value']:9}{findings:10}")
    total = sum(seen.values())
    took_s = time.monotonic() - start_s
    print(
        f"{total} findings, {len(seen)} different; longest {longest_s:.1f} s; {took_s:.0f} s in all"
    )
    return 1 if total else 0


__all__ = ["main", "try_mutant"]
if __name__ == "__main__":
    sys.exit(main())
