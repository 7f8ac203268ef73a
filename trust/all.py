"""Odd files, kills and repeated runs, one after the other, and their figures together.

python trust/all.py
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

PARTS = ("search.py", "kills.py", "repeat.py")


def last_line(script: str) -> tuple[str, int]:
    """Run a script, showing what it prints; its last line, which holds its figures, and its end."""
    words = [sys.executable, "-u", str(Path(__file__).with_name(script))]
    line = ""
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
    return line.strip(), process.returncode


def main() -> int:
    """Run all, sum up, and end with 1 if any failed."""
    began = time.monotonic()
    ends = [last_line(script) for script in PARTS]
    print("\nSummary")
    for script, (line, code) in zip(PARTS, ends, strict=True):
        print(f"  {line if code == 0 else f'{script} FAILED: {line}'}")
    print(f"  {time.monotonic() - began:.0f} s in all")
    return int(any(code for _, code in ends))


if __name__ == "__main__":
    sys.exit(main())
