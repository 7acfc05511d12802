"""What the target in C costs on a Cortex-M4F: bytes of code and memory, operations of an interrupt.

Needs what `sensor.py` needs: arm-none-eabi-gcc with newlib in the path, unicorn and capstone. Runs
a triangle with feed-forward, table and signal, four channels recorded. Prints; decides nothing.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from sensor import CHIP, GCC, LAYOUT, Chip, _run  # noqa: E402

SOURCES = ROOT / "rigtool" / "rigs" / "serial" / "target" / "firmware"
OWN = ("rigtool_target.c", "rigtool_loop.c")
FLAGS = ["-std=c99", "-O2", "-ffp-contract=fast", "-fno-math-errno"]
SAMPLES = 1400

PROGRAM = """
#include "rigtool_target.h"
#include <math.h>
#include <string.h>
static struct rigtool_target target;
static uint8_t memory[65536], samples[65536];
static const double motion[] = {0.1, 1.1, 3.0, 0.2, 2.0};
static double table[8 * 200 + 500];
static double signal[777];
static const double section[2][6] = {{0.9, -1.7, 0.8, 1, -1.9, 0.91},
                                     {1e-3, 2e-3, 1e-3, 1, -1.6, 0.7}};
static uint32_t now_ms;

void begin(void)
{
    struct rigtool_target_config config = {0};
    uint8_t object[sizeof motion + 1];
    static uint8_t packed[12 + sizeof table];
    uint32_t sizes[3] = {200, 8, 4}, i, j;
    config.sample_time = 125e-6;
    config.encoder_counts = 4000;
    config.objects = memory;
    config.log = samples;
    config.log_size = sizeof samples;
    config.objects_size = sizeof memory;
    config.name = "";
    rigtool_target_init(&target, &config);
    for (i = 0; i < 200; i++)
        table[i] = 0.006 * i;
    for (i = 0; i < 8; i++)
        table[200 + i] = i < 4 ? -4.0 + i : i - 3.0;
    for (i = 0; i < 4; i++) {
        table[208 + i] = i / 3.0;
        table[212 + i] = i / 3.0;
    }
    for (j = 216; j < 1816; j++)
        table[j] = 1e-3 * (j % 17);
    memcpy(packed, sizes, 12);
    memcpy(packed + 12, table, 1816 * 8);
    rt_table(&target, packed, 12 + 1816 * 8);
    for (i = 0; i < 2; i++)
        for (j = 0; j < 6; j++)
            target.section[i][j] = section[i][j];
    target.sections = 2;
    target.signal = (const uint8_t *)signal;
    target.signal_size = 777;
    target.inertia = (rigtool_real)1.5e-5;
    target.coulomb = (rigtool_real)2e-3;
    target.viscous = (rigtool_real)5e-5;
    target.torque_constant = (rigtool_real)0.045;
    target.limit = 10;
    target.limits[0] = 10; target.limits[1] = 60; target.limits[2] = -1e5;
    target.limits[3] = 1e5; target.limits[4] = 90; target.limits[5] = 600;
    target.watchdog_ms = 5000;
    object[0] = 2;
    memcpy(memory, object, 1);
    memcpy(memory + 1, motion, sizeof motion);
    rt_motion(&target.motion, memory, 1 + sizeof motion);
    target.motion.steps = (uint32_t)floor(rt_duration(&target.motion) / 125e-6 + 0.5);
    target.mask = 15; target.sample_size = 28; target.every = 1;
    target.capacity = sizeof samples / 28;
    target.stop_angle = NAN;
    rt_begin(&target);
    target.phase = 2;
}

void step(int32_t encoder, float current)
{
    struct rigtool_target_reading now;
    now.encoder = encoder;
    now.current = current;
    now.degc = 25;
    now.milliseconds = ++now_ms / 8;
    target.heard = 1;
    target.sent = target.recorded;
    (void)rigtool_target_loop(&target, &now);
}

int32_t state(void) { return target.state; }
"""


def sizes(flags: list[str]) -> tuple[int, int]:
    """Return bytes of code of the target alone, and of memory of `struct rigtool_target`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        code = 0
        for own in OWN:
            _run(GCC, *FLAGS, *flags, *CHIP[:-1], "-c", SOURCES / own, "-o", folder / "own.o")
            text, _, _, *_ = _run("arm-none-eabi-size", folder / "own.o").splitlines()[1].split()
            code += int(text)
        (folder / "size.c").write_text('#include "rigtool_target.h"\nstruct rigtool_target it;\n')
        size = folder / "size.o"
        _run(GCC, *FLAGS, *flags, *CHIP[:-1], f"-I{SOURCES}", "-c", folder / "size.c", "-o", size)
        memory = _run("arm-none-eabi-size", size).splitlines()[1].split()[2]
        return code, int(memory)


def operations(flags: list[str]) -> np.ndarray:
    """Return instructions, multiplications and cycles of each interrupt (n, 3)."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, content in (("host.c", PROGRAM), ("host.ld", LAYOUT)):
            (folder / file).write_text(content)
        files = [folder / "host.c", *(SOURCES / own for own in OWN)]
        linked = ["-T", folder / "host.ld", *files, "-o", folder / "host.elf", f"-I{SOURCES}"]
        _run(GCC, *FLAGS, *flags, *CHIP, "--specs=nosys.specs", "-Wl,-ebegin", *linked, "-lm")
        chip = Chip(folder)
        chip.call("begin")
        return np.array([chip.call("step", k // 20, 0.1) for k in range(SAMPLES)])


def main() -> None:
    for name, flags in (("floats", ["-DRIGTOOL_TARGET_FLOAT"]), ("doubles", [])):
        code, memory = sizes(flags)
        print(f"target in C, {name}: {code} bytes of code, {memory} of memory beside table and log")
        found = operations(flags)
        for place, what in enumerate(("instructions", "multiplications", "cycles by the manual")):
            one = found[:, place]
            print(f"  {what} of an interrupt: mean {one.mean():.0f}, largest {one.max():.0f}")


if __name__ == "__main__":
    main()
