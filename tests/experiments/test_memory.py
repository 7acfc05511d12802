"""Memory does not grow with what a run records: recording, then analysing what was recorded."""

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from rigtool.runfile import open_run

ROOT = Path(__file__).parents[2]
RECIPE, FIXTURES = ROOT / "recipes" / "briaire-2006.toml", ROOT / "tests" / "fixtures"
KT, TABLES = FIXTURES / "kt.h5", FIXTURES / "tables.h5"

CODE = textwrap.dedent(
    """
    import json
    import sys
    from pathlib import Path
    from rigtool.cli import main
    for command in json.loads(sys.argv[1]):
        try:
            main(command)
        except SystemExit as end:
            assert not end.code, end
        status = Path("/proc/self/status").read_text()
        print(int(status.split("VmHWM:")[1].split()[0]) / 1024, file=sys.stderr)
    """
)


def most_memory(*commands: list[object]) -> list[float]:
    """Return the most memory that a process had after each of its commands, MB.

    As the kernel counts it for the program: `ru_maxrss` would start at what the tests' own process
    had when it made the new one.
    """
    lines = [[*map(str, command), "-q", "--overwrite"] for command in commands]
    found = subprocess.run(
        [sys.executable, "-c", CODE, json.dumps(lines)], capture_output=True, text=True, check=True
    )
    return [float(line) for line in found.stderr.splitlines()]


def fft_ripple(revolutions: int) -> tuple[str, list[str], list[object]]:
    sets = [
        "fft_ripple.speeds=[3]",
        f"fft_ripple.revolutions={revolutions}",
        "fft_ripple.torques=[]",
        "fft_ripple.power_cycles=0",
        "fft_ripple.record_every=1",
    ]
    return "fft-ripple", sets, ["--kt", KT]


def measure_force(cycles: int) -> tuple[str, list[str], list[object]]:
    sets = [
        "measure_force.forces=[0.25]",
        f"measure_force.cycles={cycles}",
        "measure_force.extra_cycles=1",
        "measure_force.record_every=1",
    ]
    return "measure-force", sets, ["--kt", KT, "--tables", TABLES]


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the kernel counts it in /proc")
@pytest.mark.parametrize(
    ("procedure", "short", "long"), [(fft_ripple, 10, 95), (measure_force, 6, 20)]
)
def test_a_longer_run_at_the_full_rate_needs_hardly_more_memory(tmp_path, procedure, short, long):
    commands, paths = [], []
    for length in (short, long):
        command, sets, inputs = procedure(length)
        paths.append(tmp_path / f"{length}.h5")
        options = [item for value in sets for item in ("--set", value)]
        commands.append([command, RECIPE, "-o", paths[-1], *inputs, *options])
    most, samples = most_memory(*commands), []
    for path in paths:
        with open_run(path) as run:
            samples.append(sum(recording.size for recording in run.recordings.values()))
    # What one channel would take, of four and seven that are recorded.
    channel = (samples[1] - samples[0]) * 8 / 2**20
    assert channel > 9
    assert most[1] - most[0] < channel, (most, samples)
    assert max(most) < 400
