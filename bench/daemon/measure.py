"""Starts the daemon beside a simulated plant and measures it from outside. See `run`."""

import argparse
import json
import os
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PRIORITY = 80
PERIOD_US = 125
PERCENTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
# Wake-ups later than this, us, count as this late.
HISTOGRAM_US = 20_000


class Daemon:
    """A daemon that has said READY; it is told to end on exit."""

    def __init__(self, programs, settings, domain):
        self.domain, self.upswing = domain, programs / "upswing"
        with tempfile.TemporaryDirectory() as folder:
            manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            manager.bind(f"{folder}/notify")
            manager.settimeout(20)
            begin = time.monotonic()
            self.process = subprocess.Popen(
                [programs / "upswingd", "--system", settings, "--domain", domain],
                env=os.environ | {"NOTIFY_SOCKET": f"{folder}/notify"},
                stderr=subprocess.DEVNULL,
            )
            while b"READY=1" not in manager.recv(4096):
                pass
            self.start = time.monotonic() - begin

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(timeout=30)

    def ask(self, *request):
        """The answer, None if it is a refusal."""
        answer = subprocess.run([self.upswing, *request, "--domain", self.domain, "--json"], capture_output=True)
        return json.loads(answer.stdout) if answer.returncode == 0 else None

    def resident_mib(self):
        lines = Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS:"))


def cyclictest(cpu, seconds):
    """Percentiles of its wake-up latency, us."""
    output = subprocess.run(
        ["cyclictest", "--mlockall", "--policy=fifo", f"--priority={PRIORITY}", f"--interval={PERIOD_US}"]
        + [f"--affinity={cpu}", "--threads=1", f"--duration={seconds}", "--quiet", f"--histogram={HISTOGRAM_US}"],
        check=True, capture_output=True, text=True,
    ).stdout
    buckets = [line.split() for line in output.splitlines() if line[:1].isdigit()]
    total, seen, left, found = sum(int(n) for _, n in buckets), 0, dict(PERCENTILES), {}
    for latency, count in buckets:
        seen += int(count)
        for name in [name for name, share in left.items() if seen >= share * total]:
            # A bucket holds what is below the next microsecond.
            found[name] = int(latency) + 0.5
            del left[name]
    return found


def daemon_wake_up(programs, settings, domain, seconds):
    with Daemon(programs, settings, domain) as daemon:
        # The measurements of a plant without real-time rights may be too old at this moment.
        while daemon.ask("request", "enable") is None:
            daemon.ask("request", "reset")
        time.sleep(seconds)
        status = daemon.ask("status")
        if status["degraded"]:
            sys.exit(f"error: expected real-time rights, got degraded: {', '.join(status['degraded'])}")
        return status["wake_us"], status["compute_us"], daemon.resident_mib(), status["overruns"]


def line(name, figures):
    print(f"{name:<34}" + "".join(f"  {key} {value:8.2f}" for key, value in figures.items()))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("programs", type=Path)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--cpu", type=int, default=max(os.sched_getaffinity(0)))
    args = parser.parse_args()
    others = os.sched_getaffinity(0) - {args.cpu}
    if not others:
        sys.exit("error: expected two CPUs or more: the plant must not take the daemon's")
    domain = f"bench-{os.getpid()}"
    programs = args.programs.resolve()
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder, "config")
        subprocess.run([programs / "upswing", "config", "export", settings], check=True, stdout=subprocess.DEVNULL)
        text = (settings / "daemon.toml").read_text()
        assert "\ncpu = -1\n" in text
        (settings / "daemon.toml").write_text(text.replace("\ncpu = -1\n", f"\ncpu = {args.cpu}\n"))
        plant = subprocess.Popen(
            [programs / "upswing-plant", "--clock", "wall", "--domain", domain],
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: os.sched_setaffinity(0, others),
        )
        try:
            measure(args, programs, settings, domain)
        finally:
            plant.terminate()
            plant.wait()
            shutil.rmtree(f"/dev/shm/upswing.{domain}.iox", ignore_errors=True)
            for path in Path("/dev/shm").glob(f"upswing_{domain}_*"):
                path.unlink()


def measure(args, programs, settings, domain):
    starts = []
    for _ in range(args.starts):
        with Daemon(programs, settings, domain) as daemon:
            starts.append(daemon.start)
    print(f"start to READY: median {statistics.median(starts) * 1e3:.0f} ms, max {max(starts) * 1e3:.0f} ms "
          f"of {args.starts}")
    peer = shutil.which("cyclictest") is not None
    if not peer:
        print("cyclictest not found: the daemon alone is measured")
    ours, theirs = [], []
    for turn in range(args.turns):
        if peer:
            theirs.append(cyclictest(args.cpu, args.seconds))
            line(f"turn {turn + 1}, cyclictest, us", theirs[-1])
        wake, compute, resident, late = daemon_wake_up(programs, settings, domain, args.seconds)
        ours.append({name: wake[name] for name in PERCENTILES})
        line(f"turn {turn + 1}, daemon, us", ours[-1])
        line("  its computing, us", {name: compute[name] for name in PERCENTILES})
        print(f"  late cycles {late} of {wake['count']}; resident {resident:.1f} MiB")
    if peer:
        ratio = {name: statistics.median(o[name] / t[name] for o, t in zip(ours, theirs)) for name in PERCENTILES}
        line("daemon / cyclictest, median", ratio)


main()
