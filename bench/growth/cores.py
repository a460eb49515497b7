"""Times a command on one core and on all, in turns; prints one line `cores,NAME,cores,time` for each, the time on one core being 1.

What counts is the wall time less that in which its threads waited for a core, which other programs had (/proc/PID/task/*/schedstat): a
thread that has nothing to do counts.
"""

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

TURNS = 3
POLL = 0.02
"""s between two readings of the threads' times, which vanish with them."""


def seconds(command: list[str], cores: range) -> float:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    begin = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.sched_setaffinity(0, before)
    waited = {}
    while process.poll() is None:
        for thread in Path(f"/proc/{process.pid}/task").glob("*/schedstat"):
            try:
                waited[thread.parent.name] = 1e-9 * int(thread.read_text().split()[1])
            except (OSError, IndexError):
                continue
        time.sleep(POLL)
    if process.returncode:
        sys.exit(f"error: {' '.join(command)}: exit code {process.returncode}")
    return time.monotonic() - begin - sum(waited.values()) / len(cores)


name, *command = sys.argv[1:]
last = (os.cpu_count() or 1) - 1
ratios = []
for _ in range(TURNS):
    one, every = (seconds(command, cores) for cores in (range(last, last + 1), range(last + 1)))
    print(f"{name}: {one:.2f} s on one core, {every:.2f} s on {last + 1}", file=sys.stderr)
    ratios.append(every / one)
print(f"cores,{name},1,1\ncores,{name},{last + 1},{statistics.median(ratios):.4f}")
