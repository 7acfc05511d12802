"""What the exported force sensor costs: time on this machine, operations on a Cortex-M4F.

The operations need arm-none-eabi-gcc with newlib in the path, and the Python packages unicorn and
capstone: the compiled header runs on an emulated processor, which counts what it executes. Cycles
are those that the Cortex-M4's reference manual states for each instruction, one after the other.
Prints; decides nothing.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

GCC = "arm-none-eabi-gcc"
FLAGS = ["-std=c99", "-O3", "-ffp-contract=fast", "-fno-math-errno", "-DRIGTOOL_SENSOR_FLOAT"]
CHIP = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-nostartfiles"]
SETTLING = 1600
CALLS = 8
"""Samples that are not counted, and samples of a millisecond."""

PROGRAM = """
#include "sensor.h"
struct rigtool_sensor sensor;
void begin(void) { rigtool_sensor_init(&sensor); }
void step(int32_t encoder, float current, float temperature)
{
    struct rigtool_sensor_sample sample = {encoder, current, temperature};
    (void)rigtool_sensor_update(&sensor, sample);
}
"""
LAYOUT = """
SECTIONS {
    . = 0x10000;
    .text : { *(.text*) *(.rodata*) }
    . = 0x200000;
    .data : { *(.data*) } .bss : { *(.bss*) *(COMMON) }
    /DISCARD/ : { *(.ARM*) *(.comment) }
}
"""


def on_this_machine() -> dict[str, float]:
    """Return the processor time of a step of 1 ms, us, in doubles and in floats."""
    from rigtool.experiments.deploy.force_sensor import sensor_header
    from tests.experiments.deploy.sensors import compiled, instrument, motions

    samples = motions()["free"]
    text = sensor_header(instrument(), 1.96, ["benchmark"])
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, flags in (("doubles", ()), ("floats", ("-DRIGTOOL_SENSOR_FLOAT",))):
            library = compiled(Path(folder), text, *flags, name=name)
            times = []
            for _ in range(5):
                library.begin()
                start = time.process_time()
                steps = len(library.add(samples))
                times.append((time.process_time() - start) / steps)
            found[name] = min(times) * 1e6
    return found


class Chip:
    """An emulated Cortex-M4F that counts instructions, multiplications and cycles."""

    def __init__(self, folder: Path) -> None:
        import capstone
        import unicorn

        self._symbols = {}
        for line in _run("arm-none-eabi-nm", folder / "host.elf").splitlines():
            address, _, name = line.split()
            self._symbols[name] = int(address, 16)
        mode = unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS
        self._uc = unicorn.Uc(unicorn.UC_ARCH_ARM, mode)
        self._uc.ctl_set_cpu_model(unicorn.arm_const.UC_CPU_ARM_CORTEX_M4)
        for base in (0x10000, 0x200000, 0x400000):
            self._uc.mem_map(base, 0x100000)
        for section, base in ((".text", 0x10000), (".data", 0x200000)):
            image = folder / "image.bin"
            copy = ["-O", "binary", "-j", section, folder / "host.elf", image]
            _run("arm-none-eabi-objcopy", *copy)
            self._uc.mem_write(base, image.read_bytes())
        self._uc.mem_map(0xE000E000, 0x1000)
        self._uc.mem_write(0xE000ED88, struct.pack("<I", 0xF << 20))  # the FPU is on
        self._uc.reg_write(unicorn.arm_const.UC_ARM_REG_FPEXC, 1 << 30)
        self._registers = unicorn.arm_const
        self._blocks: Counter[tuple[int, int]] = Counter()
        self._costs: dict[tuple[int, int], np.ndarray] = {}
        thumb = capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS
        self._decoder = capstone.Cs(capstone.CS_ARCH_ARM, thumb)
        block = unicorn.UC_HOOK_BLOCK
        self._uc.hook_add(block, lambda _, at, size, __: self._blocks.update([(at, size)]))

    def call(self, name: str, encoder: int = 0, *numbers: float) -> np.ndarray:
        """Return instructions, multiplications and cycles of one call."""
        registers, end = self._registers, 0x4F0000
        self._blocks.clear()
        self._uc.reg_write(registers.UC_ARM_REG_SP, 0x4E0000)
        self._uc.reg_write(registers.UC_ARM_REG_LR, end | 1)
        self._uc.reg_write(registers.UC_ARM_REG_R0, encoder & 0xFFFFFFFF)
        for place, number in enumerate(numbers):
            (bits,) = struct.unpack("<I", struct.pack("<f", number))
            self._uc.reg_write(registers.UC_ARM_REG_S0 + place, bits)
        self._uc.emu_start(self._symbols[name] | 1, end)
        return np.sum([self._cost(block) * times for block, times in self._blocks.items()], axis=0)

    def _cost(self, block: tuple[int, int]) -> np.ndarray:
        if block not in self._costs:
            code = bytes(self._uc.mem_read(*block))
            names = [one.mnemonic for one in self._decoder.disasm(code, block[0])]
            many = sum(name.startswith(MULTIPLY) for name in names)
            self._costs[block] = np.array([len(names), many, sum(map(_cycles, names))])
        return self._costs[block]


MULTIPLY = ("vmul", "vnmul", "vmla", "vmls", "vnml", "vfma", "vfms", "vfnm")


def _cycles(name: str) -> int:
    """Return the cycles of an instruction, those of a taken branch for each branch."""
    if name.startswith(("vdiv", "vsqrt")):
        return 14
    if name.startswith(("udiv", "sdiv")):
        return 12
    if name.startswith(MULTIPLY[2:]) or name in ("b", "bl", "bx", "blx", "b.w") or name[0] == "b":
        return 3
    return (
        2 if name.startswith(("vldr", "vstr", "ldr", "str", "vldm", "vstm", "push", "pop")) else 1
    )


def _run(*arguments: object) -> str:
    return subprocess.run(
        [str(one) for one in arguments], check=True, capture_output=True, text=True
    ).stdout


def on_a_cortex(seconds: float = 1.0) -> np.ndarray:
    """Return instructions, multiplications and cycles of each call (n, 3), a reversal included."""
    from rigtool.experiments.deploy.force_sensor import sensor_header
    from tests.experiments.deploy.sensors import instrument, motions

    samples = motions()["strokes"][:, : round(seconds * 1000 * CALLS)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = sensor_header(instrument(), 1.96, ["benchmark"])
        for file, content in (("sensor.h", text), ("host.c", PROGRAM), ("host.ld", LAYOUT)):
            (folder / file).write_text(content)
        linked = ["-T", folder / "host.ld", folder / "host.c", "-o", folder / "host.elf"]
        _run(GCC, *FLAGS, *CHIP, "--specs=nosys.specs", "-Wl,-ebegin", *linked, "-lm")
        chip = Chip(folder)
        chip.call("begin")
        return np.array([chip.call("step", int(e), c, t) for e, c, t in samples.T])


def main() -> None:
    for name, value in on_this_machine().items():
        print(f"force sensor in C, {name}, a step of 1 ms:  {value:.2f} us  (aim 10 us)")
    if shutil.which(GCC) is None:
        print(f"{GCC} is not there: operations are not counted")
        return
    calls = on_a_cortex()[SETTLING:]
    steps = calls[: len(calls) // CALLS * CALLS].reshape(-1, CALLS, 3)
    for place, name in enumerate(("instructions", "multiplications", "cycles by the manual")):
        each = steps[:, :, place]
        print(
            f"Cortex-M4F, {name} in 1 ms: mean {each.sum(1).mean():.0f}, largest "
            f"{each.sum(1).max():.0f}, of one call {each.max():.0f}"
        )


if __name__ == "__main__":
    main()
