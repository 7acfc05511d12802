"""Memory does not grow with the length of a run."""

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

CODE = textwrap.dedent(
    """
    import sys
    from pathlib import Path
    import numpy as np
    from rigtool.quantity import Quantity
    from rigtool.runfile import Channel, RecordingSpec, RunWriter, open_run
    from rigtool.runfile.comparison import Tolerance, differences
    from rigtool.runfile.export import export
    from rigtool.runfile.recovery import recover
    from rigtool.runfile.verification import verify
    import pandas

    def most():
        # Not `ru_maxrss`: it starts at what the tests' own process had.
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) / 1024

    names = ("time", "a", "b", "c", "d", "e")
    units = {"time": "s"}
    spec = RecordingSpec("long", tuple(Channel(n, units.get(n, "1"), "f8", "") for n in names))
    size, start = 100_000, most()
    arguments = dict(command="x", recordings=[spec])
    for blocks in map(int, sys.argv[2:]):
        path = f"{sys.argv[1]}/{blocks}.h5"
        try:
            with RunWriter(path, **arguments) as out:
                for number in range(blocks):
                    block = dict.fromkeys(names, np.arange(size) // 7 * 1e-3)
                    out.append("long", block)
                raise KeyboardInterrupt
        except KeyboardInterrupt:
            pass
        recover(path + ".part")
        assert verify(path)[0].problem is None
        with open_run(path) as run, open_run(path) as other:
            assert list(differences(run, other, Tolerance())) == []
            long = run.recording("long")
            assert long.size == size * blocks
            for begin in range(0, long.size, size):
                long.read("time", begin, begin + size)
            if blocks < 10:
                export(run, path + ".csv", "long", False)
        print(most() - start)
    """
)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the kernel counts it in /proc")
def test_a_run_six_times_as_long_needs_no_more_memory(tmp_path):
    found = subprocess.run(
        [sys.executable, "-c", CODE, str(tmp_path), "2", "12"],
        capture_output=True,
        text=True,
        check=True,
    )
    short, long = map(float, found.stdout.split())
    # 12 blocks of 6 channels are 58 MB.
    assert long < short + 20, (short, long)
    assert long < 80
