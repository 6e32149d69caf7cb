"""Draws lines of prose for a reader who is given only the text.

`python3 tests/prose/sample.py SEED [--places]` prints 100 lines, numbered: half from comments in Rust, half from
documents. The same seed and the same tree give the same lines. `--places` adds the file and line of each.
"""

import random
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COUNT = 100
# A heading, a name or half a phrase is no sentence to judge.
WORDS = 5


def comments(text):
    in_code = False
    for number, line in enumerate(text.splitlines(), 1):
        found = re.match(r"\s*//[/!]?\s?(.*)", line)
        if not found:
            in_code = False
        elif found.group(1).lstrip().startswith("```"):
            in_code = not in_code
        elif not in_code:
            yield number, found.group(1).strip()


def prose(text):
    in_code = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            in_code = not in_code
        elif not in_code and not line.startswith(("    ", "|--", "#")):
            yield number, line.strip()


def lines(pattern, reader):
    names = subprocess.run(["git", "ls-files", pattern], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in names.stdout.split():
        for number, line in reader((ROOT / name).read_text()):
            if len(re.findall(r"[A-Za-z]{2,}", line)) >= WORDS:
                yield f"{name}:{number}", line


def main():
    seed = int(sys.argv[1])
    draw = random.Random(seed)
    drawn = []
    for pattern, reader in (("*.rs", comments), ("*.md", prose)):
        drawn += draw.sample(list(lines(pattern, reader)), COUNT // 2)
    for number, (place, line) in enumerate(drawn, 1):
        print(f"{number:3} {place + ': ' if '--places' in sys.argv else ''}{line}")


if __name__ == "__main__":
    main()
