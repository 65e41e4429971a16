"""What runs by night: behind a run of the suite, `.ci/night.py [seconds]` adds to `tests/by_night.txt` what
took more of the processor there, but for the quickest case of each test.
"""

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / ".pytest_cache" / "v" / "seconds"
BY_NIGHT = ROOT / "tests" / "by_night.txt"
LIMIT = 2.0

if __name__ == "__main__":
    limit = float(sys.argv[1]) if sys.argv[1:] else LIMIT
    seconds = json.loads(KEPT.read_text())
    quickest = {}
    for name, taken in seconds.items():
        function = name.partition("[")[0]
        quickest[function] = min(quickest.get(function, (taken, name)), (taken, name))
    by_day = {name for _, name in quickest.values()}
    already = set(BY_NIGHT.read_text().splitlines()) - set(seconds)
    late = {name for name, taken in seconds.items() if taken > limit and name not in by_day}
    BY_NIGHT.write_text("".join(f"{name}\n" for name in sorted(late | already)))
    saved, whole = sum(seconds[name] for name in late), sum(seconds.values())
    print(f"{len(late)} more by night: {saved:.0f} of {whole:.0f} CPU s")
